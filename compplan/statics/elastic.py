"""Elastostatics: equilibrium and compliance of a loaded chain.

A wrench is the load of the environment on the tool, at the TCP, in base axes, force first. Equilibrium is taken in the
loaded state with finite rotations: theta = C (J(q, theta)^T w + tau_gravity(q, theta)).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError, ShapeError
from compplan.robot import Array
from compplan.statics.chain import (
    Chain,
    Frames,
    chunks,
    empty_frames,
    fill_frames,
    jacobian,
    locate_frames,
    locate_gravity,
)
from compplan.statics.sweep import Walk, apply_compliance, cross, dot, element_loads, joint_turns, walk_chain

MAX_ITERATIONS = 200


class LoadedPose(NamedTuple):
    """Equilibrium of a chain at n poses."""

    theta: Array  #: Elastic coordinates. Shape (n, s). [rad or m]
    #: Frames of the loaded chain; `frames.tcp_position` and `frames.tcp_rotation` are the attained pose.
    frames: Frames
    torque: Array  #: Load on each elastic coordinate. Shape (n, s). [N m or N]

    @property
    def position(self) -> Array:
        """Attained TCP, base frame. Shape (n, 3). [m]."""
        return self.frames.tcp_position

    @property
    def rotation(self) -> Array:
        """Attained orientation of the TCP, base frame. Shape (n, 3, 3)."""
        return self.frames.tcp_rotation


def solve_equilibrium(
    chain: Chain, q: Array, wrench: Array | None = None, *, tolerance: float = 1e-13, torque_bias: Array | None = None,
    theta: Array | None = None,
) -> LoadedPose:  # fmt: skip
    """Solve the static equilibrium of the loaded chain.

    Fixed point theta <- C (J^T w + tau_g), which contracts while the load is far below the buckling load.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes; none if left out.
            Shape (n, 6) or (6,). [N, N m]
        tolerance: Largest change of an elastic coordinate in the last iteration. [rad or m]
        torque_bias: Further load on each elastic coordinate. Shape (n, s). [N m or N]
        theta: Initial elastic coordinates; zero if left out. Shape (n, s). [rad or m]

    Raises:
        ShapeError: If an array does not have the shape above.
        ConvergenceError: If the iteration diverges, as beyond the buckling load.
    """
    q = np.atleast_2d(np.asarray(q, float))
    load = _wrench_rows(wrench, len(q))
    if not chain.n_springs:
        return LoadedPose(np.zeros((len(q), 0)), locate_frames(chain, q), np.zeros((len(q), 0)))
    bias = None if torque_bias is None else np.broadcast_to(torque_bias, (len(q), chain.n_springs))
    frames, given, torque = empty_frames(chain, len(q)), *(np.empty((chain.n_springs, len(q))).T for _ in range(2))
    for rows, solution in _solve_pieces(chain, q, load, bias, tolerance, theta, bodies=True):
        fill_frames(frames, rows, solution.walk)
        for j, (coordinate, moment) in enumerate(zip(solution.theta, solution.torque, strict=True)):
            given[rows, j], torque[rows, j] = coordinate, moment
    return LoadedPose(given, frames, torque)


def locate_loaded(
    chain: Chain, q: Array, wrench: Array, *, tolerance: float = 1e-13, torque_bias: Array | None = None,
    theta: Array | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the loaded pose of the TCP and the deflections only; see `solve_equilibrium`.

    Arguments and errors are those of `solve_equilibrium`.

    Returns:
        Positions (n, 3) [m], orientations (n, 3, 3), elastic coordinates (n, s) [rad or m].
    """
    found = np.empty((chain.n_springs, len(q))).T
    if not chain.n_springs:
        frames = locate_frames(chain, q)
        return frames.tcp_position, frames.tcp_rotation, found
    position, rotation = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for rows, solution in _solve_pieces(chain, q, wrench, torque_bias, tolerance, theta, bodies=False):
        position[rows] = solution.walk.position.T
        for i, column in enumerate(solution.walk.columns):
            rotation[rows, :, i] = column.T
        for j, coordinate in enumerate(solution.theta):
            found[rows, j] = coordinate
    return position, rotation, found


def _solve_pieces(
    chain: Chain, q: Array, load: Array, bias: Array | None, tolerance: float, theta: Array | None, *, bodies: bool
) -> Iterator[tuple[slice, _Solution]]:
    """Solve the equilibrium in parts; compute the centres of the bodies at the end on request."""
    for rows in chunks(len(q)):
        part = chain.take(rows)
        extra, start = (None if each is None else list(np.ascontiguousarray(each[rows].T)) for each in (bias, theta))
        columns = np.ascontiguousarray((load[:1] if load.strides[0] == 0 else load[rows]).T)
        turned = np.ascontiguousarray(q[rows].T)
        yield rows, _iterate(part, turned, columns, extra, tolerance, start, first=rows.start, bodies=bodies)


class _Solution(NamedTuple):
    """Equilibrium of a piece, components first."""

    theta: list[Array]
    torque: list[Array]
    walk: Walk


def _iterate(
    chain: Chain, q: Array, wrench: Array, bias: list[Array] | None, tolerance: float, start: list[Array] | None, *,
    first: int, bodies: bool,
) -> _Solution:  # fmt: skip
    """Iterate theta <- C (J^T w + tau_g) until the geometric series of the changes falls below the tolerance."""
    compiled, elements = chain.compiled, [int(k) for k in chain.spring_elements]
    turns, theta = joint_turns(compiled, q), start
    change = previous = np.inf
    for _ in range(MAX_ITERATIONS):
        walk = walk_chain(compiled, turns, theta, bodies=bool(compiled.weights))
        torque = element_loads(compiled, walk, wrench[:3], wrench[3:], elements)
        if bias is not None:
            torque = [a + b for a, b in zip(torque, bias, strict=True)]
        update = apply_compliance(compiled, torque)
        before = [np.zeros(1)] * len(update) if theta is None else theta
        change = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(update, before, strict=True))
        theta = update
        ratio = min(change / previous, 1.0) if np.isfinite(previous) and previous > 0 else 1.0
        if change < tolerance or (ratio < 0.5 and change * ratio < 0.5 * tolerance):
            walked = change < tolerance and (bool(compiled.weights) or not bodies)
            return _Solution(theta, torque, walk if walked else walk_chain(compiled, turns, theta, bodies=bodies))
        if not np.isfinite(change):
            break
        previous = change
    if start is not None:  # the initial value may lie beyond buckling
        return _iterate(chain, q, wrench, bias, tolerance, None, first=first, bodies=bodies)
    steps = np.stack([np.broadcast_to(np.nan_to_num(np.abs(a - b), nan=np.inf), q.shape[1:])
                      for a, b in zip(update, before, strict=True)])  # fmt: skip
    spring, row = np.unravel_index(int(np.argmax(steps)), steps.shape)
    message = (
        f"equilibrium did not converge at waypoint {first + int(row)}, spring {chain.spring_names[int(spring)]!r}, "
        f"last change {change:.3g} rad or m; the load is near or beyond buckling: check forces and compliances"
    )
    raise ConvergenceError(message, residual=change)


def cartesian_compliance(chain: Chain, q: Array) -> Array:
    """Compute the compliance of the TCP, J C J^T, at an unloaded pose.

    Valid for a small change of the wrench if the stiffness by the change of the Jacobian is negligible
    [Salisbury1980]; `loaded_compliance` holds without that condition.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]

    Returns:
        Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, base axes. Shape (n, 6, 6).
    """
    q = np.atleast_2d(np.asarray(q, float))
    result = np.empty((6, 6, len(q)))
    for rows in chunks(len(q)):
        part = chain.take(rows)
        columns = np.moveaxis(jacobian(part, locate_frames(part, q[rows])), 0, -1)[:, part.spring_elements]
        bent = np.empty_like(columns)
        for i in range(6):
            for j, displacement in enumerate(apply_compliance(part.compiled, columns[i])):
                bent[i, j] = displacement
            for k in range(i + 1):
                result[i, k, rows] = result[k, i, rows] = np.einsum("sn,sn->n", bent[i], columns[k])
    return np.moveaxis(result, -1, 0)


def loaded_compliance(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute the exact compliance of the TCP in the loaded state.

    dx/dw = J (1 - C H)^-1 C J^T with H = d(J^T w + tau_g)/dtheta at the equilibrium: this includes the complementary
    stiffness K_C [Chen2000; Dumas2011].

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Twist of the TCP per wrench, base axes. Shape (n, 6, 6).
    """
    q = np.atleast_2d(np.asarray(q, float))
    loaded = solve_equilibrium(chain, q, wrench)
    columns = jacobian(chain, loaded.frames)[:, :, chain.spring_elements]
    hessian = load_hessian(chain, q, loaded.theta, _wrench_rows(wrench, len(q)))
    inner = np.eye(chain.n_springs) - chain.compliance @ hessian
    return np.asarray(columns @ np.linalg.solve(inner, chain.compliance @ np.swapaxes(columns, 1, 2)))


def load_hessian(chain: Chain, q: Array, theta: Array, wrench: Array) -> Array:
    """Differentiate the load on the elastic coordinates with respect to them: H = d(J^T w + tau_g)/dtheta.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Shape (n, s, s). [N m/rad, N/m or mixed]
    """
    n, springs = len(q), chain.spring_elements
    hessian, load = np.empty((n, len(springs), len(springs))), _wrench_rows(wrench, n)
    for rows in chunks(n):
        part = chain.take(rows)
        change = load_derivative(part, locate_frames(part, q[rows], theta[rows]), load[rows], springs)
        hessian[rows] = change[:, :, springs]
    return hessian


def load_derivative(chain: Chain, frames: Frames, wrench: Array, elements: NDArray[np.int_] | None = None) -> Array:
    """Differentiate the load on elements with respect to the motion of every element, in closed form.

    The load on element k is tau_k = a_k . sum_b (r_b - o_k) x f_b + a_k . m over the loads beyond it: the wrench (f, m)
    at the TCP and the weights. Element j turns or shifts everything beyond it while the loads keep their base axes.

    Args:
        chain: The chain.
        frames: Its frames at n poses.
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        elements: The elements k, all if left out. Shape (k,).

    Returns:
        d tau_k / d x_j. Shape (n, k, m).

    """
    m = len(chain.names)
    own = np.arange(m) if elements is None else elements
    # components first: one operation works on one component of many poses
    axis, slides = [np.moveaxis(frames.axis[:, :, i], 0, -1) for i in range(3)], chain.translates
    force, moment, dyad = _loads_beyond(chain, frames, wrench)
    mine, spread = [each[own] for each in axis], dyad[0][0] + dyad[1][1] + dyad[2][2]
    swing = [dot(dyad[i], axis) - axis[i] * spread for i in range(3)]
    push = [each[own] for each in moment]
    lever = [dot([dyad[0][i][own], dyad[1][i][own], dyad[2][i][own]], mine) for i in range(3)]
    lever = [lever[i] - spread[own] * mine[i] for i in range(3)]
    if slides.any():
        swing = [np.where(slides[:, None], a, b) for a, b in zip(cross(axis, force), swing, strict=True)]
        push = [np.where(slides[own, None], force[i][own], push[i]) for i in range(3)]
        lever = [np.where(slides[own, None], 0.0, each) for each in lever]
    before = [a + b for a, b in zip(cross(mine, push), lever, strict=True)]
    beyond = np.arange(m)[None, :] > own[:, None]
    derivative = np.zeros((len(own), m, len(frames.tcp_position)))
    for count, element in enumerate(own.tolist()):
        early, late = slice(0, element + 1), slice(element + 1, m)
        derivative[count, early] = dot([each[count] for each in before], [each[early] for each in axis])
        derivative[count, late] = dot([each[count] for each in mine], [each[late] for each in swing])
    if slides.any():
        derivative[slides[None, :] & ~beyond] = 0.0
        derivative[slides[own, None] & beyond] = 0.0
    found = np.moveaxis(derivative, -1, 0)
    if chain.ground >= 0 and chain.gravity.any():  # the weights turn with the positioner
        light = load_derivative(replace(chain, gravity=np.zeros(3)), frames, wrench, elements)
        found[:, :, : chain.ground + 1] = light[:, :, : chain.ground + 1]
    return found


def _loads_beyond(chain: Chain, frames: Frames, wrench: Array) -> tuple[list[Array], list[Array], list[list[Array]]]:
    """Sum the loads beyond each element: force, moment at its origin, and sum of l f^T; components of shape (m, n)."""
    origin, tip = np.moveaxis(frames.origin, 0, -1), frames.tcp_position.T
    lever = [tip[i] - origin[:, i] for i in range(3)]
    f, w = wrench.T[:3], wrench.T[3:]
    force = [np.broadcast_to(each, lever[0].shape) for each in f]
    moment = [w[i] + each for i, each in enumerate(cross(lever, force))]
    dyad = [[lever[i] * f[j] for j in range(3)] for i in range(3)]
    if chain.gravity.any() and len(chain.body_element):
        place = [origin[:, i] for i in range(3)]
        down = locate_gravity(chain, frames)
        for j in np.flatnonzero(down.any(axis=0)).tolist():
            total, first = np.zeros_like(lever[0]), [np.zeros_like(lever[0]) for _ in range(3)]
            for body, element in enumerate(chain.body_element.tolist()):
                weight = np.asarray(chain.mass)[..., body] * down[:, j]
                total[: element + 1] += weight
                for i in range(3):
                    first[i][: element + 1] += weight * frames.centre[:, body, i]
            first = [first[i] - place[i] * total for i in range(3)]
            dyad = [[dyad[i][k] + first[i] if k == j else dyad[i][k] for k in range(3)] for i in range(3)]
            one, two = (j + 1) % 3, (j + 2) % 3  # the moment of a force along j: l x e_j
            moment[one], moment[two] = moment[one] + first[two], moment[two] - first[one]
            force[j] = force[j] + total
    return force, moment, dyad


def _wrench_rows(wrench: Array | None, n: int) -> Array:
    if wrench is None:
        return np.zeros((n, 6))
    rows = np.asarray(wrench, float)
    if rows.shape not in ((6,), (n, 6)):
        raise ShapeError(f"wrench has shape {rows.shape}, expected ({n}, 6) or (6,)")
    return np.broadcast_to(rows, (n, 6))
