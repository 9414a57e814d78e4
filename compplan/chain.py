"""The elastic chain: a robot as a row of one-degree-of-freedom elements, evaluated for many poses at once.

Every commanded joint, every spring and every elementary motion of an elastic link is one element: a constant placement,
then a rotation or translation along a constant axis [virtual joint method, Salisbury1980]. Positions of commanded
joints are `q`, those of elastic elements `theta`. All quantities are in base axes and SI.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.robot import Array, Joint, Robot
from compplan.sweep import CHUNK, Program, Walk, compile_chain, element_loads, joint_turns, walk_chain

ELASTIC_AXES = {
    "tx": (True, (1.0, 0.0, 0.0)),
    "ty": (True, (0.0, 1.0, 0.0)),
    "tz": (True, (0.0, 0.0, 1.0)),
    "rx": (False, (1.0, 0.0, 0.0)),
    "ry": (False, (0.0, 1.0, 0.0)),
    "rz": (False, (0.0, 0.0, 1.0)),
}


@dataclass(frozen=True)
class Chain:
    """Elements from the base to the TCP, m of them, with the masses they carry.

    Placements, axes, masses and compliances may have a leading batch axis: one set of parameters a pose. The arrays of
    a chain are not changed in place: `dataclasses.replace` makes a new chain.

    Attributes:
        names: Name of each element: a joint's name, or "joint.axis" / "link.axis" of an elastic one. Length m.
        rotation: Orientation of the element frame in the frame before it. Shape (..., m, 3, 3).
        position: Origin of the element frame in the frame before it. Shape (..., m, 3). [m]
        axis: Unit vector of the motion in the element frame. Shape (..., m, 3).
        translates: Which elements translate. Shape (m,).
        q_index: Commanded joint that drives the element, -1 for an elastic one. Shape (m,).
        multiplier: Factor on q (mimic joints, otherwise 1). Shape (m,).
        q_offset: Constant added to multiplier * q. Shape (..., m). [rad or m]
        theta_index: Elastic coordinate that drives the element, -1 for a commanded one. Shape (m,).
        tcp_rotation: Orientation of the TCP in the frame of the last element. Shape (..., 3, 3).
        tcp_position: TCP in the frame of the last element. Shape (..., 3). [m]
        body_element: Element after whose motion a body hangs, -1 for the base. Shape (b,).
        mass: Masses of the bodies. Shape (..., b). [kg]
        centre: Centres of the bodies in their element's frame after its motion. Shape (..., b, 3). [m]
        compliance: Compliance of the elastic coordinates. Shape (..., s, s). [rad, m per N m, N]
        gravity: Gravity in base axes, zero where the robot carries none. Shape (3,). [m/s^2]
        actuator: Which elastic coordinates lie between motor-side and link-side encoder. Shape (s,).
        joint_elements: Element of each commanded joint. Shape (nq,).
    """

    names: tuple[str, ...]
    rotation: Array
    position: Array
    axis: Array
    translates: NDArray[np.bool_]
    q_index: NDArray[np.int_]
    multiplier: Array
    q_offset: Array
    theta_index: NDArray[np.int_]
    tcp_rotation: Array
    tcp_position: Array
    body_element: NDArray[np.int_]
    mass: Array
    centre: Array
    compliance: Array
    gravity: Array
    actuator: NDArray[np.bool_]
    joint_elements: NDArray[np.int_]

    @property
    def nq(self) -> int:
        """Count the commanded joints."""
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
    def program(self) -> Program:
        """The chain prepared for walking."""
        return compile_chain(self)

    @property
    def batched(self) -> bool:
        """Tell whether the chain holds one set of parameters a pose."""
        return any(getattr(self, name).ndim > own and len(getattr(self, name)) > 1 for name, own in _OWN_AXES.items())

    def take(self, rows: slice) -> Chain:
        """Take the parameter sets of some poses; a chain with one set for all poses returns itself."""
        if not self.batched:
            return self
        fields = {name: getattr(self, name) for name in _OWN_AXES}
        cut = {k: v[rows] for k, v in fields.items() if v.ndim > _OWN_AXES[k] and len(v) > 1}
        return replace(self, **cut)


_OWN_AXES = {
    "rotation": 3, "position": 2, "axis": 2, "q_offset": 1, "tcp_rotation": 2, "tcp_position": 1,
    "mass": 1, "centre": 2, "compliance": 2,
}  # fmt: skip


class Frames(NamedTuple):
    """Where a chain stands; n poses.

    Attributes:
        axis: Axis of each element, base axes. Shape (n, m, 3).
        origin: Origin of each element, base frame. Shape (n, m, 3). [m]
        tcp_rotation: Orientation of the TCP in the base frame. Shape (n, 3, 3).
        tcp_position: TCP in the base frame. Shape (n, 3). [m]
        centre: Centres of the masses in the base frame. Shape (n, b, 3). [m]
    """

    axis: Array
    origin: Array
    tcp_rotation: Array
    tcp_position: Array
    centre: Array


def build_chain(robot: Robot, *, gravity: bool = True) -> Chain:
    """Build the elastic chain of a robot.

    Springs act after the motion of their joint in the order they are listed; the 6x6 elasticity of a link acts at its
    far end, tx ty tz rx ry rz in this order.

    Args:
        robot: The robot.
        gravity: Whether the robot's gravity loads the springs.
    """
    builder = _ChainBuilder()
    bodies = {link: [body for body in robot.bodies if body.link == link] for link in {b.link for b in robot.bodies}}
    builder.add_bodies(bodies.get(robot.base, []))
    for count, joint in enumerate(robot.joints):
        builder.move(joint.placement)
        if joint.kind != "fixed":
            builder.add_joint(joint, robot.joint_names)
        for spring in robot.springs:
            if spring.joint == joint.name:
                translates, axis = _spring_axis(spring.axis, joint)
                builder.move(_translation(spring.offset))
                builder.add_elastic(spring.name, axis, translates, spring.compliance, spring.actuator)
                builder.move(_translation(-spring.offset))
        builder.add_bodies(bodies.get(joint.child, []))
        following = robot.joints[count + 1] if count + 1 < len(robot.joints) else None
        for block in (b for b in robot.link_elasticities if b.link == joint.child):
            far_end = np.eye(4) if following is None else following.placement
            builder.move(far_end)
            builder.add_link(block.link, block.compliance)
            builder.move(np.asarray(np.linalg.inv(far_end), float))
    return builder.finish(robot, gravity)


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
        turns = joint_turns(part.program, np.ascontiguousarray(q[rows].T))
        elastic = None if theta is None else list(np.ascontiguousarray(theta[rows].T))
        fill_frames(frames, rows, walk_chain(part.program, turns, elastic))
    return frames


def chunks(n: int) -> Iterator[slice]:
    """Cut n poses into pieces that stay in the cache."""
    return (slice(start, min(start + CHUNK, n)) for start in range(0, n, CHUNK))


def empty_frames(chain: Chain, n: int) -> Frames:
    """Make room for the frames of n poses: poses first to the reader, components first in memory."""
    m, b = len(chain.names), len(chain.body_element)

    def room(*shape: int) -> Array:
        return np.moveaxis(np.empty((*shape, n)), -1, 0)

    return Frames(room(m, 3), room(m, 3), room(3, 3), room(3), room(b, 3))


def fill_frames(frames: Frames, rows: slice, walk: Walk) -> None:
    """Write a walk into the rows of frames that `empty_frames` made."""
    for k, (axis, origin) in enumerate(zip(walk.axis, walk.origin, strict=True)):
        frames.axis[rows, k] = axis.T
        frames.origin[rows, k] = origin.T
    for i, column in enumerate(walk.columns):
        frames.tcp_rotation[rows, :, i] = column.T
    frames.tcp_position[rows] = walk.position.T
    for b, centre in enumerate(walk.centre):
        frames.centre[rows, b] = centre.T


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
    columns = jacobian(chain, frames)
    result = np.zeros((len(columns), 6, chain.nq))
    for k in np.flatnonzero(chain.q_index >= 0):
        result[:, :, chain.q_index[k]] += chain.multiplier[k] * columns[:, :, k]
    return result


def gravity_torque(chain: Chain, frames: Frames) -> Array:
    """Compute the load that the weights put on every element.

    tau_k = a_k . (sum_j (c_j - o_k) x m_j g) over the bodies beyond element k (a_k . sum_j m_j g where it translates).

    Args:
        chain: The chain.
        frames: Its frames at n poses.

    Returns:
        Generalised load on each element. Shape (n, m). [N m or N]
    """
    n, m = frames.axis.shape[:2]
    if not chain.gravity.any() or not len(chain.body_element):
        return np.zeros((n, m))
    return load_elements(chain, frames, np.zeros((1, 6)))


def load_elements(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Compute the load of wrench and weights on every element: J^T w + tau_g.

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
        )
        force = (wrench if len(wrench) == 1 else wrench[rows]).T
        for k, load in enumerate(element_loads(chain.take(rows).program, walk, force[:3], force[3:], range(m))):
            loads[k, rows] = load
    return loads.T


def _spring_axis(axis: str, joint: Joint) -> tuple[bool, Array]:
    if axis == "own":
        return joint.kind == "prismatic", joint.axis
    translates, direction = ELASTIC_AXES[axis]
    return translates, np.array(direction)


def _translation(offset: Array) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


class _ChainBuilder:
    """Collect elements while walking from the base to the TCP."""

    def __init__(self) -> None:
        self.pending = np.eye(4)
        self.elements: list[tuple[str, Array, Array, bool, int, float, float, int]] = []
        self.bodies: list[tuple[int, float, Array]] = []
        self.blocks: list[Array] = []
        self.actuator: list[bool] = []

    def move(self, pose: Array) -> None:
        self.pending = self.pending @ pose

    def _append(
        self, name: str, axis: Array, translates: bool, q: int, multiplier: float, offset: float, theta: int
    ) -> None:
        self.elements.append((name, self.pending, axis, translates, q, multiplier, offset, theta))
        self.pending = np.eye(4)

    def add_joint(self, joint: Joint, names: tuple[str, ...]) -> None:
        driver, multiplier, offset = joint.name, 1.0, 0.0
        if joint.mimic is not None:
            driver, multiplier, offset = joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset
        translates = joint.kind == "prismatic"
        self._append(joint.name, joint.axis, translates, names.index(driver), multiplier, offset, -1)

    def add_elastic(self, name: str, axis: Array, translates: bool, compliance: float, actuator: bool) -> None:
        self._append(name, axis, translates, -1, 0.0, 0.0, len(self.actuator))
        self.blocks.append(np.array([[compliance]]))
        self.actuator.append(actuator)

    def add_link(self, link: str, compliance: Array) -> None:
        for name, (translates, axis) in ELASTIC_AXES.items():
            self._append(f"{link}.{name}", np.array(axis), translates, -1, 0.0, 0.0, len(self.actuator))
            self.actuator.append(False)
        self.blocks.append(compliance)

    def add_bodies(self, bodies: list) -> None:  # type: ignore[type-arg]
        for body in bodies:
            centre = self.pending[:3, :3] @ body.centre + self.pending[:3, 3]
            self.bodies.append((len(self.elements) - 1, body.mass, centre))

    def finish(self, robot: Robot, gravity: bool) -> Chain:
        from scipy.linalg import block_diag

        names, poses, axes, translates, q, multiplier, offset, theta = zip(*self.elements, strict=True)
        pose = np.array(poses)
        driver = {name: k for k, name in enumerate(names) if q[k] >= 0}
        g = robot.gravity if gravity and robot.gravity is not None else np.zeros(3)
        return Chain(
            names=tuple(names),
            rotation=pose[:, :3, :3].copy(),
            position=pose[:, :3, 3].copy(),
            axis=np.array(axes),
            translates=np.array(translates, bool),
            q_index=np.array(q, int),
            multiplier=np.array(multiplier, float),
            q_offset=np.array(offset, float),
            theta_index=np.array(theta, int),
            tcp_rotation=self.pending[:3, :3].copy(),
            tcp_position=self.pending[:3, 3].copy(),
            body_element=np.array([body[0] for body in self.bodies], int),
            mass=np.array([body[1] for body in self.bodies], float),
            centre=np.array([body[2] for body in self.bodies], float).reshape(-1, 3),
            compliance=block_diag(*self.blocks) if self.blocks else np.zeros((0, 0)),
            gravity=np.asarray(g, float),
            actuator=np.array(self.actuator, bool),
            joint_elements=np.array([driver[name] for name in robot.joint_names], int),
        )
