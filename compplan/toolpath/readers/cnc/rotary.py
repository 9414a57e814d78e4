"""Rotary axes A B C of a milling machine in head, table or both, and their kinematics."""

from __future__ import annotations

from collections.abc import Mapping

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine
from compplan.toolpath.readers.frames import UP, Frame, rotate, turn_about
from compplan.toolpath.readers.options import CamTable

#: Tilting axes; their order must be stated if both are used. Otherwise a table C is on the tilt, a head tilt on C.
TILTS = frozenset("AB")
#: Letters of axes, the carrying axis first, and their senses: 1 is a right-hand rotation.
Axes = tuple[tuple[str, float], ...]


class Rotary:
    """Angles of the rotary axes of a program, which rotate the tool (head), the part (table), or both.

    The first table axis passes through `rotary_centre_mm` in the part frame with all axes at 0, the second one is
    displaced from it by `rotary_offset_mm`. The head axes intersect at `pivot_mm` above the tip.
    """

    def __init__(self, options: CamTable) -> None:
        self.options = options
        self.angles: dict[str, float] = {}
        #: Whether A B C are spatial angles of the tool, independent of the machine.
        self.spatial = False
        #: Whether the work offset rotates with the table.
        self.dynamic = False
        self._turned: frozenset[str] = frozenset()
        self._axes: tuple[Axes, Axes] = (), ()

    @property
    def turned(self) -> bool:
        """Whether an axis is not at 0."""
        return any(self.angles.values())

    @property
    def unknown(self) -> bool:
        """Whether axes are not at 0 and the option `rotary` is missing."""
        return self.options.rotary is None and not self.spatial and self.turned

    @property
    def ignored(self) -> bool:
        """Whether rotary words are ignored by option."""
        return self.options.rotary == "ignore"

    @property
    def words(self) -> str:
        """Axes that are not at 0, as words of the program."""
        return " ".join(f"{letter}{angle:g}" for letter, angle in self.angles.items() if angle)

    @property
    def axes(self) -> tuple[Axes, Axes]:
        """Axes of head and table, stated or derived from the axes that the program has used so far."""
        turned = self._turned.union(letter for letter, angle in self.angles.items() if angle)
        if turned != self._turned:
            self._axes, self._turned = self._order_axes(sorted(turned)), turned
        return self._axes

    def _order_axes(self, used: list[str]) -> tuple[Axes, Axes]:
        """Return the axes of head and table; in a head_table the first one is the head axis."""
        kind, stated, missing = self.options.rotary, self.options.axes.rotary_axes, ""
        order = list(stated or (used[::-1] if kind == "head" else used))
        unnamed = [letter for letter in used if letter not in {axis[-1] for axis in order}]
        if unnamed:
            missing = f"rotary_axes with {unnamed[0]}, which the file turns"
        elif stated is None and (set(used) >= TILTS or (kind == "head_table" and len(used) == 2 and "C" not in used)):
            example = "C" if kind == "table" else "B"
            missing = f'rotary_axes = ["A", "{example}"], the axis that carries the other (or the head\'s) first'
        elif kind == "head_table" and len(order) == 1:
            missing = 'rotary = "head" or "table": one axis alone is not both'
        if missing:
            raise InputError(f"of {', '.join(used)}, which carries the other is not known; state {missing}")
        signed = tuple((axis[-1], -1.0 if axis[0] == "-" else 1.0) for axis in order)
        head = {"head": len(order), "head_table": 1}.get(kind or "", 0)
        return signed[:head], signed[head:]

    def point_tool(self, angles: Mapping[str, float] | None = None) -> Point:
        """Return the tool axis in the part frame, T^-1 H z, for given angles [deg] or the current ones.

        Head H = R1 R2 and table T = R1 R2, each with the carrying axis first.
        """
        angles = self.angles if angles is None else angles
        if self.ignored or not any(angles.values()):
            return UP
        head, table = self.axes
        axis = swing((*head[::-1], *((letter, -sense) for letter, sense in table)), angles)
        return axis[0] + 0.0, axis[1] + 0.0, axis[2] + 0.0

    def place(self) -> Frame:
        """Return the frame of the machine coordinates X Y Z in the part, without tool centre point control."""
        placed, stated, angles = Frame(), self.options.axes, self.angles
        if not self.turned or self.unknown or self.ignored or self.spatial:
            return placed
        head, table = self.axes
        if any(angles.get(letter) for letter, _ in head):
            if stated.pivot_mm is None:
                raise self._missing("pivot_mm = the distance from the tool tip to where the rotary axes meet")
            step = combine(1.0, UP, -1.0, swing(head[::-1], angles))
            placed = Frame(origin=combine(stated.pivot_mm, step, 0.0, step))
        if any(angles.get(letter) for letter, _ in table):
            if stated.rotary_centre_mm is None and not self.dynamic:
                raise self._missing("rotary_centre_mm = [x, y, z] of the first table axis as seen from the part zero")
            x, y, z = stated.rotary_centre_mm if stated.rotary_centre_mm and not self.dynamic else (0.0, 0.0, 0.0)
            i, j, k = (0.0, 0.0, 0.0) if self.dynamic else stated.rotary_offset_mm
            for number, (letter, sense) in enumerate(table):
                turn = rotate("ABC".index(letter), -sense * angles.get(letter, 0.0))
                placed = turn_about(combine(1.0, (x, y, z), number, (i, j, k)), turn).then(placed)
        return placed

    def _missing(self, missing: str) -> InputError:
        """Return the error for an unknown tip position due to a missing machine dimension."""
        return InputError(
            f"{self.words} without control of the tip (G43.4, TRAORI, M128): X Y Z are positions of the machine; state "
            f"{missing}, or tip_control = true if they are the tip in the part frame, in NAME.toml of [cam] machine"
        )


def blend(before: Mapping[str, float], after: Mapping[str, float], share: float) -> dict[str, float]:
    """Return the angles after a share of a motion of the rotary axes; axes not named before start at 0."""
    return {letter: before.get(letter, 0.0) * (1.0 - share) + angle * share for letter, angle in after.items()}


def swing(axes: Axes, angles: Mapping[str, float]) -> Point:
    """Return the tool axis after rotations by given angles [deg], in the order of the axes."""
    axis = UP
    for letter, sense in axes:
        axis = rotate("ABC".index(letter), sense * angles.get(letter, 0.0)).turn(axis)
    return axis
