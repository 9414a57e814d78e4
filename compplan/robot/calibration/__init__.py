"""Calibration files of robot controllers, one file a format: read into a robot, and written from one.

Each format offers `name`, `words`, `recognise(text)` and `read(text, file, nominal) -> Robot`. `universal_robots` also
writes its file. A new format is one new file and one line here. All joints are at the controller's zero at q = 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from compplan.errors import InputError
from compplan.io.plugins import Registry
from compplan.robot import Robot


class CalibrationFormat(Protocol):
    """What the file of a format offers."""

    name: str
    words: str

    def recognise(self, text: str) -> bool:
        """Tell whether a text is of this format."""
        ...

    def read(self, text: str, file: Path, nominal: Robot) -> Robot:
        """Return the robot with the geometry of the file."""
        ...


_OWN = ("universal_robots", "ur_kinematics")
#: Every format, by its name, which is that of its module.
FORMATS: Registry[CalibrationFormat] = Registry[CalibrationFormat](_OWN, __name__)


def find_format(text: str, file: Path) -> CalibrationFormat:
    """Find the format of a calibration file.

    Raises:
        InputError: If no format knows the text, with what is read and what to do instead.
    """
    for form in FORMATS.values():
        if form.recognise(text):
            return form
    known = "; ".join(form.words for form in FORMATS.values())
    message = f"is no calibration file that is known, expected {known}"
    raise InputError(f"{message}; any other robot: measure it and use compplan diagnose", file=file)
