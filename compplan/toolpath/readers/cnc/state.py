"""Modal state of a CNC program: position, modes, work offsets, feed. Millimetres throughout."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from compplan.toolpath.readers.arcs import Point


@dataclass
class Offsets:
    """Hold the work offsets that a program sets, and the one in force.

    Args:
        active: Code of the offset in force; G54 where none was named.
        origins: Origin of each offset that G10 L2 set, seen from the machine, by axis.

    """

    active: float = 54.0
    origins: dict[float, dict[int, float]] = field(default_factory=dict)

    def set_origin(self, number: int, values: Mapping[int, float]) -> dict[int, float]:
        """Take G10 L2 P number; return by how much the offset in force moves, by axis.

        Raises:
            ValueError: If the offset in force changes and what it was is not known.

        """
        code = self.active if number == 0 else 53.0 + number if number <= 6 else 59.0 + (number - 6) / 10.0
        before = self.origins.setdefault(code, {})
        moved = {axis: value - before[axis] for axis, value in values.items() if axis in before}
        unknown = values.keys() - before.keys()
        before.update(values)
        if code != self.active:
            return {}
        if unknown:
            raise ValueError
        return moved

    def switch(self, code: float) -> Point | None:
        """Put another offset in force; return how far the origin moves [mm], None where nobody knows."""
        old, new = self.origins.get(self.active, {}), self.origins.get(code, {})
        changed, self.active = code != self.active, code
        if not changed:
            return 0.0, 0.0, 0.0
        if len(old) < 3 or len(new) < 3:
            return None
        return new[0] - old[0], new[1] - old[1], new[2] - old[2]

    def from_machine(self, axis: int, value: float) -> float | None:
        """Return a machine coordinate as the offset in force counts it; None where its origin is not known."""
        origin = self.origins.get(self.active, {}).get(axis)
        return None if origin is None else value - origin


def name_offset(code: float) -> str:
    """Return the name of a work offset: G54, G59.1, G54.1 P12."""
    return f"G54.1 P{code - 1000.0:g}" if code >= 1000.0 else f"G{code:g}"


def find_offset(name: str) -> float | None:
    """Return the code of a work offset by its name (G54, G59.1, G54.1 P12, G154 P12, G505), None for other names."""
    found = re.fullmatch(r"G(54\.1|154)\s*P(\d{1,3})", name.strip().upper())
    if found:
        return 1000.0 + float(found.group(2))
    found = re.fullmatch(r"G(5[4-9](?:\.\d)?|5\d\d)", name.strip().upper())
    return float(found.group(1)) if found else None


AXES = "XYZ"
#: A length that has no decimal point is less than this, else it may count in increments. [mm]
FARTHEST_WITHOUT_POINT = 10_000.0
PLANE_NORMALS = {17: (0.0, 0.0, 1.0), 18: (0.0, 1.0, 0.0), 19: (1.0, 0.0, 0.0)}
PLANE_AXES = {17: (0, 1), 18: (0, 2), 19: (1, 2)}


@dataclass
class State:
    """Hold the modal state of a program.

    Positions stand in the frame that is in force at the first cut; `origin` is where the program's own origin stands
    in it since then (G92, G52), `base` where that of the work offset in force does. `kept_origin` is what G92.3 brings
    back, `declared` the axes whose place is known by G92 alone.
    """

    scale: float
    centres: str
    position: Point = (0.0, 0.0, 0.0)
    motion: float | None = None
    plane: int = 17
    incremental: bool = False
    centres_stated: bool = False
    unit_stated: bool = False
    units: list[str] = field(default_factory=list)
    feed: float | None = None
    feed_mode: int = 94
    spindle: float = 0.0
    turning: str = ""
    cooling: bool = False
    tool: float = 0.0
    tool_name: str = ""
    changes_by_t: bool = False
    origin: Point = (0.0, 0.0, 0.0)
    kept_origin: Point | None = None
    declared: set[int] = field(default_factory=set)
    shift: Point = (0.0, 0.0, 0.0)
    base: Point = (0.0, 0.0, 0.0)
    offsets: Offsets = field(default_factory=Offsets)
    known: set[int] = field(default_factory=set)
    lost: set[int] = field(default_factory=set)
    moved: bool = False
    tip_control: bool = False
    #: Whether the block at hand cancels the tool's length.
    cancels_length: bool = False
    #: Whether the file is of a Siemens control, or of a printer.
    siemens: bool = False
    printer: bool = False
    rotary: dict[str, float] = field(default_factory=dict)
    polar: bool = False
    polar_word: list[float] = field(default_factory=lambda: [0.0, 0.0])
    retract_to_start: bool = True
    cycle_code: float = 0.0
    cycle_start: float | None = None
    cycle: dict[str, float] = field(default_factory=dict)

    def set_unit(self, scale: float) -> None:
        """Take a unit: millimetres a word counts in."""
        self.scale, self.unit_stated = scale, True
        word = "inch" if scale != 1.0 else "mm"
        if word not in self.units:
            self.units.append(word)

    def target(self, values: Mapping[str, float], axes: Iterable[int]) -> Point:
        """Return where the coordinates of a block lead; axes that it does not name stay."""
        point = list(self.position)
        for axis in axes:
            letter = AXES[axis]
            if letter not in values:
                continue
            number = values[letter] * self.scale
            if self.incremental:
                point[axis] += number
            else:
                point[axis] = number + self.zero(axis)
                self.lost.discard(axis)
                self.known.add(axis)
        return point[0], point[1], point[2]

    def zero(self, axis: int) -> float:
        """Return where the program's origin stands."""
        return self.origin[axis] + self.shift[axis] + self.base[axis]

    def knows_position(self) -> bool:
        """Return whether the tool's place is known, or a cut has begun."""
        return not self.lost and (self.moved or len(self.known) == 3)

    def lose(self, axes: Iterable[int]) -> None:
        """Take axes to a place that nobody knows."""
        self.lost.update(axes)
        self.known.difference_update(axes)

    def list_unknown(self) -> list[int]:
        """List the axes whose place is not known."""
        return [axis for axis in range(3) if axis in self.lost or (not self.moved and axis not in self.known)]

    def settle(self, axes: Iterable[int]) -> None:
        """Take the place of axes as known."""
        self.known.update(axes)
        self.lost.difference_update(axes)

    def set_origin(self, coordinates: Mapping[int, float]) -> None:
        """Give the present position new coordinates (G92), in program units.

        Where nobody knows the position they are its place; else the origin moves, before the first cut as after it.
        """
        position, origin = list(self.position), list(self.origin)
        for axis, number in coordinates.items():
            value = number * self.scale
            if axis in self.lost or (axis not in self.known and not self.moved):
                position[axis] = value + self.zero(axis)
                self.lost.discard(axis)
                self.known.add(axis)
                self.declared.add(axis)
            else:
                origin[axis] = position[axis] - value - self.shift[axis] - self.base[axis]
        self.position = position[0], position[1], position[2]
        self.origin = self.kept_origin = origin[0], origin[1], origin[2]

    def set_shift(self, coordinates: Mapping[int, float]) -> None:
        """Shift the program's origin (G52), in program units."""
        shift = list(self.shift)
        for axis, number in coordinates.items():
            shift[axis] = number * self.scale
        self.shift = shift[0], shift[1], shift[2]

    def clear_origin(self, *, keep: bool) -> None:
        """Drop what G92 set (G92.1), or keep it for G92.3 (G92.2)."""
        if not keep:
            self.kept_origin = (0.0, 0.0, 0.0)
        self.origin = (0.0, 0.0, 0.0)

    def set_feed(self, number: float) -> None:
        """Take a feed word; inches count in lengths, not in inverse time."""
        self.feed = number if self.feed_mode == 93 else number * self.scale

    def feed_mm_s(self, length: float) -> float | None:
        """Return the feed of a move of this length [mm] in mm/s, None where no feed is known."""
        if self.feed is None:
            return None
        if self.feed_mode == 93:
            return length * self.feed / 60.0
        if self.feed_mode == 95:
            return self.feed * self.spindle / 60.0 if self.spindle > 0.0 else None
        return self.feed / 60.0

    def centre(self, start: Point, values: Mapping[str, float], plane: tuple[int, int]) -> Point:
        """Return the centre of an arc from I J K, as they count in this program [mm]."""
        centre = list(start)
        for axis in plane:
            letter = ("I", "J", "K")[axis]
            if self.centres == "absolute":
                if letter in values:
                    centre[axis] = values[letter] * self.scale + self.zero(axis)
            else:
                sign = -1.0 if self.centres == "reversed" else 1.0
                centre[axis] += sign * values.get(letter, 0.0) * self.scale
        return centre[0], centre[1], centre[2]

    def turn(self, values: Mapping[str, float]) -> dict[str, float]:
        """Take the rotary words of a block [deg]; return the angles before."""
        before = dict(self.rotary)
        for letter in "ABC":
            if letter in values:
                self.rotary[letter] = values[letter] + (self.rotary.get(letter, 0.0) if self.incremental else 0.0)
        return before
