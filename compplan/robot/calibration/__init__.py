"""Calibration files of robot controllers, one file a format: read into a robot, and written from one.

Each format offers `name`, `words`, `recognise(text)`, `read(text, file, nominal) -> Robot` and
`write(robot, nominal, own)`, which returns the text and the robot as the controller then believes it; `write` is None
for a format that is only read.
What a written file has no numbers for is said in `lacks`, what to do with it in `advice`.
A new format is one new file and one line here. Joints stand at the controller's zero at q = 0 here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from compplan.errors import InputError
from compplan.io.plugins import Registry
from compplan.robot import Robot
from compplan.robot.calibration.numbers import OwnFile


class CalibrationFormat(Protocol):
    """What the file of a format offers."""

    name: str
    words: str
    lacks: str
    advice: str
    write: Callable[[Robot, Robot, OwnFile | None], tuple[str, Robot]] | None

    def recognise(self, text: str) -> bool:
        """Tell whether a text is of this format."""
        ...

    def read(self, text: str, file: Path, nominal: Robot) -> Robot:
        """Return the robot with the geometry of the file."""
        ...


_OWN = ("universal_robots", "ur_kinematics", "kuka", "fanuc", "abb")
#: Every format, by its name, which is that of its module.
FORMATS: Registry[CalibrationFormat] = Registry[CalibrationFormat](_OWN, __name__)

#: Files that are known and not read: what their text holds, and why.
REFUSED = {"$DMR_GRP": "FANUC master counts: the joint angles hold them already; lengths stand in symotn.va"}


def find_format(text: str, file: Path) -> CalibrationFormat:
    """Find the format of a calibration file.

    Raises:
        InputError: If no format knows the text, with what is read and what to do instead.
    """
    for form in FORMATS.values():
        if form.recognise(text):
            return form
    known = "; ".join(form.words for form in FORMATS.values())
    reason = next((why for mark, why in REFUSED.items() if mark in text), "no calibration file that is known")
    raise InputError(f"is {reason}, expected {known}; any other robot: measure it and use compplan diagnose", file=file)
