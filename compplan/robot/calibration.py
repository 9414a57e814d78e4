"""Calibration files of Universal Robots: calibration.conf of the controller, kinematics YAML of its ROS driver.

calibration.conf has four lines of six numbers, delta_theta [rad], delta_a [m], delta_d [m], delta_alpha [rad]. They add
to the Denavit-Hartenberg numbers of the type (distal: T = prod_k Rz(q_k + theta_k) Tz(d_k) Tx(a_k) Rx(alpha_k)).
Axes 2, 3 and 4 are nearly parallel, so delta_d may be hundreds of metres; they cancel.

`kinematics:` of the YAML holds shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3 with x y z [m] and roll pitch
yaw [rad], each in the frame before it; a joint turns about z of its frame, the last frame is the flange.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import is_plain
from compplan.robot.model import Array, Joint, Robot
from compplan.robot.pose import build_pose, follow_joints

KEYS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
VALUES = ("x", "y", "z", "roll", "pitch", "yaw")
#: Numbers of each format by name, and how many each name has.
CONF_NUMBERS = dict.fromkeys(KEYS, 6)
YAML_NUMBERS = {f"{link}.{value}": 1 for link in LINKS for value in VALUES}
#: A line `name = [numbers]` of the controller, or `name: number` of the driver.
LINE = re.compile(r"\s*(\w+)\s*[=:]\s*\[?([^\]#]*)")
KNOWN = (
    "calibration.conf of Universal Robots (delta_theta, delta_a, delta_d, delta_alpha); kinematics YAML of the ROS "
    "driver of Universal Robots (x y z roll pitch yaw a link)"
)
#: Greatest displacement of the flange by a calibration; beyond it the file is of another robot. [m]
FARTHEST = 0.1
#: Greatest difference of a shipped geometry from the numbers of the type. [m, rad]
ROUNDED = 1e-6


@dataclass(frozen=True, eq=False)
class ZeroPose:
    """Axes and flange of a robot, all joints at zero, in the base frame."""

    direction: Array  #: Unit vectors of the commanded joints' axes. Shape (n, 3).
    point: Array  #: A point on each axis. Shape (n, 3). [m]
    flange: Array  #: Pose of the flange frame. Shape (4, 4). [m]


def read_calibration(text: str, file: Path, nominal: Robot) -> tuple[Robot, str]:
    """Return the robot of a calibration file, and the name of its format.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The shipped robot of this type.

    Raises:
        InputError: If the text has no known format, a line is missing or has wrong numbers, or the robot is of another
            make or type.
    """
    if re.search("|".join(rf"^\s*{key}\s*=" for key in KEYS), text, re.MULTILINE):
        delta = np.reshape(_read_numbers(text, file, CONF_NUMBERS), (4, 6)).T
        return move_axes(nominal, walk_dh(find_type(nominal) + delta), file), "universal_robots"
    if re.search(r"^\s*(kinematics|shoulder):\s*$", text, re.MULTILINE):
        find_type(nominal)
        pose, frames = np.eye(4), []
        for row in np.reshape(_read_numbers(text, file, YAML_NUMBERS), (6, 6)):
            pose = pose @ build_pose(row[:3], Rotation.from_euler("xyz", row[3:]).as_matrix())
            frames.append(pose)
        stack = np.array(frames)
        return move_axes(nominal, ZeroPose(stack[:, :3, 2], stack[:, :3, 3], pose), file), "ur_kinematics"
    message = f"is not a known calibration file, expected {KNOWN}"
    raise InputError(f"{message}; any other robot: measure it and use compplan diagnose", file=file)


def _read_numbers(text: str, file: Path, expected: Mapping[str, int]) -> list[float]:
    """Return the expected numbers in their order; "link.name" is the line `name` below the line `link:`."""
    found: dict[str, list[float]] = {}
    link = ""
    for line, matched in enumerate(map(LINE.match, text.splitlines()), 1):
        name, words = ("", "") if matched is None else (matched[1], matched[2].strip())
        link = link if words else name or link
        name = name if name in expected else f"{link}.{name}"
        if not words or name not in expected:
            continue
        try:
            values = [float(word) for word in re.split(r"[,\s]+", words)] if is_plain(words) else []
        except ValueError:
            values = []
        if len(values) != expected[name] or not np.isfinite(values).all():
            wanted = "a finite number" if expected[name] == 1 else f"{expected[name]} finite numbers, one per joint"
            raise InputError(f"{name} is {words!r}, expected {wanted}", file=file, where=line)
        if name in found:
            raise InputError(f"{name} is given twice, expected once", file=file, where=line)
        found[name] = values
    if missing := [name for name in expected if name not in found]:
        raise InputError(f"has no {', '.join(missing)}, expected {', '.join(expected)}", file=file)
    return [value for name in expected for value in found[name]]


def find_type(nominal: Robot) -> Array:
    """Return theta, a, d, alpha of each joint of a shipped Universal Robots arm. Shape (6, 4). [rad, m].

    Raises:
        InputError: If its axes are not those of such an arm.
    """
    zero = find_zero_pose(nominal)
    dh = np.zeros((6, 4))
    if len(zero.direction) == 6:
        dh[:, 3] = np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0]) * np.pi / 2
        across, high = zero.flange[1, 3], zero.flange[2, 3]
        dh[0, 2] = zero.point[1, 2]
        dh[1:3, 1] = np.diff(zero.point[1:4, 0])
        dh[3, 2] = -zero.point[4, 1]
        dh[4:, 2] = dh[0, 2] - high, -across - dh[3, 2]
        other = walk_dh(dh)
        apart = np.cross(zero.point - other.point, zero.direction)
        parts = (zero.direction - other.direction, apart, zero.flange - other.flange)
        if max(float(np.abs(part).max()) for part in parts) < ROUNDED:
            return dh
    message = f"robot {nominal.name!r} does not have the axes of a Universal Robots arm"
    raise InputError(f"{message}, expected --robot ur5e, ur10e, ...")


def find_zero_pose(robot: Robot) -> ZeroPose:
    """Return axes and flange of a robot."""
    poses, moving = follow_joints(robot.base, robot.joints, {}), robot.actuated
    direction = np.array([poses[joint.child][:3, :3] @ joint.axis for joint in moving])
    return ZeroPose(direction, np.array([poses[joint.child][:3, 3] for joint in moving]), poses[robot.flange])


def move_axes(nominal: Robot, wanted: ZeroPose, file: object) -> Robot:
    """Move the axes and the flange of a robot, and its link frames as little as possible.

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
            turn = Rotation.align_vectors([axis], [before[:3, :3] @ joint.axis])[0].as_matrix()
            after = build_pose(point + axis * (axis @ (before[:3, 3] - point)), turn @ before[:3, :3])
            index += 1
        if joint.child == nominal.flange:
            after = wanted.flange
        joints.append(replace(joint, placement=np.linalg.inv(last) @ after))
    return replace(nominal, joints=tuple(joints))


def walk_dh(dh: Array) -> ZeroPose:
    """Return axes and flange of theta, a, d, alpha of each joint. Shape (n, 4). [rad, m, m, rad]"""
    pose, direction, point = np.eye(4), [], []
    for theta, a, d, alpha in dh:
        direction.append(pose[:3, 2])
        point.append(pose[:3, 3])
        turn = Rotation.from_euler("z", theta).as_matrix()
        pose = pose @ build_pose(turn @ [a, 0.0, d], turn @ Rotation.from_euler("x", alpha).as_matrix())
    return ZeroPose(np.array(direction), np.array(point), pose)
