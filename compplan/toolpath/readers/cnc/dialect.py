"""What a dialect gives the interpreter of CNC programs."""

from __future__ import annotations

from typing import Protocol

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.flow import CncProgram
from compplan.toolpath.readers.cnc.state import CncBlock


class Dialect(Protocol):
    """What a dialect gives its interpreter.

    `tip_word` is what it calls control of the tip, where cuts that turn axes without it are not read, else "";
    `frames` the names of its frames, the outermost first, that of a tilted plane is "plane".
    """

    tip_word: str
    frames: tuple[str, ...]
    silent: frozenset[float]
    ends: frozenset[float]

    def square(self) -> Point:
        """Return the tool axis where all rotary axes stand at 0."""
        ...

    def turn_in_plane(self, block: CncBlock) -> tuple[bool, Point | None]:
        """Tell whether rotary words are those of a tilted plane, and the tool axis then."""
        ...

    def run_line(self, program: CncProgram, index: int) -> int:
        """Carry out a line; return the next one, or END."""
        ...
