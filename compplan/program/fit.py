"""As few moves as the path needs: lines and arcs through rows of a program, within a tolerance of all its rows.

A fitted move begins and ends at rows of the program, an arc also goes through one between them. Every row that is left
out lies within the tolerance of the move that stands for it, and the arc between two rows within it of their chord. The
tool turns evenly along a move. Where the plan's speed changes by more than `FEED`, another move begins, so that each
takes the time that the plan takes for it. A move that the controller would not have the time for is joined to a
neighbour, or else driven slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.files.tables import Array
from compplan.program.frames import quaternions
from compplan.program.program import Program

#: Greatest ratio of two speeds within a move.
FEED = 1.01
#: Cycles below which a move may join rows of any speed.
SHORT = 2.0
#: Greatest turn of the tool beside an even one. [rad]
TURN = float(np.radians(0.01))
#: Greatest departure of joints that carry the part from an even motion. [deg or mm]
CARRIED = 0.02
#: Rows that an arc has to go by, its length [mm], greatest radius [mm], and greatest sweep [rad].
ARC_ROWS, ARC_LENGTH, ARC_RADIUS, ARC_SWEEP = 2, 0.25, 2e4, float(np.radians(170.0))
#: Least share of an arc at which the point between may lie, at either end.
MIDDLE = 0.2
#: Rows that are looked at at once, and how a search goes on from a move that fits.
BLOCK, GROW = 2048, 1.6


@dataclass(frozen=True)
class Fitted:
    """Hold a fitted program.

    Args:
        program: The program at the ends of its moves; `via` of it are poses that arcs go through.
        rows: The row of each in the whole program. Shape (m,).
        slowed: How many moves are driven slower than planned, so that the controller has the time for them.

    """

    program: Program
    rows: NDArray[np.int_]
    slowed: int = 0


def fit_moves(program: Program, *, arcs: bool = True) -> Fitted:
    """Fit lines and arcs to the linear moves of a program; one without a tolerance stays as it is.

    Args:
        program: The program, with poses; `tolerance` and `cycle` of it say how closely, and the least time of a move.
        arcs: Whether the language has arcs.

    """
    n = len(program)
    if program.tolerance <= 0.0 or program.tcp is None or program.time is None or n < 2:
        return Fitted(program, np.arange(n))
    track = _Track(program, 1e3 * program.tolerance, arcs)
    alone = program.alone(linear=True)
    kept = np.flatnonzero(alone | program.stops(linear=True) | _mark_ends(program))
    pieces: list[tuple[int, int]] = []
    for first, last in zip(kept[:-1].tolist(), kept[1:].tolist(), strict=True):
        pieces += [(last, -1)] if alone[last] else track.divide(first, last)
    ends = np.array([0, *(end for end, _ in pieces)])
    middle = np.array([-1, *(via for _, via in pieces)])
    return _take_rows(program, track, ends, middle)


def _mark_ends(program: Program) -> NDArray[np.bool_]:
    """Mark the first and the last row, where something happens, and where the speed begins or ceases to matter."""
    marked = np.zeros(len(program), bool)
    marked[[0, -1]] = True
    marked[[event.place for event in program.events if event.place >= 0]] = True
    if program.free is not None:
        marked[:-1] |= program.free[1:] != program.free[:-1]
    return marked


def _take_rows(program: Program, track: _Track, ends: NDArray[np.int_], middle: NDArray[np.int_]) -> Fitted:
    """Return the program at some of its rows, with the feed that takes the time of the plan."""
    assert program.tcp is not None and program.time is not None
    length = np.array([0.0, *(track.measure(a, b, m) for a, b, m in zip(ends[:-1], ends[1:], middle[1:], strict=True))])
    time, cut = np.diff(program.time[ends], prepend=0.0), ~program.alone(linear=True)[ends]
    cut[0] = False
    short = cut & (time < program.cycle * (1.0 - 1e-9))
    moved = cut & (length > 0.0) & (time > 0.0)
    feed = program.feed[ends].copy()
    feed[moved] = length[moved] / np.maximum(time, program.cycle)[moved]
    via = np.full((len(ends), 4, 4), np.nan)
    via[middle >= 0] = program.tcp[middle[middle >= 0]]
    place = np.searchsorted(ends, [event.place for event in program.events])
    events = [
        replace(event, place=int(new) if event.place >= 0 else -1)
        for event, new in zip(program.events, place, strict=True)
    ]
    some: dict[str, Any] = {
        name: None if (values := getattr(program, name)) is None else values[ends]
        for name in ("joints", "rapid", "exact", "time", "tcp", "status", "bent", "free", "coarser")
    }
    words, native = ({key: values[ends] for key, values in table.items()} for table in (program.words, program.native))
    fewer = replace(
        program, **some, feed=feed, via=via, words=words, native=native, events=tuple(events), tolerance=0.0
    )
    return Fitted(fewer, ends, int(np.count_nonzero(short)))


class _Track:
    """The tip along a program's rows: what a line or an arc between two of them leaves."""

    def __init__(self, program: Program, tolerance: float, arcs: bool) -> None:
        assert program.time is not None
        poses = program.positions
        self.x, self.turn, self.time = 1e3 * poses[:, :3, 3], quaternions(poses), program.time
        self.tolerance, self.arcs, self.cycle = np.full(len(program), tolerance), arcs, program.cycle
        self.tolerance *= 1.0 if program.coarser is None else program.coarser
        self.step = np.linalg.norm(np.diff(self.x, axis=0, prepend=self.x[:1]), axis=1)
        self.along = np.cumsum(self.step)
        lasts = np.diff(program.time, prepend=program.time[0])
        self.speed = self.step / np.maximum(lasts, 1e-9)
        self.carried = program.joints[:, program.carries] if program.moves_part else np.zeros((len(program), 0))
        self.free = np.zeros(len(program), bool) if program.free is None else program.free
        self.guess = 4

    def divide(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return end and middle row (-1: a line) of each move from one row to another."""
        pieces: list[tuple[int, int]] = []
        at = first
        while at < last:
            end, middle = self._reach(at, self._bound_speed(at, last))
            pieces.append((end, middle))
            at = end
        return self._lengthen(first, pieces)

    def _reach(self, at: int, most: int) -> tuple[int, int]:
        """Return how far one move from a row leads at most, and the middle of it where it is an arc."""
        end = self._search(at, most, min(at + self.guess, most), lambda b: self.fits(at, b, -1))
        middle = -1
        if self.arcs and end < most:
            begin = max(end + 1, min(at + max(self.guess, ARC_ROWS), most))
            far = self._search(at, most, begin, lambda b: self.fits(at, b, self._find_middle(at, b)))
            if far > end and far - at >= ARC_ROWS:
                end, middle = far, self._find_middle(at, far)
        self.guess = max(end - at, 2)
        return end, middle

    def _search(self, at: int, most: int, begin: int, fits: Callable[[int], bool]) -> int:
        """Return the farthest row that a move leads to, near enough; the next one where none farther does."""
        good, bad, trial = at + 1, most + 1, begin
        while good < most:
            if trial > good and fits(trial):
                good = trial
                trial = min(max(int(at + GROW * (good - at)), good + 1), most)
                if bad <= most:
                    trial = (good + bad) // 2
            else:
                bad = min(bad, trial)
                trial = (good + bad) // 2
            if bad - good <= max(1, (good - at) // 24) or trial <= good:
                break
        return good

    def _bound_speed(self, at: int, last: int) -> int:
        """Return the last row before the speed has changed by too much."""
        if self.free[at + 1]:
            return last
        for start in range(at + 1, last + 1, BLOCK):
            speed = self.speed[at + 1 : min(start + BLOCK, last + 1)]
            high, low = np.maximum.accumulate(speed), np.minimum.accumulate(speed)
            beyond = np.flatnonzero(high > FEED * low)
            if len(beyond):
                return int(at + max(beyond[0], 1))
        return last

    def _lengthen(self, first: int, pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Join moves that take less than a cycle to a neighbour, where path and speed allow it."""
        joined: list[tuple[int, int]] = []
        for end, middle in pieces:
            while joined:
                start = joined[-2][0] if len(joined) > 1 else first
                here = joined[-1][0]
                if min(self.time[end] - self.time[here], self.time[here] - self.time[start]) >= self.cycle:
                    break
                if self.time[end] - self.time[start] > SHORT * self.cycle and self._bound_speed(start, end) < end:
                    break
                trials = [m for m in (-1, self._find_middle(start, end)) if self.fits(start, end, m)]
                if not trials:
                    break
                middle = trials[0]
                joined.pop()
            joined.append((end, middle))
        return joined

    def _find_middle(self, a: int, b: int) -> int:
        """Return the row that lies nearest to half of the way."""
        return int(np.clip(np.searchsorted(self.along, 0.5 * (self.along[a] + self.along[b])), a + 1, b - 1))

    def fits(self, a: int, b: int, middle: int) -> bool:
        """Tell whether all rows between two lie near enough to a line, or an arc through a middle row."""
        if b - a < 2:
            return True
        found = self._follow_line(a, b) if middle < 0 else self._follow_arc(a, b, middle)
        if found is None:
            return False
        off, share = found
        if off.max() > self.tolerance[a + 1 : b + 1].min() or (np.diff(share) < 0.0).any():
            return False
        carried = self.carried[a : b + 1]
        if carried.size and np.abs(carried - carried[0] - share[:, None] * (carried[-1] - carried[0])).max() > CARRIED:
            return False
        return bool(self._measure_turn(a, b, share) <= TURN)

    def _follow_line(self, a: int, b: int) -> tuple[Array, Array] | None:
        """Return how far rows lie from the line between two, and at which share of it."""
        arm, chord = self.x[a : b + 1] - self.x[a], self.x[b] - self.x[a]
        square = float(chord @ chord)
        if square <= 0.0:
            return np.linalg.norm(arm, axis=1), np.linspace(0.0, 1.0, b - a + 1)
        share = arm @ chord / square
        return np.linalg.norm(arm - share[:, None] * chord, axis=1), share

    def _follow_arc(self, a: int, b: int, middle: int) -> tuple[Array, Array] | None:
        """Return the same of the arc through a middle row; None where there is none that controllers take."""
        circle = find_circle(self.x[a], self.x[middle], self.x[b])
        if circle is None or b - a < ARC_ROWS or self.along[b] - self.along[a] < ARC_LENGTH:
            return None
        centre, u, v, normal = circle
        radius = float(np.linalg.norm(self.x[a] - centre))
        arm = self.x[a : b + 1] - centre
        along, aside, height = arm @ u, arm @ v, arm @ normal
        angle = np.unwrap(np.arctan2(aside, along))
        sweep = float(angle[-1])
        if radius > ARC_RADIUS or not 0.0 < sweep < ARC_SWEEP:
            return None
        share = angle / sweep
        if not MIDDLE <= share[middle - a] <= 1.0 - MIDDLE:
            return None
        bulge = radius * (1.0 - np.cos(0.5 * np.diff(angle, prepend=0.0)))
        return np.maximum(np.hypot(np.hypot(along, aside) - radius, height), bulge), share

    def _measure_turn(self, a: int, b: int, share: Array) -> float:
        """Return how far the tool turns beside an even turn along a move. [rad]"""
        turned = _turn_from(self.turn[a], self.turn[a : b + 1])
        return float(np.linalg.norm(turned - share[:, None] * turned[-1], axis=1).max())

    def measure(self, a: int, b: int, middle: int) -> float:
        """Return the length of a move. [mm]"""
        circle = None if middle < 0 else find_circle(self.x[a], self.x[middle], self.x[b])
        if circle is None:
            return float(np.linalg.norm(self.x[b] - self.x[a]))
        centre, u, v, _ = circle
        arm = self.x[b] - centre
        return float(np.linalg.norm(self.x[a] - centre) * (np.arctan2(arm @ v, arm @ u) % (2.0 * np.pi)))


def find_circle(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array, Array] | None:
    """Return centre, direction to a, direction of travel there, and normal of the circle from a through b to c.

    None where the points lie on a line.
    """
    first, second = b - a, c - a
    normal = np.cross(first, second)
    square, scale = float(normal @ normal), float(first @ first) * float(second @ second)
    if square <= 1e-18 * scale or scale <= 0.0:
        return None
    arm = np.cross(first @ first * second - second @ second * first, normal) / (2.0 * square)
    u = -arm / np.linalg.norm(arm)
    normal = normal / np.sqrt(square)
    return a + arm, u, np.cross(normal, u), normal


def _turn_from(start: Array, turns: Array) -> Array:
    """Return rotation vectors from one orientation to others, both quaternions. Shape (4,), (n, 4) -> (n, 3) [rad]."""
    w, vector = start[0], -start[1:]
    real = w * turns[:, 0] - turns[:, 1:] @ vector
    imaginary = w * turns[:, 1:] + turns[:, :1] * vector + np.cross(vector, turns[:, 1:])
    imaginary = np.where(real[:, None] < 0.0, -imaginary, imaginary)
    size = np.linalg.norm(imaginary, axis=1)
    angle = 2.0 * np.arctan2(size, np.abs(real))
    return np.asarray(imaginary * np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0)[:, None])
