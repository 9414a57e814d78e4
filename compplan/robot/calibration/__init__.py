"""Calibration files of robot controllers, one module a format.

A format has `name`, `words`, `recognise(text)` and `read(text, file, nominal) -> Robot`; `universal_robots` also
writes. A new format is one file and one line here. At q = 0 all joints are at the controller's zero.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from compplan.errors import InputError
from compplan.io.plugins import Registry
from compplan.robot import Robot


class CalibrationFormat(Protocol):
    """Interface of a format."""

    name: str
    words: str

    def recognise(self, text: str) -> bool:
        """Return whether a text has this format."""
        ...

    def read(self, text: str, file: Path, nominal: Robot) -> Robot:
        """Return the robot with the geometry of the file."""
        ...


_OWN = ("universal_robots", "ur_kinematics")
#: Every format by the name of its module.
FORMATS: Registry[CalibrationFormat] = Registry[CalibrationFormat](_OWN, __name__)


def find_format(text: str, file: Path) -> CalibrationFormat:
    """Find the format of a calibration file.

    Raises:
        InputError: If no format recognises the text, with the formats and a remedy.
    """
    for form in FORMATS.values():
        if form.recognise(text):
            return form
    known = "; ".join(form.words for form in FORMATS.values())
    message = f"is no calibration file that is known, expected {known}"
    raise InputError(f"{message}; any other robot: measure it and use compplan diagnose", file=file)
