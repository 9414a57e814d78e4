"""Joint axes at the zero pose and their Denavit-Hartenberg numbers.

Distal Denavit-Hartenberg convention: T = prod_k Rz(q_k + theta_k) Tz(d_k) Tx(a_k) Rx(alpha_k).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import is_plain
from compplan.robot import Array, Joint, Robot
from compplan.robot.pose import build_pose, move_joint

#: Angle below which axes count as parallel: 1 um at one metre. [rad]
PARALLEL = 1e-6
#: Greatest displacement of the flange by a calibration; beyond it the file is of another robot. [m]
FARTHEST = 0.1


@dataclass(frozen=True, eq=False)
class ZeroPose:
    """Axes and flange of a robot, all joints at zero, in the base frame."""

    direction: Array  #: Unit vectors of the commanded joints' axes. Shape (n, 3).
    point: Array  #: A point on each axis. Shape (n, 3). [m]
    flange: Array  #: Pose of the flange frame. Shape (4, 4). [m]


def find_zero_pose(robot: Robot) -> ZeroPose:
    """Return axes and flange of a robot."""
    pose, frames, flange = np.eye(4), [], np.eye(4)
    for joint in robot.joints:
        pose = pose @ joint.placement
        if joint.actuated:
            frames.append((pose[:3, :3] @ joint.axis, pose[:3, 3]))
        if joint.child == robot.flange:
            flange = pose
    return ZeroPose(np.array([axis for axis, _ in frames]), np.array([point for _, point in frames]), flange)


def move_axes(nominal: Robot, wanted: ZeroPose, file: object) -> Robot:
    """Return a robot with given axes and flange and the least change of its link frames.

    Args:
        nominal: The robot, its flange fixed to its last link.
        wanted: Axes and flange at the zero pose.
        file: Source of the values, for messages.

    Raises:
        InputError: If the flange moves implausibly far.
    """
    old = find_zero_pose(nominal)
    far = float(np.linalg.norm(wanted.flange[:3, 3] - old.flange[:3, 3]))
    if not far <= FARTHEST:
        message = f"moves the flange of {nominal.name} by {far * 1e3:.4g} mm, expected at most {FARTHEST * 1e3:g} mm"
        raise InputError(f"{message}; is it of another robot?", file=str(file))
    joints: list[Joint] = []
    before, after, index = np.eye(4), np.eye(4), 0
    for joint in nominal.joints:
        before, last = before @ joint.placement, after
        after = after @ joint.placement
        if joint.actuated:
            axis, point = wanted.direction[index], wanted.point[index]
            turn = _turn_between(before[:3, :3] @ joint.axis, axis)
            after = build_pose(point + axis * (axis @ (before[:3, 3] - point)), turn @ before[:3, :3])
            index += 1
        if joint.child == nominal.flange:
            after = wanted.flange
        joints.append(replace(joint, placement=np.linalg.inv(last) @ after))
    return replace(nominal, joints=tuple(joints))


def turn_zeros(robot: Robot, q: Array) -> Robot:
    """Return the robot with the zeros of its joints at q. Shape (n,). [rad or m]"""
    joints, index = [], 0
    for joint in robot.joints:
        if joint.actuated:
            joint, index = replace(joint, placement=joint.placement @ move_joint(joint, q[index])), index + 1
        joints.append(joint)
    return replace(robot, joints=tuple(joints))


def _turn_between(old: Array, new: Array) -> Array:
    """Return the smallest rotation between two unit vectors. Shape (3, 3)."""
    normal = np.cross(old, new)
    sine = float(np.linalg.norm(normal))
    if sine == 0.0:
        return np.eye(3)
    return np.asarray(Rotation.from_rotvec(normal / sine * np.arctan2(sine, old @ new)).as_matrix())


def walk_dh(dh: Array) -> ZeroPose:
    """Return axes and flange of Denavit-Hartenberg numbers.

    Args:
        dh: theta, a, d, alpha of each joint. Shape (n, 4). [rad, m, m, rad]
    """
    pose, direction, point = np.eye(4), [], []
    for theta, a, d, alpha in dh:
        direction.append(pose[:3, 2])
        point.append(pose[:3, 3])
        pose = pose @ frame_dh(theta, a, d, alpha)
    return ZeroPose(np.array(direction), np.array(point), pose)


def fit_dh(zero: ZeroPose, d_parallel: Array) -> Array:
    """Return the Denavit-Hartenberg numbers of axes and a flange, by the common normals of neighbouring axes.

    They cannot express the place of axis 1 in the base (4 numbers) and 2 of the 6 numbers of the flange.

    Args:
        zero: Axes and flange at the zero pose.
        d_parallel: Distance along an axis used where the next one is parallel. Shape (n,). [m]

    Returns:
        theta, a, d, alpha of each joint. Shape (n, 4). [rad, m, m, rad]
    """
    first, point = zero.direction[0], zero.point[0]
    pose, numbers = build_pose(point - first * (first @ point), _turn_between(np.eye(3)[2], first)), []
    for k in range(len(zero.direction)):
        last = k + 1 == len(zero.direction)
        to = np.linalg.inv(pose)
        axis = to[:3, :3] @ (zero.flange[:3, 2] if last else zero.direction[k + 1])
        point = to[:3, :3] @ (zero.flange[:3, 3] if last else zero.point[k + 1]) + to[:3, 3]
        if last:
            theta, d = np.arctan2(*(to[:3, :3] @ zero.flange[:3, 0])[[1, 0]]), point[2]
        else:
            theta, d = _common_normal(axis, point, d_parallel[k])
        normal = np.array([np.cos(theta), np.sin(theta), 0.0])
        across = np.array([-np.sin(theta), np.cos(theta), 0.0])
        a, alpha = float(normal @ point), float(np.arctan2(-across @ axis, axis[2]))
        numbers.append((theta, a, d, alpha))
        pose = pose @ frame_dh(*numbers[-1])
    return np.array(numbers)


def _common_normal(axis: Array, point: Array, d_parallel: float) -> tuple[float, float]:
    """Return direction about z [rad] and height on z [m] of the common normal of z and another axis."""
    sine = float(np.hypot(axis[0], axis[1]))
    if sine < PARALLEL:
        normal, height = point[:2] - axis[:2] * point[2] / axis[2], d_parallel
    else:
        level = axis[:2] / sine
        normal, height = np.array([axis[1], -axis[0]]), float(point[2] - axis[2] / sine * (level @ point[:2]))
    if normal[0] < 0.0:  # choose the sense with a turn of at most 90 degrees
        normal = -normal
    return float(np.arctan2(normal[1], normal[0])), height


def frame_dh(theta: float, a: float, d: float, alpha: float) -> Array:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha). Shape (4, 4). [rad, m]"""
    turn = Rotation.from_euler("z", theta).as_matrix()
    return build_pose(turn @ [a, 0.0, d], turn @ Rotation.from_euler("x", alpha).as_matrix())


def read_numbers(words: str, count: int, name: str, file: Path, line: int) -> list[float]:
    """Read finite numbers separated by commas or spaces.

    Raises:
        InputError: If they are not `count` finite numbers.
    """
    try:
        values = [float(word) for word in re.split(r"[,\s]+", words.strip())] if is_plain(words) else []
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        expected = "a finite number" if count == 1 else f"{count} finite numbers, one a joint"
        raise InputError(f"{name} is {words.strip()!r}, expected {expected}", file=file, where=line)
    return values


def keep_once(found: dict[str, list[float]], name: str, values: list[float], file: Path, line: int) -> None:
    """Store the value of a line.

    Raises:
        InputError: If an earlier line has set it.
    """
    if name in found:
        raise InputError(f"{name} is given twice, expected once", file=file, where=line)
    found[name] = values


def require_names(found: dict[str, list[float]], names: list[str], file: Path) -> None:
    """Refuse a file that lacks a name.

    Raises:
        InputError: With the missing names.
    """
    if missing := [name for name in names if name not in found]:
        raise InputError(f"has no {', '.join(missing)}, expected {', '.join(names)}", file=file)
