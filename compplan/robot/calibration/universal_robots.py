"""calibration.conf of Universal Robots: corrections of the Denavit-Hartenberg numbers of the type.

The file has four lines of six numbers, delta_theta [rad], delta_a [m], delta_d [m], delta_alpha [rad], which are added
to the numbers of the type. Axes 2, 3 and 4 are nearly parallel, so delta_d may be hundreds of metres; they cancel.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.robot.calibration.geometry import (
    ZeroPose,
    find_zero_pose,
    fit_dh,
    keep_once,
    move_axes,
    read_numbers,
    require_names,
    walk_dh,
)

name = "universal_robots"
words = "calibration.conf of Universal Robots (delta_theta, delta_a, delta_d, delta_alpha)"
KEYS = ["delta_theta", "delta_a", "delta_d", "delta_alpha"]
lacks = "where axis 1 stands in the base, 2 of 6 numbers of the flange"
advice = "keep the robot's own file, put these four lines in place of its own"
LINE = re.compile(r"\s*(delta_\w+)\s*=\s*\[?([^\]#]*)\]?")
#: Greatest difference of a shipped geometry from the numbers of the type. [m, rad]
ROUNDED = 1e-6


def recognise(text: str) -> bool:
    """Return whether a text is a calibration.conf."""
    return re.search(r"^\s*delta_(theta|alpha|a|d)\s*=", text, re.MULTILINE) is not None


def read(text: str, file: Path, nominal: Robot) -> Robot:
    """Return the robot of a calibration.conf.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The shipped robot of this type.

    Raises:
        InputError: If a line is missing or no row of numbers, or the robot is of another make or type.
    """
    found: dict[str, list[float]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        matched = LINE.match(line)
        if matched and matched[1] in KEYS:
            keep_once(found, matched[1], read_numbers(matched[2], 6, matched[1], file, number), file, number)
    require_names(found, KEYS, file)
    dh = find_type(nominal) + np.array([found[key] for key in KEYS]).T
    return move_axes(nominal, walk_dh(dh), file)


def write(robot: Robot, nominal: Robot) -> tuple[str, Robot]:
    """Return the calibration.conf of a robot, and the robot as its controller then models it.

    Args:
        robot: The robot as measured.
        nominal: The shipped robot of this type.

    Raises:
        InputError: If the robots have not the axes of a Universal Robots arm.
    """
    dh = find_type(nominal)
    fitted = fit_dh(find_zero_pose(robot), dh[:, 2])
    lines = [
        f"{key} = [ {', '.join(repr(float(v)) for v in row)}]" for key, row in zip(KEYS, (fitted - dh).T, strict=True)
    ]
    held = move_axes(robot, walk_dh(fitted), robot.name)
    return "[mounting]\n" + "\n".join(lines) + "\n", held


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
        if _differ(zero, walk_dh(dh)) < ROUNDED:
            return dh
    message = f"robot {nominal.name!r} does not have the axes of a Universal Robots arm"
    raise InputError(f"{message}, expected --robot ur5e, ur10e, ...")


def _differ(one: ZeroPose, other: ZeroPose) -> float:
    """Return the greatest difference of two zero poses, points projected onto the axes. [m, rad]."""
    apart = np.cross(one.point - other.point, one.direction)
    parts = (one.direction - other.direction, apart, one.flange - other.flange)
    return max(float(np.abs(part).max()) for part in parts)
