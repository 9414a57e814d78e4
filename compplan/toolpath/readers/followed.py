"""What every reader of a program holds whose tool is followed on a course: its log, contour, line and rotary axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.contour import Contour
from compplan.toolpath.readers.course import Course
from compplan.toolpath.readers.frames import Frame
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.turning import Rotary


class FollowedReader:
    """Hold what Heidenhain and Sinumerik programs have in common.

    Args:
        file: The program, for messages.
        options: What it does not say by itself.

    """

    def __init__(self, file: Path, options: CamTable) -> None:
        self.file, self.options = file, options
        self.log = MoveLog(options.chord_tolerance_mm, self)
        self.course = Course(self.log, options.from_mm)
        self.contour = Contour(self.course)
        self.line = 0
        #: Why variables have no value.
        self.unknown: dict[str, str] = {}
        self.tip_control = False
        self.rotary = Rotary(options)
        #: Whether a block of X Y Z F alone cuts straight, and does nothing else.
        self.steady = False
        self.feed: float | None = None
        self.spindle = 0.0
        self.turning = ""
        self.cooling = False

    def begin_cut(self) -> None:
        """Let a cut begin where the tool is, before its block says where it ends; refuse it where that is not known."""
        if self.contour.idle:
            self.course.begin_cut()

    def error(self, message: str) -> InputError:
        """Return an error at the block that is read."""
        return InputError(message, file=self.file, where=self.line)

    def set_frame(self, *, carried: bool = False) -> None:
        """Put together what is in force; carried: rotary axes have carried tool or part along."""
        raise NotImplementedError

    def put_frame(self, frame: Frame, *, carried: bool) -> None:
        """Put a frame in force, as `set_frame` found it."""
        if carried:
            self.course.move_frame(frame)
        else:
            self.course.use(frame)

    def point_along(self, vector: Sequence[float], fault: str) -> Point:
        """Return the tool axis that a vector in the coordinates of the program asks for.

        Raises:
            InputError: With this fault, if it has no three numbers, or no direction.

        """
        if len(vector) < 3 or not 1e-3 < math.hypot(*vector) < 1e3:
            raise self.error(fault)
        turned = self.course.frame.turn((vector[0], vector[1], vector[2]))
        size = math.hypot(*turned)
        return turned[0] / size, turned[1] / size, turned[2] / size

    def turn_to(self, angles: Mapping[str, float], square: Point, word: str, *, rapid: bool) -> Point | None:
        """Turn rotary axes; return the tool axis then, None where nobody knows it.

        Args:
            angles: Where they turn to. [deg]
            square: Tool axis where all of them stand at 0, before as after.
            word: Word of control of the tip, for messages.
            rapid: Whether the move is rapid.

        Raises:
            InputError: If they turn in a cut without control of the tip.

        """
        turned = any(self.rotary.angles.values())
        for letter, angle in angles.items():
            self.rotary.take(letter, angle)
        if self.rotary.unknown:
            self.course.lose()
            return None
        if not turned and not any(self.rotary.angles.values()):
            return square
        if not self.tip_control and not self.options.tip_control:
            if not rapid:
                raise self.error(f"a cut on which rotary axes turn without control of the tip ({word}) is not read")
            self.set_frame(carried=True)
        return self.rotary.point_tool()

    def find_direction(self, word: str = "") -> Point:
        """Return the direction in which the contour arrives, in the coordinates of the program.

        Args:
            word: What asks for it, for messages.

        Raises:
            InputError: If nothing is cut right before.

        """
        if self.contour.held is not None:
            return self.contour.held[0].tangent(self.contour.held[0].end)
        if self.course.direction is None or self.contour.approach is not None:
            raise self.error(f"nothing is cut right before this block that it could go on from smoothly{word}")
        back = self.course.frame.invert().turn(self.course.direction)
        size = math.hypot(*back)
        return back[0] / size, back[1] / size, back[2] / size

    def end_running(self) -> None:
        """Switch off at the end what still runs."""
        for running, kind in ((self.turning, "spindle_off"), (self.cooling, "coolant_off")):
            if running:
                self.log.happen(kind, self.line)
