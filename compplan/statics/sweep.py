"""The inner loops of the elastic chain, components first: one numpy operation works on one component of many poses.

A walk passes once from the base to the TCP. Rotations are three columns of shape (3, n): a rotation about z of an
element mixes two of them, and constant placements cost only entries other than 0 and 1. `compplan.statics.chain` and
`compplan.statics.elastic` are the public interface, poses first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from compplan.io.tables import Array

Terms = list[tuple[int, "Array | float"]]
"""A linear combination: which components, with which coefficients (numbers, or one per pose)."""

Components = Sequence[Array] | Array
"""Three components, each of shape (n,) or (1,)."""

CHUNK = 4096
"""Poses that are walked at once: the working set stays in the cache."""

_SMALL_ANGLE = 0.02


@dataclass(frozen=True)
class Step:
    """One element, its frame turned so that it moves about or along z."""

    columns: tuple[Terms, Terms, Terms]  #: Columns of the constant rotation from the frame before it.
    shift: Terms  #: Constant translation from the frame before it, in that frame. [m]
    translates: bool  #: Whether the element translates.
    q_index: int  #: Commanded joint, or -1.
    theta_index: int  #: Elastic coordinate, or -1.
    multiplier: float  #: Factor on the joint position.
    q_offset: Array | float  #: Constant added to it. [rad or m]
    bodies: list[tuple[int, Terms]]  #: Bodies that the element carries: index and centre in its frame.


@dataclass(frozen=True)
class CompiledChain:
    """A compiled chain: elements, bodies of the base, TCP and rows of the compliance."""

    steps: list[Step]  #: The elements from the base.
    base_bodies: list[tuple[int, Terms]]  #: Bodies of the base.
    tcp_columns: tuple[Terms, Terms, Terms]  #: Columns of the TCP's orientation in the frame of the last element.
    tcp_shift: Terms  #: TCP in the frame of the last element. [m]
    weights: list[list[Array | float]]  #: Weight of each body, none without gravity load. [N]
    n_bodies: int  #: Number of bodies.
    compliance: list[Terms]  #: Rows of the compliance.
    ground: int  #: Step that carries the fixed frame of gravity, -1 for the base.
    ground_columns: tuple[Terms, Terms, Terms]  #: Columns of the orientation of that frame in the frame of the step.
    gravity: list[float]  #: Gravity in its axes. Three numbers. [m/s^2]
    masses: list[Array | float]  #: Mass of each body. [kg]


class Walk(NamedTuple):
    """Frames of n poses, components first; a length of 1 in place of n means equal for all."""

    axis: list[Array]  #: Axis of each element. m arrays of shape (3, n).
    origin: list[Array]  #: Origin of each element. m arrays of shape (3, n). [m]
    columns: list[Array]  #: Columns of the TCP's orientation. Three arrays of shape (3, n).
    position: Array  #: TCP. Shape (3, n). [m]
    centre: list[Array]  #: Centres of the bodies. b arrays of shape (3, n). [m]
    #: Columns of the orientation of the frame of gravity, three arrays of shape (3, n); none for the base.
    ground: list[Array]


def joint_turns(compiled: CompiledChain, q: Array) -> list[tuple[Array, Array] | Array | None]:
    """Evaluate the commanded motion of each element, once for all iterations.

    Args:
        compiled: The chain.
        q: Joint positions. Shape (nq, n). [rad or m]

    Returns:
        For each element sine and cosine, travel [m], or None for an elastic one.
    """
    turns: list[tuple[Array, Array] | Array | None] = []
    for step in compiled.steps:
        if step.q_index < 0:
            turns.append(None)
            continue
        value = step.multiplier * q[step.q_index] + step.q_offset
        turns.append(value if step.translates else (np.sin(value), np.cos(value)))
    return turns


def walk_chain(
    compiled: CompiledChain,
    turns: Sequence[tuple[Array, Array] | Array | None],
    theta: Sequence[Array] | None,
    *,
    bodies: bool = True,
) -> Walk:
    """Walk from the base to the TCP.

    Args:
        compiled: The chain.
        turns: Motion of the commanded elements, from `joint_turns`.
        theta: Elastic coordinates, s arrays of shape (n,), zero if left out. [rad or m]
        bodies: Whether to compute the centres of the bodies.
    """
    columns = [np.eye(3)[:, i : i + 1] for i in range(3)]
    position = np.zeros((3, 1))
    axes: list[Array] = []
    origins: list[Array] = []
    centres: list[Array] = [position] * (compiled.n_bodies if bodies else 0)
    ground: list[Array] = []
    if bodies:
        _hang(compiled.base_bodies, columns, position, centres)
    for k, (step, turn) in enumerate(zip(compiled.steps, turns, strict=True)):
        position = _shifted(position, step.shift, columns)
        columns = [_combine(terms, columns) for terms in step.columns]
        axes.append(columns[2])
        origins.append(position)
        if turn is None and theta is not None:
            value = theta[step.theta_index]
            turn = value if step.translates else _sine_cosine(value)
        if turn is None:
            pass
        elif isinstance(turn, tuple):
            sine, cosine = turn
            first, second, third = columns
            columns = [cosine * first + sine * second, cosine * second - sine * first, third]
        else:
            position = position + turn * columns[2]
        if k == compiled.ground:
            ground = [_combine(terms, columns) for terms in compiled.ground_columns]
        if bodies:
            _hang(step.bodies, columns, position, centres)
    tcp = _shifted(position, compiled.tcp_shift, columns)
    return Walk(axes, origins, [_combine(terms, columns) for terms in compiled.tcp_columns], tcp, centres, ground)


def element_loads(
    compiled: CompiledChain, walk: Walk, force: Components, moment: Components, elements: Sequence[int]
) -> list[Array]:
    """Compute the load of wrench and weights on elements: tau = a . (M - o x F), or a . F where it translates.

    Args:
        compiled: The chain.
        walk: Its frames.
        force: Components of the force on the tool. Three arrays of shape (n,) or (1,). [N]
        moment: Components of the moment on the tool at the TCP. Three arrays of shape (n,) or (1,). [N m]
        elements: The elements, in rising order.

    Returns:
        One array of shape (n,) each. [N m or N]
    """
    f: list[Array] = list(force)
    m = _add(moment, cross(walk.position, f))
    hanging: list[list[int]] = [[b for b, _ in step.bodies] for step in compiled.steps]
    loads: list[Array] = []
    wanted = len(elements) - 1
    about: Array | None = None
    down = [sum((g * column[i] for g, column in zip(compiled.gravity, walk.ground, strict=True)), np.zeros(1))
            for i in range(3)] if walk.ground and compiled.weights else []  # fmt: skip
    for k in range(len(compiled.steps) - 1, -1, -1):
        if wanted < 0:
            break
        if compiled.weights and hanging[k]:
            about = None
            for b in hanging[k]:
                weight = [compiled.masses[b] * g for g in down] or [np.asarray(w) for w in compiled.weights[b]]
                f = _add(f, weight)
                m = _add(m, cross(walk.centre[b], weight))
        if elements[wanted] != k:
            continue
        wanted -= 1
        axis = walk.axis[k]
        if compiled.steps[k].translates:
            loads.append(dot(axis, f))
            continue
        if about is not walk.origin[k]:
            about = walk.origin[k]
            shifted = cross(about, f)
            local = [m[0] - shifted[0], m[1] - shifted[1], m[2] - shifted[2]]
        loads.append(dot(axis, local))
    return loads[::-1]


def apply_compliance(compiled: CompiledChain, torque: Sequence[Array]) -> list[Array]:
    """Multiply the compliance with the loads of the s elastic coordinates, each of shape (n,)."""
    update = []
    for row in compiled.compliance:
        total: Array = np.zeros(1)
        for count, (j, value) in enumerate(row):
            total = value * torque[j] if count == 0 else total + value * torque[j]
        update.append(total)
    return update


def turn_to_axis(axis: Array) -> Array:
    """Build rotations whose third column is a unit vector; exact permutations for coordinate axes [Duff2017]."""
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second, axis], axis=-1)


def turn_vector(matrix: Array, vector: Array) -> Array:
    """Multiply stacks of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


def entry(values: Array) -> Array | float:
    """Return one number for all poses (rounded if nearly an integer), otherwise one per pose."""
    flat = np.asarray(values, float).reshape(-1)
    if flat.size > 1:
        return flat
    value = float(flat[0])
    return float(round(value)) if abs(value - round(value)) < 2e-16 else value


def vector_terms(vector: Array) -> Terms:
    """Return the nonzero components of a vector. Shape (..., k)."""
    if vector.size == vector.shape[-1]:
        return _keep_numbers(np.asarray(vector, float).reshape(-1).tolist())
    entries = ((i, entry(vector[..., i])) for i in range(vector.shape[-1]))
    return [(i, value) for i, value in entries if np.any(value)]


def column_terms(matrix: Array) -> tuple[Terms, Terms, Terms]:
    """Return the nonzero entries of each column of a rotation. Shape (..., 3, 3)."""
    if matrix.size == 9:
        first, second, third = zip(*np.reshape(matrix, (3, 3)).tolist(), strict=True)
        return _keep_numbers(first), _keep_numbers(second), _keep_numbers(third)
    return vector_terms(matrix[..., :, 0]), vector_terms(matrix[..., :, 1]), vector_terms(matrix[..., :, 2])


def _keep_numbers(numbers: Sequence[float]) -> Terms:
    whole = [float(round(v)) if abs(v - round(v)) < 2e-16 else v for v in numbers]
    return [(i, value) for i, value in enumerate(whole) if value]


def _combine(terms: Terms, columns: Sequence[Array]) -> Array:
    total: Array | None = None
    for i, value in terms:
        part = columns[i] if isinstance(value, float) and value == 1.0 else value * columns[i]
        total = part if total is None else total + part
    return np.zeros((3, 1)) if total is None else total


def _shifted(position: Array, shift: Terms, columns: Sequence[Array]) -> Array:
    for i, value in shift:
        position = position + value * columns[i]
    return position


def _hang(bodies: list[tuple[int, Terms]], columns: Sequence[Array], position: Array, centres: list[Array]) -> None:
    for b, shift in bodies:
        centres[b] = _shifted(position, shift, columns)


def _sine_cosine(angle: Array) -> tuple[Array, Array]:
    """Compute sine and cosine, by series (exact to rounding) for small angles."""
    if np.abs(angle).max(initial=0.0) > _SMALL_ANGLE:
        return np.sin(angle), np.cos(angle)
    square = angle * angle
    sine = angle * (1.0 + square * (-1 / 6 + square * (1 / 120 - square / 5040)))
    return sine, 1.0 + square * (-0.5 + square * (1 / 24 + square * (-1 / 720 + square / 40320)))


def cross(a: Components, b: Components) -> list[Array]:
    """Return the cross product, component by component."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Components, b: Components) -> Array:
    """Return the scalar product."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _add(a: Components, b: Components) -> list[Array]:
    return [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
