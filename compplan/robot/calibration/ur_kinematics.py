"""Kinematics file extracted by the ROS driver of Universal Robots: one frame a joint, each in the one before.

`kinematics:` holds shoulder, upper_arm, forearm, wrist_1, wrist_2, wrist_3 with x y z [m] and roll pitch yaw [rad]; the
joint turns about z of its frame, the first frame counts from the controller's base, the last one is the flange.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.robot import Robot
from compplan.robot.calibration.geometry import ZeroPose, keep_once, move_axes, read_numbers, require_names
from compplan.robot.calibration.universal_robots import find_type
from compplan.robot.pose import build_pose

name = "ur_kinematics"
words = "kinematics YAML of the ROS driver of Universal Robots (x y z roll pitch yaw a link)"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
VALUES = ("x", "y", "z", "roll", "pitch", "yaw")


def recognise(text: str) -> bool:
    """Return whether a text is such a file."""
    return re.search(r"^\s*(kinematics|shoulder):\s*$", text, re.MULTILINE) is not None


def read(text: str, file: Path, nominal: Robot) -> Robot:
    """Return the robot of a kinematics file.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The shipped robot of this type.

    Raises:
        InputError: If a number is missing or none, or the robot is of another make or type.
    """
    find_type(nominal)
    found: dict[str, list[float]] = {}
    link = ""
    for number, line in enumerate(text.splitlines(), 1):
        key, _, value = line.partition("#")[0].strip().partition(":")
        if not value.strip():
            link = key or link
        elif link in LINKS and key in VALUES:
            place = f"{link}.{key}"
            keep_once(found, place, read_numbers(value, 1, place, file, number), file, number)
    require_names(found, [f"{link}.{key}" for link in LINKS for key in VALUES], file)
    pose, frames = np.eye(4), []
    for link in LINKS:
        numbers = [found[f"{link}.{key}"][0] for key in VALUES]
        pose = pose @ build_pose(numbers[:3], Rotation.from_euler("xyz", numbers[3:]).as_matrix())
        frames.append(pose)
    stack = np.array(frames)
    return move_axes(nominal, ZeroPose(stack[:, :3, 2], stack[:, :3, 3], pose), file)
