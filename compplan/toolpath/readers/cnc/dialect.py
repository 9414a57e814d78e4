"""What a dialect gives the interpreter of CNC programs."""

from __future__ import annotations

from typing import Protocol

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.flow import CncProgram
from compplan.toolpath.readers.cnc.state import CncBlock
from compplan.toolpath.readers.frames import Frame


class Dialect(Protocol):
    """What a dialect gives its interpreter.

    `tip_word` is what it calls control of the tip, where cuts that turn axes without it are not read, else "";
    `tilted` whether the tool stands along the axis of a tilted plane.
    """

    tip_word: str
    silent: frozenset[float]
    ends: frozenset[float]

    @property
    def tilted(self) -> bool: ...  # noqa: D102

    def find_frame(self) -> Frame:
        """Return where the coordinates of the program stand, rotary axes aside."""
        ...

    def square(self) -> Point:
        """Return the tool axis where all rotary axes stand at 0."""
        ...

    def turn_in_plane(self, block: CncBlock) -> tuple[bool, Point | None]:
        """Tell whether rotary words are those of a tilted plane, and the tool axis then."""
        ...

    def run_line(self, program: CncProgram, index: int) -> int:
        """Carry out a line; return the next one, or END."""
        ...
