"""What every reader of a program holds whose tool is followed on a course: its log, contour, line and rotary axes."""

from __future__ import annotations

from pathlib import Path

from compplan.errors import InputError
from compplan.path.cam.contour import Contour
from compplan.path.cam.course import Course
from compplan.path.cam.moves import MoveLog
from compplan.path.cam.options import CamTable
from compplan.path.cam.turning import Rotary


class FollowedReader:
    """Hold what Heidenhain and Sinumerik programs have in common.

    Args:
        file: The program, for messages.
        options: What it does not say by itself.

    """

    def __init__(self, file: Path, options: CamTable) -> None:
        self.file, self.options = file, options
        self.log = MoveLog(options.chord_tolerance_mm)
        self.course = Course(self.log)
        self.contour = Contour(self.course)
        self.line = 0
        #: Why variables have no value.
        self.unknown: dict[str, str] = {}
        self.tip_control = False
        self.rotary = Rotary(options)
        #: Whether a block of X Y Z F alone cuts straight, and does nothing else.
        self.steady = False

    def error(self, message: str) -> InputError:
        """Return an error at the block that is read."""
        return InputError(message, file=self.file, where=self.line)

    def end_running(self, turning: str, *, cooling: bool) -> None:
        """Switch off at the end what still runs."""
        for running, kind in ((turning, "spindle_off"), (cooling, "coolant_off")):
            if running:
                self.log.happen(kind, self.line)
