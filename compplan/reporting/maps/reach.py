"""Reach a plane: joint positions that put the TCP on every point of a grid, elbow up and elbow down.

How the tool points is a choice: straight (the last three joints at zero, as deflection maps in papers have it) or down,
sideways, ... by inverse kinematics of the whole pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames
from compplan.statics.ik import Arm, middle_of_limits, name_configuration, solve_branches

POSTURES = ("straight", "down", "outward")
ELBOWS = ("up", "down")
TABLE = 20_000
"""Postures that are tabulated to start the position solver from."""
REACHED = 1e-9
ON_LIMIT = 1e-6
"""A joint that exceeds a limit by no more stands on it: limits in files are rounded. [rad or m]"""
FAR = 0.1
"""Points that far from every tabulated posture are out of reach. [m]"""


@dataclass(frozen=True)
class Plane:
    """A grid of points.

    Attributes:
        name: "horizontal" or "vertical".
        u: First coordinate: x of a horizontal plane, distance from axis 1 of a vertical one. Shape (a,). [m]
        v: Second coordinate: y of a horizontal plane, z of a vertical one. Shape (b,). [m]
        level: Height of a horizontal plane [m], direction of a vertical one about the base's z axis [rad].
        position: Points in the base frame. Shape (b, a, 3). [m]
    """

    name: str
    u: Array
    v: Array
    level: float
    position: Array


@dataclass(frozen=True)
class ReachedPlane:
    """Joint positions on a plane, the candidates of each elbow apart; NaN where there is none inside the limits.

    Attributes:
        plane: The plane.
        posture: How the tool points.
        q: Joint positions: elbow up then down, candidates of each. Shape (b, a, 2, k, nq). [rad or m]
    """

    plane: Plane
    posture: str
    q: Array


def make_plane(name: str, u: Array, v: Array, level: float, centre: Array | None = None) -> Plane:
    """Build a horizontal plane at a height, or a vertical one in a direction: `level` [m or rad].

    u, v: coordinates, shapes (a,) and (b,) [m]; centre: point of a vertical plane, from which u counts.

    Raises:
        InputError: If there is no such plane.
    """
    first, second = np.meshgrid(u, v)
    if name == "horizontal":
        position = np.stack([first, second, np.full_like(first, level)], axis=-1)
    elif name == "vertical":
        x, y = (0.0, 0.0) if centre is None else centre[:2]
        position = np.stack([x + first * np.cos(level), y + first * np.sin(level), second], axis=-1)
    else:
        raise InputError(f"no plane {name!r}, choose from ['horizontal', 'vertical']")
    return Plane(name, np.asarray(u, float), np.asarray(v, float), float(level), position)


def reach_plane(arm: Arm, plane: Plane, posture: str = "down") -> ReachedPlane:
    """Find joint positions inside the limits for every point of a plane, the tool's x axis in its vertical plane.

    posture: "straight": the last three joints at zero; "down": the tool points down; "outward": away from axis one.

    Raises:
        InputError: If there is no such posture, or the robot has fewer than six joints.
    """
    if posture not in POSTURES:
        raise InputError(f"no posture {posture!r}, choose from {list(POSTURES)}")
    if len(arm.arm) < 6:
        raise InputError(f"robot {arm.robot.name!r} has {arm.chain.nq} joints, maps need six or more")
    points = plane.position.reshape(-1, 3)
    if posture == "straight":
        q = _reach_points(arm, points)
    else:
        slots = solve_branches(arm, points, _orient_tool(points - stand_of_arm(arm), posture))
        q = np.stack([slots[:, (0, 1, 4, 5)], slots[:, (2, 3, 6, 7)]], axis=1)
    within = (q >= arm.robot.lower - ON_LIMIT) & (q <= arm.robot.upper + ON_LIMIT)
    inside = np.asarray(within.all(axis=-1))
    q = np.where(inside[..., None], q, np.nan)
    return ReachedPlane(plane, posture, q.reshape(*plane.position.shape[:2], *q.shape[1:]))


def stand_of_arm(arm: Arm) -> Array:
    """Locate where the arm's first axis meets z = 0, extra axes in the middle of their limits; shape (3,) [m]."""
    frames = locate_frames(arm.chain, middle_of_limits(arm.robot)[None])
    first = arm.chain.joint_elements[arm.arm[0]]
    origin, axis = frames.origin[0, first], frames.axis[0, first]
    drop = origin[2] / axis[2] if abs(axis[2]) > 0.5 else 0.0
    return np.asarray((origin - drop * axis) * [1.0, 1.0, 0.0])


def working_limits(arm: Arm, posture: str = "straight") -> tuple[float, float, float]:
    """Find how far and how high the TCP gets [m]: greatest distance from the stand of the arm, lowest and highest z."""
    q = _tabulate(arm, straight=posture == "straight")
    position = locate_frames(arm.chain, q).tcp_position - stand_of_arm(arm)
    height = position[:, 2]
    return float(np.hypot(position[:, 0], position[:, 1]).max()), float(height.min()), float(height.max())


def _orient_tool(points: Array, posture: str) -> Array:
    """Build orientations of the TCP frame whose z axis is the direction in which the tool points. Shape (n, 3, 3)."""
    distance = np.hypot(points[:, 0], points[:, 1])
    outward = np.zeros_like(points)
    outward[:, 0] = np.where(distance > 1e-9, points[:, 0] / np.maximum(distance, 1e-9), 1.0)
    outward[:, 1] = np.where(distance > 1e-9, points[:, 1] / np.maximum(distance, 1e-9), 0.0)
    down = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    z, x = (down, outward) if posture == "down" else (outward, down)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _tabulate(arm: Arm, *, straight: bool) -> Array:
    """Draw joint positions inside the limits, evenly, held joints in the middle of theirs."""
    from scipy.stats import qmc

    lower = np.maximum(arm.robot.lower, -np.pi)
    upper = np.minimum(arm.robot.upper, np.pi)
    q = np.tile(middle_of_limits(arm.robot), (TABLE, 1))
    moving = arm.arm[:3] if straight else arm.arm
    q[:, moving] = (lower + qmc.Halton(len(lower), seed=0).random(TABLE) * (upper - lower))[:, moving]
    if straight:
        q[:, arm.arm[3:]] = 0.0
    return q


def _reach_points(arm: Arm, points: Array) -> Array:
    """Solve the first three joints of the arm for points, the last three at zero. Shape (n, 2, 2, nq).

    Joint one turns the arm about its axis; what joints two and three do shows in the half-plane of that axis: distance
    from it (signed: reaching forward or over the back) and height along it.
    """
    half = _half_plane(arm)
    table = _tabulate_half_plane(arm)
    forward, along, across = half.coordinates(arm, table)
    named = name_configuration(arm, _bend_wrist(arm, table))
    offset = points - half.origin
    height = offset @ half.axis
    distance = np.linalg.norm(offset - height[:, None] * half.axis, axis=1)
    q = np.full((len(points), 2, 2, arm.chain.nq), np.nan)
    for elbow in range(2):
        for side, sign in enumerate((1.0, -1.0)):
            members = np.flatnonzero(((named // 2) % 2 == elbow) & (np.sign(forward) == sign))
            if not len(members):
                continue
            radius = np.hypot(forward[members], across[members])
            tree = cKDTree(np.column_stack([radius, along[members]]))
            gap, nearest = tree.query(np.column_stack([distance, height]), distance_upper_bound=FAR)
            near = np.flatnonzero(np.isfinite(gap))
            found = _newton(arm, half, table[members[nearest[near]]], distance[near], height[near], sign)
            found[:, arm.arm[0]] = _azimuth(arm, half, found, offset[near])
            q[near, elbow, side] = _keep_reached(arm, found, points[near], elbow)
    return q


@dataclass(frozen=True)
class _HalfPlane:
    """Axis one, and the directions across it and forward along the arm while joint one stands at zero."""

    origin: Array
    axis: Array
    forward: Array
    across: Array

    def coordinates(self, arm: Arm, q: Array) -> tuple[Array, Array, Array]:
        """Locate the TCP forward, along the axis and across; joint one of q stands at zero."""
        offset = locate_frames(arm.chain, q).tcp_position - self.origin
        return offset @ self.forward, offset @ self.axis, offset @ self.across


def _half_plane(arm: Arm) -> _HalfPlane:
    q = middle_of_limits(arm.robot)
    q[arm.arm] = 0.0
    frames = locate_frames(arm.chain, q[None])
    first, second = arm.chain.joint_elements[arm.arm[:2]]
    axis, origin = frames.axis[0, first], frames.origin[0, first]
    forward = np.cross(frames.axis[0, second], axis) * arm.front
    if np.linalg.norm(forward) < 1e-6:
        raise InputError("joints one and two of the arm are parallel: it has no map with a straight wrist")
    forward /= np.linalg.norm(forward)
    return _HalfPlane(origin, axis, forward, np.cross(axis, forward))


def _tabulate_half_plane(arm: Arm) -> Array:
    """Tabulate joints two and three inside their limits, the others at zero or held."""
    second, third = arm.arm[1:3]
    count = int(np.sqrt(TABLE))
    sides = [
        np.linspace(max(arm.robot.lower[j], -np.pi), min(arm.robot.upper[j], np.pi), count) for j in (second, third)
    ]
    q = np.tile(middle_of_limits(arm.robot), (count * count, 1))
    q[:, arm.arm] = 0.0
    q[:, second], q[:, third] = (side.ravel() for side in np.meshgrid(*sides))
    return q


def _newton(arm: Arm, half: _HalfPlane, q: Array, distance: Array, height: Array, sign: float) -> Array:
    """Move joints two and three until the TCP has the wanted distance from axis one and height along it."""
    q, moving = np.array(q), arm.arm[1:3]
    busy = np.arange(len(q))
    for _ in range(14):
        frames = locate_frames(arm.chain, q[busy])
        offset = frames.tcp_position - half.origin
        across = offset @ half.across
        wanted = sign * np.sqrt(np.maximum(distance[busy] ** 2 - across**2, 0.0))
        error = np.column_stack([wanted - offset @ half.forward, height[busy] - offset @ half.axis])
        missed = np.abs(error).max(axis=1)
        todo: NDArray[np.int_] = np.flatnonzero(missed > 1e-13)
        if not todo.size:
            break
        linear = joint_jacobian(arm.chain, frames)[todo][:, :3, moving]
        columns = np.einsum("ci,nij->ncj", np.array([half.forward, half.axis]), linear)
        busy, error, missed = busy[todo], error[todo], missed[todo]
        normal = np.swapaxes(columns, 1, 2) @ columns + (1e-4 * missed)[:, None, None] * np.eye(2)
        step = np.linalg.solve(normal, np.swapaxes(columns, 1, 2) @ error[..., None])[..., 0]
        q[np.ix_(busy, moving)] += step * np.minimum(1.0, 0.4 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    return q


def _azimuth(arm: Arm, half: _HalfPlane, q: Array, offset: Array) -> Array:
    """Turn joint one so that the TCP points where the target does."""
    forward, _, across = half.coordinates(arm, q)
    wanted = np.arctan2(offset @ half.across, offset @ half.forward)
    angle = np.asarray(wanted - np.arctan2(across, forward))
    rest = float(middle_of_limits(arm.robot)[arm.arm[0]])
    return angle - 2 * np.pi * np.round((angle - rest) / (2 * np.pi))


def _keep_reached(arm: Arm, q: Array, points: Array, elbow: int) -> Array:
    missed = np.linalg.norm(points - locate_frames(arm.chain, q).tcp_position, axis=1)
    same = (name_configuration(arm, _bend_wrist(arm, q)) // 2) % 2 == elbow
    return np.where(((missed < REACHED) & same)[:, None], q, np.nan)


def _bend_wrist(arm: Arm, q: Array) -> Array:
    """Bend the wrist a little, so that its configuration has a name."""
    bent = np.array(q)
    bent[:, arm.arm[4]] += 0.1
    return bent
