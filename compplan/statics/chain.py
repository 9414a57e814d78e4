"""The elastic chain: a series of one-degree-of-freedom elements, evaluated for many poses at once.

Every commanded joint, every spring and every elementary motion of an elastic link is one element: a constant placement,
then a rotation or translation along a constant axis [virtual joint method, Salisbury1980]. Positions of commanded
joints are `q`, those of elastic elements `theta`. All quantities are in base axes and SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.robot import Array, Robot
from compplan.statics.elements import ElementRow
from compplan.statics.sweep import (
    CHUNK,
    CompiledChain,
    Step,
    Terms,
    Walk,
    column_terms,
    element_loads,
    entry,
    joint_turns,
    turn_to_axis,
    turn_vector,
    vector_terms,
    walk_chain,
)


@dataclass(frozen=True)
class Chain:
    """The m elements from the base to the TCP and their masses.

    Placements, axes, masses and compliances may have a leading batch axis: one set of parameters per pose.
    """

    #: Name of each element: a joint's name, or "joint.axis" / "link.axis" of an elastic one. Length m.
    names: tuple[str, ...]
    rotation: Array  #: Orientation of the element frame in the frame before it. Shape (..., m, 3, 3).
    position: Array  #: Origin of the element frame in the frame before it. Shape (..., m, 3). [m]
    axis: Array  #: Unit vector of the motion in the element frame. Shape (..., m, 3).
    translates: NDArray[np.bool_]  #: Which elements translate. Shape (m,).
    q_index: NDArray[np.int_]  #: Commanded joint that drives the element, -1 for an elastic one. Shape (m,).
    multiplier: Array  #: Factor on q (mimic joints, otherwise 1). Shape (m,).
    q_offset: Array  #: Constant added to multiplier * q. Shape (..., m). [rad or m]
    theta_index: NDArray[np.int_]  #: Elastic coordinate that drives the element, -1 for a commanded one. Shape (m,).
    tcp_rotation: Array  #: Orientation of the TCP in the frame of the last element. Shape (..., 3, 3).
    tcp_position: Array  #: TCP in the frame of the last element. Shape (..., 3). [m]
    body_element: NDArray[np.int_]  #: Element that carries a body, -1 for the base. Shape (b,).
    mass: Array  #: Masses of the bodies. Shape (..., b). [kg]
    centre: Array  #: Centres of the bodies in their element's frame after its motion. Shape (..., b, 3). [m]
    compliance: Array  #: Compliance of the elastic coordinates. Shape (..., s, s). [rad, m per N m, N]
    gravity: Array  #: Gravity in the axes of the ground, zero without gravity load. Shape (3,). [m/s^2]
    actuator: NDArray[np.bool_]  #: Which elastic coordinates lie between motor-side and link-side encoder. Shape (s,).
    link_share: Array  #: Share of each compliance beyond the link-side encoder, 0 to 1. Shape (s,).
    joint_elements: NDArray[np.int_]  #: Element of each commanded joint. Shape (nq,).
    ground: int = -1  #: Element that carries the fixed frame of gravity, -1 for the base: the last one of a positioner.
    #: Orientation of that frame in the element's frame after its motion. Shape (3, 3).
    ground_rotation: Array = field(default_factory=lambda: np.eye(3))

    @property
    def nq(self) -> int:
        """Number of commanded joints."""
        return len(self.joint_elements)

    @property
    def n_springs(self) -> int:
        """Count the elastic coordinates."""
        return int(self.theta_index.max(initial=-1)) + 1

    @property
    def spring_elements(self) -> NDArray[np.int_]:
        """Element of each elastic coordinate. Shape (s,)."""
        return np.flatnonzero(self.theta_index >= 0)

    @property
    def spring_names(self) -> tuple[str, ...]:
        """Name of each elastic coordinate. Length s."""
        return tuple(self.names[element] for element in self.spring_elements)

    @cached_property
    def compiled(self) -> CompiledChain:
        """The compiled chain."""
        return compile_chain(self)

    @property
    def structure(self) -> bytes:
        """Key of the structure, equal for chains that differ only in numbers."""
        parts = (self.translates, self.q_index, self.theta_index, self.multiplier, self.body_element, self.gravity)
        return b"|".join(part.tobytes() for part in parts)

    @property
    def batched(self) -> bool:
        """Return whether the chain has one set of parameters per pose."""
        return any(getattr(self, name).ndim > own and len(getattr(self, name)) > 1 for name, own in _OWN_AXES.items())

    def take(self, rows: slice) -> Chain:
        """Select the parameter sets of some poses; a chain with one set returns itself."""
        if not self.batched:
            return self
        fields = {name: getattr(self, name) for name in _OWN_AXES}
        cut = {k: v[rows] for k, v in fields.items() if v.ndim > _OWN_AXES[k] and len(v) > 1}
        return replace(self, **cut)


_OWN_AXES = {
    "rotation": 3, "position": 2, "axis": 2, "q_offset": 1, "tcp_rotation": 2, "tcp_position": 1,
    "mass": 1, "centre": 2, "compliance": 2,
}  # fmt: skip


def stack_chains(chains: Sequence[Chain], n: int) -> Chain:
    """Concatenate chains of one structure, n poses each; equal parameters are kept once."""
    fields: dict[str, Any] = {}
    for name, own in _OWN_AXES.items():
        parts = [getattr(chain, name) for chain in chains]
        if any(part.ndim > own or not np.array_equal(part, parts[0]) for part in parts):
            fields[name] = np.concatenate([np.broadcast_to(part, (n, *part.shape[-own:])) for part in parts])
    return replace(chains[0], **fields)


def compile_chain(chain: Chain) -> CompiledChain:
    """Compile a chain."""
    turns = turn_to_axis(chain.axis)
    backs = np.swapaxes(turns, -1, -2)
    before = np.concatenate([np.broadcast_to(np.eye(3), (*backs.shape[:-3], 1, 3, 3)), backs], axis=-3)
    rotations = before[..., :-1, :, :] @ chain.rotation @ turns
    shifts = turn_vector(before[..., :-1, :, :], chain.position)
    steps: list[Step] = []
    for k in range(len(chain.names)):
        steps.append(
            Step(
                columns=column_terms(rotations[..., k, :, :]),
                shift=vector_terms(shifts[..., k, :]),
                translates=bool(chain.translates[k]),
                q_index=int(chain.q_index[k]),
                theta_index=int(chain.theta_index[k]),
                multiplier=float(chain.multiplier[k]),
                q_offset=entry(chain.q_offset[..., k]),
                bodies=_body_terms(chain, k, backs[..., k, :, :]),
            )
        )
    back = before[..., -1, :, :]
    weights = [
        [entry(chain.mass[..., b] * component) for component in chain.gravity] for b in range(len(chain.body_element))
    ]
    return CompiledChain(
        steps=steps,
        base_bodies=_body_terms(chain, -1, np.eye(3)),
        tcp_columns=column_terms(back @ chain.tcp_rotation),
        tcp_shift=vector_terms(turn_vector(back, chain.tcp_position)),
        weights=weights if chain.gravity.any() else [],
        n_bodies=len(chain.body_element),
        compliance=[vector_terms(chain.compliance[..., i, :]) for i in range(chain.compliance.shape[-1])],
        ground=chain.ground,
        ground_columns=column_terms(backs[..., chain.ground, :, :] @ chain.ground_rotation),
        gravity=[float(g) for g in chain.gravity],
        masses=[entry(chain.mass[..., b]) for b in range(len(chain.body_element))],
    )


def _body_terms(chain: Chain, element: int, back: Array) -> list[tuple[int, Terms]]:
    hanging = np.flatnonzero(chain.body_element == element)
    return [(int(b), vector_terms(turn_vector(back, chain.centre[..., b, :]))) for b in hanging]


class Frames(NamedTuple):
    """Frames of a chain at n poses."""

    axis: Array  #: Axis of each element, base axes. Shape (n, m, 3).
    origin: Array  #: Origin of each element, base frame. Shape (n, m, 3). [m]
    tcp_rotation: Array  #: Orientation of the TCP in the base frame. Shape (n, 3, 3).
    tcp_position: Array  #: TCP in the base frame. Shape (n, 3). [m]
    centre: Array  #: Centres of the masses in the base frame. Shape (n, b, 3). [m]
    ground: Array  #: Orientation of the fixed frame of gravity, base axes. Shape (n, 3, 3).


def build_chain(robot: Robot) -> Chain:
    """Build the elastic chain of a robot.

    Springs act after the motion of their joint in the order they are listed; the 6x6 elasticity of a link acts at its
    far end, tx ty tz rx ry rz in this order.
    """
    row = ElementRow()
    hanging = robot.loading_bodies
    bodies = {link: [body for body in hanging if body.link == link] for link in {b.link for b in hanging}}
    row.add_bodies(bodies.get(robot.base, []))
    for count, joint in enumerate(robot.joints):
        row.move(joint.placement)
        if joint.kind != "fixed":
            row.add_joint(joint, robot.joint_names)
        for spring in robot.springs:
            if spring.joint == joint.name:
                row.add_elastic(spring, joint)
        row.add_bodies(bodies.get(joint.child, []))
        if joint.child == robot.ground:
            row.set_ground()
        following = robot.joints[count + 1] if count + 1 < len(robot.joints) else None
        for block in (b for b in robot.link_elasticities if b.link == joint.child):
            far_end = np.eye(4) if following is None else following.placement
            row.move(far_end)
            row.add_link(block.link, block.compliance)
            row.move(np.asarray(np.linalg.inv(far_end), float))
    return Chain(**row.arrays(robot))


def locate_frames(chain: Chain, q: Array, theta: Array | None = None) -> Frames:
    """Locate every element and the TCP.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates, zero if left out. Shape (n, s). [rad or m]

    Raises:
        ShapeError: If q or theta does not have the shape above.
    """
    q = np.asarray(q, float)
    if q.ndim != 2 or q.shape[1] != chain.nq:
        raise ShapeError(f"q has shape {q.shape}, expected (n, {chain.nq})")
    if theta is not None and theta.shape != (len(q), chain.n_springs):
        raise ShapeError(f"theta has shape {theta.shape}, expected ({len(q)}, {chain.n_springs})")
    frames, parts = empty_frames(chain, len(q)), chunks(len(q))
    for rows in parts:
        part = chain.take(rows)
        turns = joint_turns(part.compiled, np.ascontiguousarray(q[rows].T))
        elastic = None if theta is None else list(np.ascontiguousarray(theta[rows].T))
        fill_frames(frames, rows, walk_chain(part.compiled, turns, elastic))
    return frames


def chunks(n: int, size: int = CHUNK) -> Iterator[slice]:
    """Divide n poses into parts that fit the cache."""
    return (slice(start, min(start + size, n)) for start in range(0, n, size))


def empty_frames(chain: Chain, n: int) -> Frames:
    """Allocate the frames of n poses, with components first in memory."""
    m, b = len(chain.names), len(chain.body_element)

    def room(*shape: int) -> Array:
        return np.moveaxis(np.empty((*shape, n)), -1, 0)

    ground = np.broadcast_to(np.eye(3), (n, 3, 3)) if chain.ground < 0 else room(3, 3)
    return Frames(room(m, 3), room(m, 3), room(3, 3), room(3), room(b, 3), ground)


def fill_frames(frames: Frames, rows: slice, walk: Walk) -> None:
    """Write a walk into rows of frames from `empty_frames`."""
    for k, (axis, origin) in enumerate(zip(walk.axis, walk.origin, strict=True)):
        frames.axis[rows, k] = axis.T
        frames.origin[rows, k] = origin.T
    for i, column in enumerate(walk.columns):
        frames.tcp_rotation[rows, :, i] = column.T
    frames.tcp_position[rows] = walk.position.T
    for b, centre in enumerate(walk.centre):
        frames.centre[rows, b] = centre.T
    for i, column in enumerate(walk.ground):
        frames.ground[rows, :, i] = column.T


def jacobian(chain: Chain, frames: Frames) -> Array:
    """Compute the geometric Jacobian of the TCP for every element.

    Args:
        chain: The chain.
        frames: Its frames at n poses.

    Returns:
        Linear rows first, base axes. Shape (n, 6, m). [m/rad, rad/rad or m/m, 0]
    """
    n, m = frames.axis.shape[:2]
    columns = np.empty((6, m, n))
    for rows in chunks(n):
        axis = np.moveaxis(frames.axis[rows], 0, -1)
        lever = np.moveaxis(frames.tcp_position[rows, None] - frames.origin[rows], 0, -1)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.subtract(axis[:, j] * lever[:, k], axis[:, k] * lever[:, j], out=columns[i, :, rows])
            columns[3 + i, :, rows] = axis[:, i]
        for element in np.flatnonzero(chain.translates):
            columns[:3, element, rows], columns[3:, element, rows] = axis[element], 0.0
    return np.moveaxis(columns, -1, 0)


def joint_jacobian(chain: Chain, frames: Frames) -> Array:
    """Compute the geometric Jacobian of the TCP for the commanded joints, mimic joints included. Shape (n, 6, nq)."""
    return drive_columns(chain, jacobian(chain, frames))


def drive_columns(chain: Chain, columns: Array) -> Array:
    """Sum the columns of elements by the commanded joint that drives them. Shape (n, rows, m) -> (n, rows, nq)."""
    result = np.zeros((*columns.shape[:2], chain.nq))
    for k in np.flatnonzero(chain.q_index >= 0):
        result[:, :, chain.q_index[k]] += chain.multiplier[k] * columns[:, :, k]
    return result


def locate_gravity(chain: Chain, frames: Frames) -> Array:
    """Return gravity in base axes: shape (n, 3) if a positioner carries the part, otherwise (1, 3). [m/s^2]."""
    return chain.gravity[None] if chain.ground < 0 else np.asarray(frames.ground @ chain.gravity)


def load_elements(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Compute the load of wrench and weights on every element: J^T w + tau_g.

    tau_g,k = a_k . sum_j (c_j - o_k) x m_j g over the bodies beyond element k (a_k . sum_j m_j g where it translates).

    Args:
        chain: The chain.
        frames: Its frames at n poses.
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (1, 6). [N, N m]

    Returns:
        Shape (n, m). [N m or N]
    """
    n, m = frames.axis.shape[:2]
    loads = np.empty((m, n))
    for rows in chunks(n):
        walk = Walk(
            [frames.axis[rows, k].T for k in range(m)],
            [frames.origin[rows, k].T for k in range(m)],
            [],
            frames.tcp_position[rows].T,
            [frames.centre[rows, b].T for b in range(frames.centre.shape[1])],
            [] if chain.ground < 0 else [frames.ground[rows, :, i].T for i in range(3)],
        )
        force = (wrench if len(wrench) == 1 else wrench[rows]).T
        for k, load in enumerate(element_loads(chain.take(rows).compiled, walk, force[:3], force[3:], range(m))):
            loads[k, rows] = load
    return loads.T
