"""The machine that a control program moves: where it stands, in which frame, how its axes count.

Positions are kept in the frame of the program, in millimetres; what nobody has said is NaN. A move is recorded once
all of its end is known: before that, and after a move to a place that only the machine knows, there is no point of the
part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from tests.oracles.cam.moves import ARC, LINE, NAN, RAPID, CannotTellError, Recorder

#: First and second axis of a plane, and the one across it.
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
#: Greatest difference of an arc's radius at its start and its end, in mm and as a share of it.
ROUND_MM, ROUND_SHARE = 0.02, 0.002
Matrix = tuple[tuple[float, float, float], ...]
UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def turn_about(axis: int, degrees: float) -> Matrix:
    """Return the right-handed rotation about x, y or z (0, 1, 2)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    if degrees % 90.0 == 0.0:
        c, s = round(c), round(s)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rows = [list(row) for row in UNIT]
    rows[i][i] = rows[j][j] = c
    rows[i][j], rows[j][i] = -s, s
    return tuple((row[0], row[1], row[2]) for row in rows)


def multiply(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices."""
    rows = [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    return tuple((row[0], row[1], row[2]) for row in rows)


def transpose(a: Matrix) -> Matrix:
    """Return the transpose."""
    return tuple((a[0][j], a[1][j], a[2][j]) for j in range(3))


def carry(a: Matrix, vector: Sequence[float]) -> list[float]:
    """Return a matrix times a vector; what is unknown touches only what depends on it."""
    return [sum(a[i][j] * vector[j] for j in range(3) if a[i][j] != 0.0) for i in range(3)]


@dataclass
class DrivenMachine:
    """Where a machine stands and what it has done.

    Attributes:
        at: Place in the frame of the program. [mm]
        matrix, shift: From the program's frame to the part's.
        feed: As programmed, mm/min, mm/turn or 1/min as `feed_mode` (94, 95, 93) says; None before the first.
        axis: Tool axis in the part frame, tip to spindle.
        homed: Whether it has gone to a place of the machine.
        been_home: Whether it has left the part for a place of the machine.
        height: Greatest height of a rapid move so far, part frame. [mm]
        left: Where it left the part for a place of the machine, or None.
        start: Where cuts begin whose start the file leaves open, part frame, or None. [mm]

    """

    record: Recorder = field(default_factory=Recorder)
    at: list[float] = field(default_factory=lambda: [NAN, NAN, NAN])
    matrix: Matrix = UNIT
    shift: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    plane: int = 17
    feed: float | None = None
    feed_mode: int = 94
    spindle: float = 0.0
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)
    been_home: bool = False
    homed: bool = False
    height: float = -math.inf
    left: list[float] | None = None
    start: Sequence[float] | None = None

    def place(self, point: Sequence[float]) -> list[float]:
        """Return a point of the program's frame in the part frame."""
        moved = carry(self.matrix, point)
        return [moved[i] + self.shift[i] for i in range(3)]

    def set_frame(self, matrix: Matrix, shift: Sequence[float]) -> None:
        """Change the program's frame; the machine stays where it is."""
        here = self.place(self.at)
        self.matrix, self.shift = matrix, list(shift)
        self.at = carry(transpose(matrix), [here[i] - self.shift[i] for i in range(3)])

    def speed(self, length: float) -> float:
        """Return the feed of a cut of a length. [mm/s]."""
        if self.feed is None:
            return 0.0
        if self.feed_mode == 95:
            return self.feed * self.spindle / 60.0
        if self.feed_mode == 93:
            return self.feed * length / 60.0
        return self.feed / 60.0

    def straight(self, kind: int, target: Sequence[float], *, drill: bool = False, speed: float | None = None) -> None:
        """Move to a place of the program's frame on a line."""
        if kind != RAPID:
            target = self.begin_cut(target, through=not drill)
        start, self.at = self.at, list(target)
        if not any(map(math.isnan, self.at)):
            kind = RAPID if any(map(math.isnan, start)) and not self.record.rows else kind
            self._come_back(kind)
            length = math.dist(start, target)
            rate = self.speed(0.0 if math.isnan(length) else length) if speed is None else speed
            self.record.move(kind, self.place(self.at), rate, self.axis, drill=drill)

    def begin_cut(self, target: Sequence[float], *, through: bool = False) -> list[float]:
        """Let a cut begin where nobody has said: at zero by custom, where the machine has not been elsewhere.

        Args:
            target: Where it leads.
            through: Whether it may begin at home, whose place the machine keeps: then it is no move of the part.

        """
        unknown = [k for k in range(3) if math.isnan(self.at[k])]
        if not unknown:
            return list(target)
        if self.start is not None:
            here = carry(transpose(self.matrix), [self.start[k] - self.shift[k] for k in range(3)])
            self.rapid([here[k] if k in unknown else self.at[k] for k in range(3)])
            return [self.at[k] if math.isnan(target[k]) else target[k] for k in range(3)]
        if self.homed and not self.record.rows and through:
            return list(target)  # a printer on its way from home
        if self.homed or self.been_home or self.matrix != UNIT:
            raise CannotTellError("a cut from where only the machine knows", self.record.line)
        for k in unknown:
            self.at[k] = -self.shift[k]
        self.record.note("the first cut starts from zero where the file has not said where")
        self.record.move(RAPID, self.place(self.at), 0.0, self.axis)
        return [self.at[k] if math.isnan(target[k]) else target[k] for k in range(3)]

    def _come_back(self, kind: int) -> None:
        """Come back from where only the machine knows: sideways at the greater height of where it left and arrives."""
        place = self.place(self.at)
        if self.left is not None:
            over = [place[0], place[1], max(self.left[2], place[2])]
            if over not in (place, self.left):
                self.record.move(RAPID, over, 0.0, self.axis)
        self.left = None
        if kind == RAPID:
            self.height = max(self.height, place[2])

    def rapid(self, target: Sequence[float]) -> None:
        """Move fast."""
        self.straight(RAPID, target)

    def line(self, target: Sequence[float], *, drill: bool = False) -> None:
        """Cut along a line."""
        self.straight(LINE, target, drill=drill)

    def arc(
        self, target: Sequence[float], centre: Sequence[float], clockwise: bool, turns: int = 0,
        plane: int | None = None,
    ) -> None:  # fmt: skip
        """Cut an arc or a helix about a centre in the plane; the centre's height across the plane does not count."""
        i, j, k = PLANES[plane or self.plane]
        start = self.at
        sx, sy = start[i] - centre[i], start[j] - centre[j]
        ex, ey = target[i] - centre[i], target[j] - centre[j]
        radius, last = math.hypot(sx, sy), math.hypot(ex, ey)
        if radius <= 0.0 or abs(radius - last) > ROUND_MM + ROUND_SHARE * radius:
            raise CannotTellError(f"an arc whose radius goes from {radius:g} to {last:g} mm", self.record.line)
        sweep = math.atan2(sx * ey - sy * ex, sx * ex + sy * ey)
        whole = math.hypot(target[i] - start[i], target[j] - start[j]) < 1e-6
        if clockwise:
            sweep = -2.0 * math.pi if whole else sweep - 2.0 * math.pi if sweep > 0.0 else sweep
            sweep -= 2.0 * math.pi * turns
        else:
            sweep = 2.0 * math.pi if whole else sweep + 2.0 * math.pi if sweep < 0.0 else sweep
            sweep += 2.0 * math.pi * turns
        middle = [0.0, 0.0, 0.0]
        middle[i], middle[j], middle[k] = centre[i], centre[j], start[k]
        across = [0.0, 0.0, 0.0]
        across[k] = 1.0
        length = math.hypot(abs(sweep) * radius, target[k] - start[k])
        self.at = list(target)
        self.record.move(
            ARC, self.place(target), self.speed(length), self.axis, centre=tuple(self.place(middle)),
            normal=tuple(carry(self.matrix, across)), sweep=sweep,
        )  # fmt: skip

    def radius_centre(self, target: Sequence[float], radius: float, clockwise: bool) -> list[float]:
        """Return the centre of an arc with a radius; a negative one takes the longer way round."""
        i, j, _ = PLANES[self.plane]
        dx, dy = target[i] - self.at[i], target[j] - self.at[j]
        chord = math.hypot(dx, dy)
        if chord <= 0.0:
            raise CannotTellError("an arc with a radius that ends where it starts", self.record.line)
        lack = radius * radius - 0.25 * chord * chord
        if lack < -(ROUND_MM + ROUND_SHARE * abs(radius)) * abs(radius):
            raise CannotTellError(f"an arc of radius {abs(radius):g} mm over {chord:g} mm", self.record.line)
        height = math.sqrt(max(lack, 0.0))
        side = -1.0 if clockwise == (radius > 0.0) else 1.0
        centre = list(self.at)
        centre[i] = 0.5 * (self.at[i] + target[i]) - side * height * dy / chord
        centre[j] = 0.5 * (self.at[j] + target[j]) + side * height * dx / chord
        return centre

    def forget(self, axes: Sequence[int]) -> None:
        """Some axes went to a place that only the machine knows."""
        self.homed = True
        self.been_home = self.been_home or not any(math.isnan(self.at[axis]) for axis in axes)
        here = self.place(self.at)
        if not any(map(math.isnan, here)):
            if 2 in axes and here[2] < self.height:  # home lies above: the way there leads up
                here[2] = self.height
                self.record.move(RAPID, here, 0.0, self.axis)
            self.left = list(here)
        for axis in axes:
            here[axis] = NAN
        self.at = carry(transpose(self.matrix), [here[n] - self.shift[n] for n in range(3)])
