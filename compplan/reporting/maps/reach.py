"""Joint positions that place the TCP on every point of a plane grid.

The tool direction is selectable: straight (the last three joints at zero, as in published deflection maps), down or
outward by inverse kinematics of the complete pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from compplan.errors import InputError
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import Arm, middle_of_limits, sample_limits, solve_branches

POSTURES = ("straight", "down", "outward")
#: Number of sampled postures for the limits of the workspace.
DRAWN = 20_000
#: Greatest distance of the TCP from a reached point. [m]
REACHED = 1e-9
#: Tolerance of joint limits, which are rounded in files. [rad or m]
ON_LIMIT = 1e-6


@dataclass(frozen=True)
class Plane:
    """A grid of points."""

    name: str  #: "horizontal" or "vertical".
    u: Array  #: First coordinate: x of a horizontal plane, distance from axis 1 of a vertical one. Shape (a,). [m]
    v: Array  #: Second coordinate: y of a horizontal plane, z of a vertical one. Shape (b,). [m]
    level: float  #: Height of a horizontal plane [m], direction of a vertical one about the base's z axis [rad].
    position: Array  #: Points in the base frame. Shape (b, a, 3). [m]


def make_plane(name: str, u: Array, v: Array, level: float, centre: Array | None = None) -> Plane:
    """Build a horizontal plane at a height, or a vertical one in a direction: `level` [m or rad].

    u, v: coordinates, shapes (a,) and (b,) [m]; centre: origin of u in a vertical plane.

    Raises:
        InputError: If the plane is unknown.
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


def reach_plane(arm: Arm, plane: Plane, posture: str) -> Array:
    """Find joint positions inside the limits for every point of a plane, the tool's x axis in its vertical plane.

    posture: "straight": the last three joints at zero; "down": the tool points down; "outward": away from axis one.
    Returns k candidates at each point, NaN for those beyond the limits. Shape (b, a, k, nq). [rad or m]

    Raises:
        InputError: If the posture is unknown, or the robot has fewer than six joints.
    """
    if posture not in POSTURES:
        raise InputError(f"no posture {posture!r}, choose from {list(POSTURES)}")
    if len(arm.arm) < 6:
        raise InputError(f"robot {arm.robot.name!r} has {arm.chain.nq} joints, maps need six or more")
    points = plane.position.reshape(-1, 3)
    if posture == "straight":
        q = _reach_points(arm, points)
    else:
        q = solve_branches(arm, points, _orient_tool(points - stand_of_arm(arm), posture))
    within = (q >= arm.robot.lower - ON_LIMIT) & (q <= arm.robot.upper + ON_LIMIT)
    inside = np.asarray(within.all(axis=-1))
    q = np.where(inside[..., None], q, np.nan)
    return q.reshape(*plane.position.shape[:2], *q.shape[1:])


def stand_of_arm(arm: Arm) -> Array:
    """Intersect the first axis of the arm with z = 0, extra axes in the middle of their limits; shape (3,) [m]."""
    frames = locate_frames(arm.chain, middle_of_limits(arm.robot)[None])
    first = arm.chain.joint_elements[arm.arm[0]]
    origin, axis = frames.origin[0, first], frames.axis[0, first]
    drop = origin[2] / axis[2] if abs(axis[2]) > 0.5 else 0.0
    return np.asarray((origin - drop * axis) * [1.0, 1.0, 0.0])


def working_limits(arm: Arm, posture: str = "straight") -> tuple[float, float, float]:
    """Estimate the reach of the TCP [m]: greatest horizontal distance from `stand_of_arm`, lowest and highest z."""
    q = _draw_postures(arm, straight=posture == "straight")
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


def _draw_postures(arm: Arm, *, straight: bool) -> Array:
    """Sample joint positions evenly inside the limits, other joints in the middle of theirs."""
    q = np.tile(middle_of_limits(arm.robot), (DRAWN, 1))
    moving = arm.arm[:3] if straight else arm.arm
    q[:, moving] = sample_limits(arm.robot, DRAWN)[:, moving]
    if straight:
        q[:, arm.arm[3:]] = 0.0
    return q


def _reach_points(arm: Arm, points: Array) -> Array:
    """Solve the first three joints of the arm for points, the last three at zero. Shape (n, 4, nq).

    Joint one rotates the half-plane of its axis to the target. In that half-plane joints two and three are a planar arm
    of two links, which reaches forward or backward, with its elbow on either side (law of cosines).
    """
    first, second, third = arm.arm[:3]
    rest = middle_of_limits(arm.robot)
    q = np.tile(rest, (len(points), 4, 1))
    q[..., arm.arm] = 0.0
    frames = locate_frames(arm.chain, q[:1, 0])
    axes, origins = (part[0, arm.chain.joint_elements[arm.arm[:3]]] for part in (frames.axis, frames.origin))
    forward = np.cross(axes[1], axes[0])
    if np.linalg.norm(forward) < 1e-6:
        raise InputError("joints one and two of the arm are parallel: it has no map with a straight wrist")
    forward /= np.linalg.norm(forward)
    aside, tip = np.cross(axes[0], forward), frames.tcp_position[0] - origins[0]

    def see(vector: Array) -> Array:
        """Return a vector as a complex number: forward, and along axis one."""
        return np.asarray(vector @ forward + 1j * (vector @ axes[0]))

    upper, lower = see(origins[2] - origins[1]), see(tip + origins[0] - origins[2])
    a, b = np.abs(upper), np.abs(lower)
    offset = points - origins[0]
    height, across = offset @ axes[0], float(tip @ aside)
    distance = np.linalg.norm(offset - height[:, None] * axes[0], axis=1)
    for candidate, (side, elbow) in enumerate(product((1.0, -1.0), (1.0, -1.0))):
        with np.errstate(invalid="ignore"):  # NaN out of reach
            ahead = side * np.sqrt(distance**2 - across**2)
            away = ahead + 1j * height - see(origins[1] - origins[0])
            bend = elbow * np.arccos((np.abs(away) ** 2 - a**2 - b**2) / (2.0 * a * b))
            lift = np.angle(away / (a + b * np.exp(1j * bend)) * a / upper)
        bent = bend - np.angle(lower / upper)
        turn = np.arctan2(offset @ aside, offset @ forward) - np.arctan2(across, ahead)
        for joint, angle in ((first, turn), (second, -lift * (axes[1] @ aside)), (third, -bent * (axes[2] @ aside))):
            q[:, candidate, joint] = angle - 2.0 * np.pi * np.round((angle - rest[joint]) / (2.0 * np.pi))
    known = np.isfinite(q).all(axis=-1)
    missed = np.linalg.norm(locate_frames(arm.chain, q[known]).tcp_position - points[np.nonzero(known)[0]], axis=1)
    q[~known] = np.nan
    q[known] = np.where((missed < REACHED)[:, None], q[known], np.nan)
    return q
