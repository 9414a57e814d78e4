"""Rotary axes of a milling machine: what A B C turn (head, table, or both), and where that puts tool and part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine
from compplan.toolpath.readers.frames import Frame, rotate, turn_about
from compplan.toolpath.readers.options import CamTable

UP: Point = (0.0, 0.0, 1.0)
#: Sets of letters whose order on a machine goes without saying: a table's C sits on its tilt, a head's tilt on its C.
TILTS = frozenset("AB")


def ask_for(angles: Mapping[str, float], missing: str) -> InputError:
    """Return the error that the place of the tip is not known where rotary axes turn by these angles."""
    words = " ".join(f"{letter}{angle:g}" for letter, angle in angles.items())
    return InputError(
        f"{words} without control of the tip (G43.4, TRAORI, M128): X Y Z are positions of the machine; state {missing}"
        ", or tip_control = true if they are the tip in the part frame, in NAME.toml of [cam] machine"
    )


@dataclass(frozen=True)
class RotaryMachine:
    """Hold the rotary axes of a machine: letters and senses of those that turn the tool (head) and the part (table).

    The one that carries the others comes first; positive turns by the right hand where the sense is 1. The first axis
    of the table passes through `centre` in the part frame with all axes at 0, the second stands by `offset` from it,
    and the axes of the head meet at `pivot` above the tip. [mm]
    """

    head: tuple[tuple[str, float], ...] = ()
    table: tuple[tuple[str, float], ...] = ()
    centre: Point | None = None
    offset: Point = (0.0, 0.0, 0.0)
    pivot: float | None = None

    def point_tool(self, angles: Mapping[str, float]) -> Point:
        """Return the tool axis in the part frame: T^-1 H z, angles in degrees.

        Head H = R1 R2 and table T = R1 R2, each the axis that carries the other first.
        """
        axis = UP
        for letter, sense in self.head[::-1]:
            axis = rotate("ABC".index(letter), sense * angles.get(letter, 0.0)).turn(axis)
        for letter, sense in self.table:
            axis = rotate("ABC".index(letter), -sense * angles.get(letter, 0.0)).turn(axis)
        return axis[0] + 0.0, axis[1] + 0.0, axis[2] + 0.0

    def place(self, angles: Mapping[str, float]) -> Frame:
        """Return where positions of the machine stand in the part frame (no control of the tip), angles in degrees."""
        placed = Frame()
        if any(angles.get(letter) for letter, _ in self.head):
            if self.pivot is None:
                raise ask_for(angles, "pivot_mm = the distance from the tool tip to where the rotary axes meet")
            swing = combine(1.0, UP, -1.0, RotaryMachine(self.head).point_tool(angles))
            placed = Frame(origin=combine(self.pivot, swing, 0.0, swing))
        if any(angles.get(letter) for letter, _ in self.table):
            if self.centre is None:
                raise ask_for(angles, "rotary_centre_mm = [x, y, z] of the first table axis, seen from the part zero")
            centre = self.centre
            for letter, sense in self.table:
                turn = rotate("ABC".index(letter), -sense * angles.get(letter, 0.0))
                placed = turn_about(centre, turn).then(placed)
                centre = combine(1.0, centre, 1.0, self.offset)
        return placed


class Rotary:
    """Hold how the rotary axes of a program stand, and what they turn."""

    def __init__(self, options: CamTable) -> None:
        self.options = options
        self.angles: dict[str, float] = {}
        #: Whether A B C are spatial angles of the tool, whatever the machine.
        self.spatial = False
        #: Whether the work offset turns with the table.
        self.dynamic = False
        self._turned: frozenset[str] = frozenset()
        self._machine: RotaryMachine | None = None

    @property
    def turned(self) -> bool:
        """Whether an axis does not stand at 0."""
        return any(self.angles.values())

    @property
    def unknown(self) -> bool:
        """Whether axes stand turned, and nobody says what they turn."""
        return self.options.rotary is None and not self.spatial and self.turned

    @property
    def ignored(self) -> bool:
        """Whether the user leaves rotary words out."""
        return self.options.rotary == "ignore"

    @property
    def words(self) -> str:
        """The axes that stand turned, as words of the program."""
        return " ".join(f"{letter}{angle:g}" for letter, angle in self.angles.items() if angle)

    @property
    def machine(self) -> RotaryMachine:
        """The machine that turns the axes which the program has turned so far."""
        turned = self._turned.union(letter for letter, angle in self.angles.items() if angle)
        if self._machine is None or turned != self._turned:
            self._machine, self._turned = self._build_machine(sorted(turned)), turned
        return self._machine

    def _build_machine(self, used: list[str]) -> RotaryMachine:
        """Return the machine that the user states, of the letters that the file turns.

        Axes stand in order, the one that carries the other first; in a head_table the first is the head's.
        """
        kind, axes, missing = self.options.rotary, self.options.axes, ""
        order = list(axes.rotary_axes or (used[::-1] if kind == "head" else used))
        unnamed = [letter for letter in used if letter not in {axis[-1] for axis in order}]
        if unnamed:
            missing = f"rotary_axes with {unnamed[0]}, which the file turns"
        elif axes.rotary_axes is None and (
            set(used) >= TILTS or (kind == "head_table" and len(used) == 2 and "C" not in used)
        ):
            example = "C" if kind == "table" else "B"
            missing = f'rotary_axes = ["A", "{example}"], the axis that carries the other (or the head\'s) first'
        elif kind == "head_table" and len(order) == 1:
            missing = 'rotary = "head" or "table": one axis alone is not both'
        if missing:
            raise InputError(f"of {', '.join(used)}, which carries the other is not known; state {missing}")
        signed = tuple((axis[-1], -1.0 if axis[0] == "-" else 1.0) for axis in order)
        head = {"head": len(order), "head_table": 1}.get(kind or "", 0)
        centre, (x, y, z) = axes.rotary_centre_mm, axes.rotary_offset_mm
        middle = None if centre is None else (centre[0], centre[1], centre[2])
        return RotaryMachine(signed[:head], signed[head:], middle, (x, y, z), axes.pivot_mm)

    def point_tool(self, angles: Mapping[str, float] | None = None) -> Point:
        """Return the tool axis in the part, for these angles or for those in force."""
        angles = self.angles if angles is None else angles
        return self.machine.point_tool(angles) if any(angles.values()) and not self.ignored else UP

    def place(self) -> Frame:
        """Return where X Y Z of the machine stand in the part, without control of the tip."""
        if not self.turned or self.unknown or self.ignored or self.spatial:
            return Frame()
        zero = (0.0, 0.0, 0.0)
        machine = replace(self.machine, centre=zero, offset=zero) if self.dynamic else self.machine
        return machine.place(self.angles)
