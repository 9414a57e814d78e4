"""Does a planned path go where a file goes: every move, in its order, none missed and none invented?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.oracles.moves import ARC, RAPID, Array, Reading

#: How far a planned waypoint may lie beside its move. [m]
BESIDE = 1e-6
#: A move that is shorter than this may be left out. [m]
SHORT = 2e-6
#: Greatest difference of the tool axis [rad] and of the feed (a share of it).
TURNED, FEED_SHARE = 1e-4, 1e-3
NAMES = ("rapid move", "line", "arc")
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Followed:
    """What a planned path is compared by."""

    position: Array  #: Waypoints, part frame. Shape (n, 3). [m]
    axis: Array  #: Tool axis, part frame. Shape (n, 3).
    rapid: NDArray[np.bool_]  #: Whether the move to each waypoint is rapid. Shape (n,).
    #: Feed of the move to each waypoint, or None where the job sets another. Shape (n,). [m/s]
    feed: Array | None = None
    chord: float = 1e-6  #: How far chords may stray from arcs. [m]
    corner: float = 0.0  #: How far corners may be rounded. [m]
    lean: float = 0.0  #: How far the tool axis may lean from the file's. [rad]


class _Move:
    """A move as plain numbers: how far a point lies from it, and how far along."""

    def __init__(self, reading: Reading, k: int, start: Point) -> None:
        self.kind, self.line = int(reading.kind[k]), int(reading.line[k])
        self.start, self.end = start, _point(reading.end[k])
        self.drill = bool(reading.drill[k])
        self.reached = 0.0  # share that a drill has cut: so far it may draw back and come again fast
        self.length = math.dist(self.start, self.end)
        if self.kind == ARC:
            self._lay_out(reading, k)

    def _lay_out(self, reading: Reading, k: int) -> None:
        n = reading.normal[k] / np.linalg.norm(reading.normal[k])
        arm, last = np.array(self.start) - reading.centre[k], reading.end[k] - reading.centre[k]
        self.rise0, rise1 = float(arm @ n), float(last @ n)
        flat, flat1 = arm - self.rise0 * n, last - rise1 * n
        self.radius, self.climb = float(np.linalg.norm(flat)), rise1 - self.rise0
        self.widen = float(np.linalg.norm(flat1)) - self.radius
        if self.radius > 1e-12:
            u = flat / self.radius
        else:  # a spiral from its centre begins along x
            u = np.array([1.0, 0.0, 0.0]) - n[0] * n
            u /= np.linalg.norm(u)
        self.u, self.n, self.centre = _point(u), _point(n), _point(reading.centre[k])
        self.v = _point(np.cross(n, u))
        self.sweep = float(reading.sweep[k])
        self.length = math.hypot(self.sweep * (self.radius + 0.5 * self.widen), self.climb)

    def locate(self, point: Point, before: float) -> tuple[float, float]:
        """Return how far a point lies from the move, and at which share of it, near one share and not before it."""
        if self.kind == ARC:
            return self._locate_on_arc(point, before)
        s, e = self.start, self.end
        dx, dy, dz = e[0] - s[0], e[1] - s[1], e[2] - s[2]
        square = dx * dx + dy * dy + dz * dz
        share = 1.0
        if square > 0.0:
            share = ((point[0] - s[0]) * dx + (point[1] - s[1]) * dy + (point[2] - s[2]) * dz) / square
            share = min(max(share, 0.0), 1.0)
        return math.dist(point, (s[0] + share * dx, s[1] + share * dy, s[2] + share * dz)), share

    def _locate_on_arc(self, point: Point, before: float) -> tuple[float, float]:
        c = self.centre
        x, y, z = point[0] - c[0], point[1] - c[1], point[2] - c[2]
        along = x * self.u[0] + y * self.u[1] + z * self.u[2]
        aside = x * self.v[0] + y * self.v[1] + z * self.v[2]
        height = x * self.n[0] + y * self.n[1] + z * self.n[2]
        angle = math.atan2(aside, along)
        turn = math.copysign(2.0 * math.pi, self.sweep)
        wanted = before * self.sweep - 1e-3 * turn / (2.0 * math.pi)
        while (angle - wanted) * turn < 0.0:
            angle += turn
        while (angle - turn - wanted) * turn >= 0.0:
            angle -= turn
        share = angle / self.sweep
        if share > 1.0 + 1e-3 / abs(self.sweep):
            share = 1.0 if math.dist(point, self.end) < self.length * 0.25 else 0.0
            return math.dist(point, self.end if share else self.start), share
        share = min(max(share, 0.0), 1.0)
        radius, rise = self.radius + share * self.widen, self.rise0 + share * self.climb
        off = math.hypot(math.hypot(along, aside) - radius, height - rise)
        if self.widen and off > BESIDE:
            return self._locate_on_spiral(along, aside, height, share)
        return off, share

    def _locate_on_spiral(self, along: float, aside: float, height: float, share: float) -> tuple[float, float]:
        """Return the nearest place of a spiral, between where its angle and where its radius are the point's."""

        def miss(at: float) -> float:
            angle, radius = at * self.sweep, self.radius + at * self.widen
            x, y = along - radius * math.cos(angle), aside - radius * math.sin(angle)
            return math.hypot(x, y, height - self.rise0 - at * self.climb)

        other = min(max((math.hypot(along, aside) - self.radius) / self.widen, 0.0), 1.0)
        near = min(abs(0.25 / self.sweep), abs(share - other))
        low, high = (share, share + near) if other > share else (share - near, share)
        for _ in range(60):
            a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
            low, high = (low, b) if miss(a) < miss(b) else (a, high)
        return miss(0.5 * (low + high)), min(max(0.5 * (low + high), 0.0), 1.0)


def _point(values: Array) -> Point:
    return float(values[0]), float(values[1]), float(values[2])


def find_difference(path: Followed, reading: Reading) -> str:
    """Say where a planned path, waypoints that repeat included, first goes another way than the moves of a file."""
    rows = [_point(row) for row in path.position]
    rapid = path.rapid.tolist()
    loose = path.corner + BESIDE
    moves = _lay_moves(reading)
    if (off := math.dist(rows[0], _point(reading.end[0]))) > loose:
        return _tell(reading, 0, f"begins {_mm(off)} from where the second reader begins")
    at, share = 0, 1.0  # the move that the last row stands on, and how far along
    near = math.inf  # how near to its end the path has come since
    for i in range(1, len(rows)):
        point, last = rows[i], rows[i - 1]
        # a generated arc may end by a chord's room beside the second reader's
        room = BESIDE + (path.chord if at == len(moves) - 1 and moves[at][1].kind == ARC else 0.0)
        if math.dist(point, last) <= 1e-9 or (share >= 1.0 and math.dist(point, moves[at][1].end) <= room):
            continue  # still where the move ends: rows beside a rest stand nearer to it than that
        found = _advance(moves, at, share, point, last, rapid[i], loose, path.chord, near)
        if found is None:
            wanted = moves[min(at + (share >= 1.0), len(moves) - 1)][0]
            return _tell(reading, wanted, f"goes another way at waypoint {i}")
        near = min(near, _miss(last, point, moves[at][1].end)) if found[0] == at else math.inf
        at, share = found
        k, move = moves[at]
        wanted_feed = 0.0 if rapid[i] else float(reading.feed[k])
        if path.corner > 0.0 and path.feed is not None and wanted_feed > 0.0 and at + 1 < len(moves):
            after, following = moves[at + 1]  # on a rounded corner a row may have the feed of either move
            if following.kind != RAPID and following.locate(point, 0.0)[0] <= loose:
                own, other = float(path.feed[i]), float(reading.feed[after])
                wanted_feed = other if abs(other - own) < abs(wanted_feed - own) else wanted_feed
        if path.feed is not None and wanted_feed > 0.0 and abs(path.feed[i] / wanted_feed - 1.0) > FEED_SHARE:
            feeds = f"{60e3 * path.feed[i]:.4g} mm/min, programmed are {60e3 * wanted_feed:.4g}"
            return _tell(reading, k, f"has a feed of {feeds} at waypoint {i}")
        over_again = move.kind == ARC and abs(move.sweep) > 2.0 * math.pi and share < 0.999  # of several turns
        if math.dist(point, move.end) <= BESIDE and not over_again:
            share = 1.0
            turned = math.acos(min(max(float(path.axis[i] @ reading.axis[k]), -1.0), 1.0))
            if turned > path.lean + TURNED:
                return _tell(reading, k, f"has its tool axis {math.degrees(turned):.3g} deg aside at waypoint {i}")
    left = [k for k, move in moves[at + 1 :] if move.length > max(SHORT, path.corner)]
    if share < 1.0 and math.dist(rows[-1], moves[at][1].end) > loose:
        return _tell(reading, moves[at][0], "ends before this move does")
    if left:
        return _tell(reading, left[0], f"misses the last {len(left)} moves")
    return ""


def _lay_moves(reading: Reading) -> list[tuple[int, _Move]]:
    """Return the moves that lead anywhere, each with its number; the first one is where the path begins."""
    start = _point(reading.end[0])
    first = _Move(reading, 0, start) if reading.kind[0] != ARC else None
    moves: list[tuple[int, _Move]] = [] if first is None else [(0, first)]
    for k in range(1, len(reading)):
        move = _Move(reading, k, start)
        if move.length > 1e-9:
            moves.append((k, move))
            start = move.end
    return moves


def _advance(
    moves: list[tuple[int, _Move]], at: int, share: float, point: Point, last: Point, rapid: bool, loose: float,
    chord: float, near: float,
) -> tuple[int, float] | None:  # fmt: skip
    """Return the move that a row stands on, and how far along; None where it stands on none that follows.

    `near` is how near rows before have come to the end of the move at hand: a rounded corner is passed in several.
    """
    first = at
    while at < len(moves):
        move = moves[at][1]
        drawn = rapid and move.drill and at == first
        if (at > first or share < 1.0) and (drawn or (move.kind == RAPID) == rapid):
            before = share if at == first else 0.0
            off, along = move.locate(point, before)
            room = loose + (chord if move.kind == ARC else 0.0)
            slack = loose / max(move.length, 1e-12)
            if off <= room and (along <= move.reached + slack if drawn else move.drill or along >= before - slack):
                move.reached = max(move.reached, along)
                return at, along
        passed = at == first and share >= 1.0  # to leave a move the row before has to reach its end, or the step to
        missed = min(near if at == first else math.inf, _miss(last, point, move.end))
        if not passed and move.length > SHORT and missed > loose:
            return None
        rest = move.length if at > first else math.dist(last, move.end) * (loose <= BESIDE)
        if not passed and rest > max(SHORT, loose) and (move.kind == RAPID) != rapid:
            return None  # a rapid step takes the place of no cut, nor a cut that of a rapid move
        at += 1
    return None


def _miss(a: Point, b: Point, corner: Point) -> float:
    """Return the distance of a corner from the line between two points."""
    d = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    c = (corner[0] - a[0], corner[1] - a[1], corner[2] - a[2])
    share = min(max((c[0] * d[0] + c[1] * d[1] + c[2] * d[2]) / max(square, 1e-30), 0.0), 1.0)
    return math.dist(c, (share * d[0], share * d[1], share * d[2]))


def _tell(reading: Reading, k: int, what: str) -> str:
    place = ", ".join(f"{1e3 * value:.6g}" for value in reading.end[k])
    name = NAMES[int(reading.kind[k])]
    return f"the path read {what}; a second reading of line {int(reading.line[k])} has a {name} to ({place}) mm"


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
