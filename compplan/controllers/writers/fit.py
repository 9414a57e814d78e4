"""Fit of few moves to a program: lines and arcs through its rows, within a tolerance of all of them.

A fitted move begins and ends at rows of the program; an arc follows the rows between by least squares. Every omitted
row lies within the tolerance of its fitted move, and so does the sagitta of an arc over the chord between two rows.
Arcs of the CAM file are tried first, in full. The tool turns evenly along a move. Where the planned speed changes by
more than `RATIO`, another move begins, so that each move takes its planned time. Ramps from rest and to stops are left
to the controller. A move shorter than the controller's cycle is joined to a neighbour, or otherwise driven slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.controllers import shapes
from compplan.controllers.writers.program import Program
from compplan.io.tables import Array

#: Kind of a line; the kind of an arc is the index of a row near its middle.
LINE = -1
#: Greatest departure of the tool from an even rotation. [rad]
TURN = float(np.radians(0.01))
#: Distance and rotation below which rows are the same pose after rounding. [mm], [rad]
NOWHERE, UNTURNED = 5e-4, 3e-5
#: Greatest departure of joints that carry the part from an even motion. [deg or mm]
CARRIED = 0.02
#: Rows that are evaluated at once, and factor by which the search extends a move that fits.
BLOCK, GROW = 2048, 1.6


@dataclass(frozen=True)
class Fitted:
    """A fitted program."""

    program: Program  #: The program at the ends of its moves, with `via` of its arcs.
    rows: NDArray[np.int_]  #: Row of each end in the original program. Shape (m,).


@lru_cache(maxsize=2)
def fit_moves(program: Program, *, arcs: bool = True) -> Fitted:
    """Fit lines and arcs to the linear moves of a program; a program without a tolerance is returned unchanged.

    A rounded corner becomes one row, the corner itself; the language's blend zone rounds it.

    Args:
        program: The program, with poses, `tolerance` (greatest distance) and `cycle` (least time of a move).
        arcs: Whether the language has arcs.
    """
    n = len(program)
    if program.tolerance <= 0.0 or program.time is None or n < 2:
        return Fitted(program, np.arange(n))
    rows = np.arange(n)
    if program.corner_shift is not None:
        rows = np.flatnonzero(np.isfinite(program.corner_shift[:, 0]))
        program = program.take(rows)
        assert program.corner_shift is not None
        tcp = program.tcp.copy()
        tcp[:, :3, 3] += program.corner_shift
        program = replace(program, tcp=tcp)
    alone, stops = program.alone(linear=True), program.stops(linear=True)
    track = _Track(program, 1e3 * program.tolerance, stops, arcs)
    kept = np.flatnonzero(alone | stops | program.corners | _mark_ends(program))
    pieces: list[tuple[int, int]] = []
    for first, last in zip(kept[:-1].tolist(), kept[1:].tolist(), strict=True):
        pieces += [(last, LINE)] if alone[last] or track.rests(first, last) else track.divide(first, last)
    ends = np.array([0, *(end for end, _ in pieces)])
    kind = np.array([LINE, *(kind for _, kind in pieces)])
    return Fitted(_take_rows(program, track, ends, kind), rows[ends])


def _mark_ends(program: Program) -> NDArray[np.bool_]:
    """Mark first and last row, rows with events, and rows where the speed begins or ceases to be prescribed."""
    marked = np.zeros(len(program), bool)
    marked[[0, -1]] = True
    marked[[event.place for event in program.events if event.place >= 0]] = True
    if program.free is not None:
        marked[:-1] |= program.free[1:] != program.free[:-1]
    return marked


def _take_rows(program: Program, track: _Track, ends: NDArray[np.int_], kind: NDArray[np.int_]) -> Program:
    """Return the program at some of its rows, with feeds such that a move takes its planned time, at least a cycle."""
    assert program.time is not None
    length = np.array([0.0, *(track.measure(a, b, m) for a, b, m in zip(ends[:-1], ends[1:], kind[1:], strict=True))])
    time, cut = np.diff(track.time[ends], prepend=0.0), ~program.alone(linear=True)[ends]
    cut[0] = False
    moved = cut & (length > 0.0) & (time > 0.0)
    feed = program.feed[ends].copy()
    feed[moved] = length[moved] / np.maximum(time, program.cycle)[moved]
    feed[cut] = np.maximum(feed[cut], shapes.LEAST_FEED)
    for k in range(1, len(feed)):  # keep a feed while it changes by less than HELD
        if cut[k] and cut[k - 1] and abs(feed[k] - feed[k - 1]) <= shapes.HELD * feed[k - 1]:
            feed[k] = feed[k - 1]
    via = np.full((len(ends), 4, 4), np.nan)
    via[kind >= 0] = program.tcp[kind[kind >= 0]]
    for k in np.flatnonzero(kind >= 0).tolist():
        beside = 1e-3 * shapes.find_via(track.x[ends[k - 1] : ends[k] + 1], int(kind[k] - ends[k - 1]))
        via[k, :3, 3] = program.part[:3, :3] @ beside + program.part[:3, 3]
    return replace(program.take(ends), feed=feed, via=via, tolerance=0.0)


class _Track:
    """The tool tip along a program's rows, and the fit of lines and arcs between them."""

    def __init__(self, program: Program, tolerance: float, stops: NDArray[np.bool_], arcs: bool) -> None:
        assert program.time is not None
        poses = program.positions
        self.x, self.quaternion = 1e3 * poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        self.tolerance, self.arcs = np.full(len(program), tolerance), arcs
        self.cycle = program.cycle
        self.step = np.linalg.norm(np.diff(self.x, axis=0, prepend=self.x[:1]), axis=1)
        self.along = np.cumsum(self.step)
        duration = np.diff(program.time, prepend=program.time[0])
        self.speed = shapes.send_speeds(self.step, duration, stops, program.corners, program.asked)
        moves = (self.step > 0.0) & ~program.alone(linear=True)
        self.time = np.cumsum(np.where(moves, self.step / np.maximum(self.speed, 1e-9), duration))
        drawn = np.zeros(len(program), np.int_) if program.arc_of is None or not arcs else program.arc_of
        edges = np.flatnonzero(np.diff(drawn, append=-1))
        #: Row at which the CAM arc that starts at each row ends; the row itself where no arc starts.
        self.drawn = np.arange(len(program))
        on = np.flatnonzero(drawn[1:])
        self.drawn[on] = edges[np.searchsorted(edges, on + 1)]
        self.begins = np.flatnonzero(np.diff(drawn) * (drawn[1:] > 0))
        self.carried = program.joints[:, program.carries] if program.moves_part else np.zeros((len(program), 0))
        self.free = np.zeros(len(program), bool) if program.free is None else program.free
        self.guess = 4

    def divide(self, first: int, last: int) -> list[tuple[int, int]]:
        """Return end and kind of each move from one row to another."""
        pieces: list[tuple[int, int]] = []
        at = first
        while at < last:
            most = self._bound_speed(at, last)
            after = np.searchsorted(self.begins, at, side="right")
            before_arc = min(most, int(self.begins[after])) if after < len(self.begins) else most
            piece = self._keep_arc(at, min(most, int(self.drawn[at]))) or self._reach(at, before_arc)
            pieces.append(piece)
            at = piece[0]
        return self._lengthen(first, pieces)

    def rests(self, a: int, b: int) -> bool:
        """Return whether tool position, tool orientation and the part carriers stay constant within rounding."""
        carried = self.carried[a : b + 1]
        if np.abs(self.x[a : b + 1] - self.x[a]).max() > NOWHERE or np.abs(carried - carried[:1]).max(initial=0.0) > 0:
            return False
        return bool(np.linalg.norm(self._turn_from(a, b), axis=1).max() <= UNTURNED)

    def _keep_arc(self, at: int, end: int) -> tuple[int, int] | None:
        """Return a move along a CAM arc from a row up to another, or to a half or third of the arc, where one fits."""
        for pieces in (1, 2, 3) if end > at else ():
            way = self.along[at] + (self.along[end] - self.along[at]) / pieces
            far = end if pieces == 1 else int(np.searchsorted(self.along, way - 1e-9))
            if far - at >= shapes.ARC_ROWS and self.fits(at, far, middle := self._find_middle(at, far)):
                return far, middle
        return None

    def _reach(self, at: int, most: int) -> tuple[int, int]:
        """Return the farthest end of one move from a row, and its kind."""
        end, kind = self._search(at, most, min(at + self.guess, most), lambda b: self.fits(at, b, LINE)), LINE
        if self.arcs and end < most:
            begin = max(end + 1, min(at + max(self.guess, shapes.ARC_ROWS), most))
            far = self._search(at, most, begin, lambda b: self.fits(at, b, self._find_middle(at, b), True))
            if far > end and far - at >= shapes.ARC_ROWS and self.fits(at, far, middle := self._find_middle(at, far)):
                end, kind = far, middle
        self.guess = max(end - at, 2)
        return end, kind

    def _search(self, at: int, most: int, begin: int, fits: Callable[[int], bool]) -> int:
        """Return approximately the farthest row that a move can reach; the next row where no farther one fits."""
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
        """Return the last row up to which the speed stays within `RATIO`."""
        if self.free[at + 1]:
            return last
        for start in range(at + 1, last + 1, BLOCK):
            speed = self.speed[at + 1 : min(start + BLOCK, last + 1)]
            high, low = np.maximum.accumulate(speed), np.minimum.accumulate(speed)
            beyond = np.flatnonzero(high > shapes.RATIO * low)
            if len(beyond):
                return int(at + max(beyond[0], 1))
        return last

    def _lengthen(self, first: int, pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Join moves shorter than a cycle to a neighbour, where path and speed allow it."""
        joined: list[tuple[int, int]] = []
        for end, kind in pieces:
            while joined:
                start = joined[-2][0] if len(joined) > 1 else first
                here = joined[-1][0]
                if min(self.time[end] - self.time[here], self.time[here] - self.time[start]) >= self.cycle:
                    break
                longer = self.time[end] - self.time[start] > shapes.SHORT * self.cycle
                if longer and self._bound_speed(start, end) < end:
                    break
                kinds = (LINE, self._find_middle(start, end))[: 1 + self.arcs]
                trials = [trial for trial in kinds if self.fits(start, end, trial)]
                if not trials:
                    break
                kind = trials[0]
                joined.pop()
            joined.append((end, kind))
        return joined

    def _find_middle(self, a: int, b: int) -> int:
        """Return the row nearest to half of the path length."""
        return int(np.clip(np.searchsorted(self.along, 0.5 * (self.along[a] + self.along[b])), a + 1, b - 1))

    def fits(self, a: int, b: int, kind: int, flat: bool = False) -> bool:
        """Return whether all rows between two are within tolerance of a line, or of an arc near a middle row.

        `flat` accepts arcs that are too flat or too short for controllers, as intermediate steps of a search.
        """
        if b - a < 2:
            return True
        found = self._follow(a, b, kind, flat)
        if found is None:
            return False
        off, share = found
        if off.max() > self.tolerance[a + 1 : b + 1].min() or (share[1:] < share[:-1]).any():
            return False
        carried = self.carried[a : b + 1]
        if carried.size and np.abs(carried - carried[0] - share[:, None] * (carried[-1] - carried[0])).max() > CARRIED:
            return False
        turned = self._turn_from(a, b)
        return bool(shapes.sizes_of(turned - share[:, None] * turned[-1]).max() <= TURN)

    def _follow(self, a: int, b: int, kind: int, flat: bool) -> tuple[Array, Array] | None:
        """Return the distances of rows from a move, and their shares along it; None where there is no such move."""
        x = self.x[a : b + 1]
        if kind == LINE:
            return shapes.follow_line(x)
        if b - a < shapes.ARC_ROWS or (not flat and self.along[b] - self.along[a] < shapes.ARC_LENGTH):
            return None
        via = shapes.find_via(x, kind - a)
        return None if not flat and shapes.is_flat(x[0], via, x[-1]) else shapes.follow_arc(x, via)

    def _turn_from(self, a: int, b: int) -> Array:
        """Return rotation vectors from the orientation at a row to those up to another. Shape (b - a + 1, 3). [rad]"""
        x, y, z, w = self.quaternion[a]
        vectors, real = self.quaternion[a : b + 1, :3], self.quaternion[a : b + 1, 3:]
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        imaginary, real = (
            w * vectors - real * self.quaternion[a, :3] + vectors @ skew,
            w * real + vectors @ [[x], [y], [z]],
        )
        size = shapes.sizes_of(imaginary)[:, None]
        angle = np.where(real < 0.0, -2.0, 2.0) * np.arctan2(size, np.abs(real))
        return np.asarray(imaginary * angle / np.maximum(size, 1e-300))

    def measure(self, a: int, b: int, kind: int) -> float:
        """Return the length of a move. [mm]"""
        via = None if kind == LINE else shapes.find_via(self.x[a : b + 1], kind - a)
        arc = None if via is None else shapes.find_arc(self.x[a], via, self.x[b])
        return float(np.linalg.norm(self.x[b] - self.x[a])) if arc is None else arc.length
