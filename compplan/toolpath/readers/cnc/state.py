"""A block of a CNC program, its modal state (modes, unit, feed, spindle, tool; millimetres), what a dialect gives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from compplan.toolpath.readers.arcs import Point, set_level
from compplan.toolpath.readers.cnc.flow import CncProgram

AXES, LETTERS = "XYZ", "ABC"
INCH = 25.4
PLANE_NORMALS: dict[int, Point] = {17: (0.0, 0.0, 1.0), 18: (0.0, 1.0, 0.0), 19: (1.0, 0.0, 0.0)}
#: First and second axis of the planes, and the one that a tool points along.
PLANE_AXES = {17: (0, 1), 18: (2, 0), 19: (1, 2)}
DEEP_AXIS = {17: 2, 18: 1, 19: 0}


@dataclass
class CncBlock:
    """Hold the words of a block: numbers by address (X, CR, A3, I1 ..), G codes, M codes, words without a number.

    Args:
        absolute: Addresses whose number is absolute, whatever the mode; relative: counts from where the tool is.
        calls: Names with arguments, as texts.
        assigned: Variables and their values: name, indices, number (None: text).

    """

    values: dict[str, float] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    machine: list[float] = field(default_factory=list)
    absolute: set[str] = field(default_factory=set)
    relative: set[str] = field(default_factory=set)
    names: list[str] = field(default_factory=list)
    calls: list[tuple[str, list[str]]] = field(default_factory=list)
    assigned: list[tuple[str, tuple[float, ...], float | None]] = field(default_factory=list)

    def has(self, addresses: frozenset[str]) -> bool:
        """Return whether the block holds one of these addresses."""
        return not self.values.keys().isdisjoint(addresses)

    def list_axes(self) -> list[int]:
        """List the axes X Y Z that the block names."""
        return [axis for axis, letter in enumerate(AXES) if letter in self.values]


@dataclass
class State:
    """Hold the modal state of a program. A `motion` is 0 to 3 as G0 to G3, CIP, CT, or None before any."""

    scale: float = 1.0
    unit_stated: bool = False
    units: list[str] = field(default_factory=list)
    motion: float | str | None = None
    plane: int = 17
    incremental: bool = False
    #: How I J K count: incremental, absolute or reversed; whether the program says it.
    centres: str = "incremental"
    centres_stated: bool = False
    feed: float | None = None
    feed_mode: int = 94
    #: Millimetres of a unit of F.
    feed_scale: float = 1.0
    spindle: float = 0.0
    turning: str = ""
    cooling: bool = False
    tool: float = 0.0
    tool_name: str = ""
    #: Whether T alone changes the tool, and the file is of a printer.
    changes_by_t: bool = False
    printer: bool = False
    tip_control: bool = False
    #: Whether X Y are radius and angle; pole, its plane, radius and angle in force.
    polar: bool = False
    pole: Point | None = None
    pole_plane: int | None = None
    polar_words: dict[str, float] = field(default_factory=dict)
    #: Radius of every corner from here on (RNDM).
    rounding: float = 0.0
    #: Whether the block at hand cancels the tool's length.
    cancels_length: bool = False
    retract_to_start: bool = True
    cycle_code: float = 0.0
    cycle_start: float | None = None
    cycle: dict[str, float] = field(default_factory=dict)

    def set_unit(self, scale: float, *, feeds: bool = True) -> None:
        """Take a unit: millimetres that a length counts in, and a feed where the word sets those too."""
        self.scale, self.unit_stated = scale, True
        if feeds:
            self.feed_scale = scale
        word = "inch" if scale != 1.0 else "mm"
        if word not in self.units:
            self.units.append(word)

    def set_feed(self, number: float) -> None:
        """Take a feed word; inches count in lengths, not in inverse time."""
        self.feed = number if self.feed_mode == 93 else number * self.feed_scale

    def feed_mm_s(self, length: float) -> float | None:
        """Return the feed of a move of this length [mm] in mm/s, None where no feed is known."""
        if self.feed is None:
            return None
        if self.feed_mode == 93:
            return length * self.feed / 60.0
        if self.feed_mode == 95:
            return self.feed * self.spindle / 60.0 if self.spindle > 0.0 else None
        return self.feed / 60.0

    def counts_on(self, block: CncBlock, address: str) -> bool:
        """Return whether a number of a block counts from where the tool is."""
        return address in block.relative or (self.incremental and address not in block.absolute)

    def centre(self, start: Point, block: CncBlock, plane: int) -> Point:
        """Return the centre of an arc from I J K, as they count in this program."""
        centre, values = start, block.values
        for axis in PLANE_AXES[plane]:
            letter = "IJK"[axis]
            if letter in values:
                number = values[letter] * self.scale
                if self.centres != "absolute" and letter not in block.absolute:
                    number = start[axis] + (-number if self.centres == "reversed" else number)
                centre = set_level(centre, axis, number)
        return centre

    def polar_now(self, place: Point, plane: int) -> Mapping[str, float]:
        """Return radius, in the program's unit, and angle [deg] of a place about the pole."""
        pole, (first, second) = self.pole or (0.0, 0.0, 0.0), PLANE_AXES[plane]
        dx, dy = place[first] - pole[first], place[second] - pole[second]
        return {"RP": math.hypot(dx, dy) / self.scale, "AP": math.degrees(math.atan2(dy, dx))}


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
