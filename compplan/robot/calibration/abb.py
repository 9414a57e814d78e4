"""MOC.cfg of ABB controllers: what of it says how the arm differs from its type.

A file is a head `MOC:CFG_..`, then types (`ROBOT:`, `ARM_CALIB:`) with instances of `-key value`, a line ending in a
backslash goes on. `ROBOT -base_frame_pos_x ..` [m] and `-base_frame_orient_u0 ..` (w x y z) place the robot's base in
the world frame: documented, written here. `ARM_CALIB -error_offset_x, -error_roll, -error_pitch, -error_jaw,
-error_length` is the Absolute Accuracy model: names are seen in public, frames and signs are not, so a file with such
numbers is refused. Lengths of the type stand in no file of the controller.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.robot.calibration.fit import fit_numbers
from compplan.robot.calibration.geometry import ZeroPose, find_zero_pose, move_axes
from compplan.robot.calibration.numbers import OwnFile, read_numbers
from compplan.robot.pose import apply_twist, build_pose

name = "abb"
words = "MOC.cfg of ABB without Absolute Accuracy"
lacks = "zeros, lengths and directions of the axes (zeros: fine calibration), the flange"
advice = (
    "load it as parameters that replace duplicates; work objects then count from the world frame as it was measured"
)
_WORD = re.compile(r'-(\w+)\s+("[^"]*"|[^\s"-]\S*|-[\d.]\S*)')
_POSITION = ["base_frame_pos_x", "base_frame_pos_y", "base_frame_pos_z"]
_TURN = [f"base_frame_orient_u{k}" for k in range(4)]


def recognise(text: str) -> bool:
    """Tell whether a text is a MOC.cfg."""
    return text.lstrip("\ufeff").startswith("MOC:CFG")


def read(text: str, file: Path, nominal: Robot) -> Robot:
    """Return the robot of a MOC.cfg: the type's own geometry, which the controller believes where nothing corrects it.

    Args:
        text: The text of the file.
        file: The file, for messages.
        nominal: The robot of this type as it ships.

    Raises:
        InputError: If the file holds numbers of the Absolute Accuracy model.
    """
    for line, kind, words_of in _list_instances(text):
        for key, value in words_of.items():
            if kind == "ARM_CALIB" and key != "name" and not value.startswith('"'):
                number = read_numbers(value, 1, f"-{key}", file, line)[0]
                if number != 0.0:
                    message = (
                        f"holds {kind} -{key} {value}: how Absolute Accuracy moves the arm stands in no public document"
                    )
                    hint = "that we know, expected a file without; measure the robot and use compplan diagnose"
                    raise InputError(f"{message} {hint}", file=file, where=line)
    return nominal


def write(robot: Robot, nominal: Robot, own: OwnFile | None = None) -> tuple[str, Robot]:
    """Return parameters that place the robot's base as measured, and the robot that its controller then believes.

    Args:
        robot: The robot as measured.
        nominal: The robot of this type as it ships.
        own: The controller's file as it is now; without it its base frame counts as that of the world.

    Raises:
        InputError: If a number of the controller's file is none.
    """
    zero = find_zero_pose(nominal)

    def walk(numbers: Array) -> ZeroPose:
        moved = apply_twist(numbers)
        turn, flange = moved[:3, :3], moved @ zero.flange
        return ZeroPose(zero.direction @ turn.T, zero.point @ turn.T + moved[:3, 3], flange)

    found = fit_numbers(walk, np.zeros(6), find_zero_pose(robot))
    unit, now = _read_base(own.text, own.file) if own is not None else ("ROB_1", np.eye(4))
    base = now @ apply_twist(found)
    turn = Rotation.from_matrix(base[:3, :3]).as_quat(scalar_first=True)
    said = zip([*_POSITION, *_TURN], [*base[:3, 3], *turn], strict=True)
    lines = " \\\n      ".join(f"-{key} {value:.9g}" for key, value in said)
    text = f'MOC:CFG_1.0:6:1::\n#\nROBOT:\n\n      -name "{unit}" \\\n      {lines}\n'
    return text, move_axes(robot, walk(found), robot.name)


def _read_base(text: str, file: Path) -> tuple[str, Array]:
    """Read name and base frame of the first robot."""
    for line, kind, words_of in _list_instances(text):
        if kind == "ROBOT":
            wanted = dict.fromkeys(_POSITION, "0") | dict.fromkeys(_TURN, "0") | {_TURN[0]: "1"}
            values = [read_numbers(words_of.get(key, wanted[key]), 1, f"-{key}", file, line)[0] for key in wanted]
            if not np.isclose(np.linalg.norm(values[3:]), 1.0, atol=1e-3):
                raise InputError(
                    f"-base_frame_orient_u0 .. are {values[3:]}, expected a unit quaternion", file=file, where=line
                )
            turn = Rotation.from_quat(values[3:], scalar_first=True)
            return words_of.get("name", '"ROB_1"').strip('"'), build_pose(values[:3], turn.as_matrix())
    return "ROB_1", np.eye(4)


def _list_instances(text: str) -> list[tuple[int, str, dict[str, str]]]:
    """List the instances of a file: line of the name, type, value of each key."""
    found: list[tuple[int, str, dict[str, str]]] = []
    kind, goes_on = "", False
    for number, line in enumerate(text.splitlines(), 1):
        content = line.strip()
        if re.fullmatch(r"[A-Z]\w*:", content):
            kind, goes_on = content[:-1], False
        elif content.startswith("-") or goes_on:
            if not goes_on:
                found.append((number, kind, {}))
            found[-1][2].update(_WORD.findall(content))
            goes_on = content.endswith("\\")
    return found
