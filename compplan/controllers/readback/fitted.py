"""Do the moves of a program stand for all rows that were planned? Each is followed along them.

Nothing here goes through the writers: a move is found by where it ends, its line, arc or cubic is worked out anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.poses import Move
from compplan.robot import Array

#: How near a move has to end to a planned row [mm], and rounding of written positions [mm].
NEAR, ROUNDING = 5e-3, 5e-4
#: What rounding turns a written orientation. [rad]
ALIKE = 3e-5
#: Greatest turn of the tool beside an even one. [deg]
TURN = 0.02
#: A feed may differ from the mean speed of a move by the first share, from speeds within it by the second, from both by
#: what feeds with one decimal leave. [1, 1, mm/s]
FEED, UNEVEN, FEED_STEP = 0.022, 0.062, 0.06
#: How far rows may lie beside the legs of a corner, in what zones may lead beside the path.
SPREAD = 2.0
#: The least feed that every language can state: 1 cm/min in FANUC programs, 0.1 mm/s in INFORM. [mm/s]
CRAWL = 1.0 / 6.0 * (1.0 + 1e-9)
#: Rows that are searched at once, and cycles below which a move may join rows of any speed.
WINDOW, SHORT = 256, 2.0
#: Time beside a rest in which the controller changes the speed by itself [s], and what counts as its end.
RAMP, REACHED = 0.5, 1.01


@dataclass(frozen=True)
class PlannedRows:
    """The rows that a program stands for.

    Attributes:
        position: Commanded tip. Shape (m, 3). [mm]
        rotation: Commanded orientation. Shape (m, 3, 3).
        time: Shape (m,). [s]
        kept: Rows that a move has to end at. Shape (m,).
        free: Rows whose speed is of no account. Shape (m,).
        tolerance: How far rows may lie beside the move that ends at each. Shape (m,). [mm]
        cycle: Least time of a move. [s]
        asked: Feed that the CAM file asks for; without it no leg has a speed of its own. Shape (m,). [mm/s]
        corners: Rows that are corners, which a zone leads around. Shape (m,).

    """

    position: Array
    rotation: Array
    time: Array
    kept: NDArray[np.bool_]
    free: NDArray[np.bool_]
    tolerance: Array
    cycle: float
    asked: Array | None = None
    corners: NDArray[np.bool_] | None = None


def find_rows(
    rows: PlannedRows, tips: Array, turns: Array, held: Sequence[NDArray[np.bool_] | None] | None = None
) -> NDArray[np.int_] | str:
    """Return the row at which each move ends, or what speaks against it.

    Args:
        rows: What was planned.
        tips: Where moves end; nan where that is the next row that has to be kept. Shape (k, 3). [mm]
        turns: Orientation of the tool there; nan where a program does not say it. Shape (k, 3, 3).
        held: Rows whose joints are those of a move that states joints, None of other moves; None: no move does.
            Shape (m,) each.

    """
    found: list[int] = []
    at, n = -1, len(rows.position)
    for number, (tip, turn, same) in enumerate(zip(tips, turns, held or [None] * len(tips), strict=True)):
        if same is not None:
            row = _find_joints(rows, at, same)
        else:
            row = _find_kept(rows, at) if np.isnan(tip[0]) else _find_row(rows, at, tip, turn)
        if row is None and _steps_back(rows, found, tips[number - 1], tip):
            found[-1], row = at - 1, at
        if row is None:
            return (
                f"move {number} ends beside the planned path behind waypoint {at} (the way there included): the wrist "
                'may be near a singularity; write joint moves ([output] form = "joint") or move the part'
            )
        at = row
        found.append(at)
    missed = np.setdiff1d(np.flatnonzero(rows.kept), found)
    if len(missed):
        return f"no move ends at row {missed[0]}, {n} are planned"
    return np.array(found)


def _steps_back(rows: PlannedRows, found: list[int], before: Array, tip: Array) -> bool:
    """Tell whether a move ends at the row that the one before it was given, and that one a row earlier.

    Rows that lie nearer to each other than a language rounds change places so.

    Args:
        rows: What was planned.
        found: Rows of the moves up to that one.
        before: Where the move before ends. Shape (3,). [mm]
        tip: Where the move ends. Shape (3,). [mm]

    """
    if not found or found[-1] - 1 <= (found[-2] if len(found) > 1 else -1):
        return False
    pair = rows.position[[found[-1] - 1, found[-1]]]
    return bool((np.linalg.norm(pair - np.stack([before, tip]), axis=1) <= 2.0 * ROUNDING).all())


def _find_joints(rows: PlannedRows, at: int, same: NDArray[np.bool_]) -> int | None:
    """Return the first row with the joints of a move, of several in turn the one that has to be kept."""
    after = np.flatnonzero(same[at + 1 :])
    if not len(after):
        return _find_kept(rows, at)  # its joints are compared there
    row = at + 1 + int(after[0])
    while row + 1 < len(same) and same[row + 1] and not rows.kept[row]:
        row += 1
    return row


def _find_kept(rows: PlannedRows, at: int) -> int | None:
    after = np.flatnonzero(rows.kept[at + 1 :])
    return int(at + 1 + after[0]) if len(after) else None


def _find_row(rows: PlannedRows, at: int, tip: Array, turn: Array) -> int | None:
    """Return the row at which the path first comes nearest to a place, of equal ones that which is turned as the tool.

    Of those that are turned alike it is the last before a kept one.
    """
    n = len(rows.position)
    for start in range(at + 1, n, WINDOW):
        off = np.linalg.norm(rows.position[start : start + 2 * WINDOW] - tip, axis=1)
        near = np.flatnonzero(off[:WINDOW] <= NEAR)
        if not len(near):
            continue
        row = int(near[0])
        while row + 1 < len(off) and off[row + 1] <= off[row] + 1e-5 and not rows.kept[start + row]:
            row += 1
        first, last = row, row
        while first > near[0] and off[first - 1] <= off[row] + 2.0 * ROUNDING and not rows.kept[start + first - 1]:
            first -= 1
        while last + 1 < len(off) and off[last + 1] <= off[row] + 2.0 * ROUNDING and not rows.kept[start + last]:
            last += 1
        if first == last or np.isnan(turn[0, 0]):
            return start + row
        same = np.arange(first, last + 1)
        turned = Rotation.from_matrix(rows.rotation[start + same] @ turn.T).magnitude()
        same = same[turned <= turned.min() + ALIKE]
        return int(start + same[np.flatnonzero(off[same] <= off[same].min() + 1e-5)[-1]])
    return None


def follow_moves(rows: PlannedRows, ends: NDArray[np.int_], moves: Sequence[Move], bases: Sequence[Array]) -> list[str]:
    """Say where lines and arcs leave the rows that they stand for, or take another time; notes follow breaches.

    Args:
        rows: What was planned.
        ends: The row at which each move ends. Shape (k,).
        moves: The moves.
        bases: Pose of the frame that the positions of each move count from, seen from the base. [mm]

    """
    said: list[str] = []
    rests = ends[[move.stops for move in moves]]
    speed = _send(rows, rests)
    for k in range(1, len(moves)):
        a, b, move = int(ends[k - 1]), int(ends[k]), moves[k]
        if move.kind == "joint":
            if b > a + 1:
                said.append(f"a joint move leads from row {a} to row {b}")
            continue
        way = _lay_move(rows.position[a : b + 1], move, bases[k])
        wrong = _follow(rows, a, b, way) or _time(rows, a, b, way.length, speed[a + 1 : b + 1], move.feed)
        if wrong:
            said.append(f"{wrong} between rows {a} and {b}")
        if len(said) > 2:
            break
    return said[:1]


def _send(rows: PlannedRows, rests: NDArray[np.int_]) -> Array:
    """Return the speed of the move to each row, starts from rest and stops left to the controller. Shape (m,) [mm/s].

    There a program has the speed that the plan comes to within `RAMP`, row by row faster, and stays near.
    """
    lasts = np.r_[1.0, np.diff(rows.time)]
    speed = np.r_[0.0, np.linalg.norm(np.diff(rows.position, axis=0), axis=1)] / np.maximum(lasts, 1e-9)
    corners = set() if rows.corners is None else set(np.flatnonzero(rows.corners).tolist())
    if rows.asked is not None:
        speed = _level(rows, speed, set(rests.tolist()), corners)
    sent = speed.copy()
    marks = sorted({*rests.tolist(), *corners})
    for first, last in pairwise(marks):
        for order in (range(first + 1, last + 1), range(last, first, -1)):
            time, inside = 0.0, list[int]()
            for row in order:
                time += lasts[row]
                if time >= RAMP and inside:
                    break
                inside.append(row)
            top = max(speed[row] for row in inside) / REACHED if inside else 0.0
            count = next((k for k, row in enumerate(inside) if speed[row] >= top), 0)
            rises = all(speed[b] > speed[a] for a, b in pairwise(inside[: count + 1]))
            if count and count + 1 < len(order):  # it may not fall at once again
                rises = rises and speed[order[count + 1]] > REACHED * speed[inside[count - 1]]
            if count and rises:
                sent[inside[:count]] = speed[inside[count]]
    return sent


def _level(rows: PlannedRows, speed: Array, rests: set[int], corners: set[int]) -> Array:
    """Return speeds with one speed for each short leg between rests and corners that is asked to have one feed.

    From corner to corner that is the mean over time; a leg that begins or ends at rest has its greatest speed.
    """
    assert rows.asked is not None
    asked = rows.asked.tolist()
    both = [min(pair) > 0.0 for pair in pairwise(asked)]  # rapid moves ask for none
    turns = {k for k, cuts in enumerate(both) if cuts and abs(asked[k + 1] - asked[k]) > 1e-9 * asked[k]}
    level = speed.copy()
    for a, b in pairwise(sorted(rests | corners | turns)):
        lasts = float(rows.time[b] - rows.time[a])
        if lasts <= 2.0 * RAMP and a not in turns and b not in turns:
            way = float(np.linalg.norm(np.diff(rows.position[a : b + 1], axis=0), axis=1).sum())
            level[a + 1 : b + 1] = speed[a + 1 : b + 1].max() if {a, b} & rests else way / max(lasts, 1e-9)
    return level


def check_corners(position: Array, corner: Array, beside: Array, tolerance: float) -> list[str]:
    """Say where the rounding of a corner lies farther from the legs of it than zones may lead.

    Args:
        position: Commanded tip at all rows. Shape (m, 3). [mm]
        corner: From a row to the corner that stands for it, nan at rows beside. Shape (m, 3). [mm]
        beside: How far zones may lead beside each row. Shape (m,). [mm]
        tolerance: How far rows may lie beside moves. [mm]

    """
    said = []
    for row in np.flatnonzero(np.nan_to_num(np.abs(corner).max(axis=1)) > 0.0).tolist():
        first = last = row
        while np.isnan(corner[first - 1, 0]):
            first -= 1
        while np.isnan(corner[last + 1, 0]):
            last += 1
        place, inner = position[row] + corner[row], position[first : last + 1]
        off = np.full(len(inner), np.inf)
        for end in (position[first - 1], position[last + 1]):
            leg = end - place
            share = np.clip((inner - place) @ leg / max(float(leg @ leg), 1e-18), 0.0, 1.0)
            off = np.minimum(off, np.linalg.norm(inner - place - share[:, None] * leg, axis=1))
        most = SPREAD * max(float(np.linalg.norm(corner[row])), float(beside[row])) + tolerance
        if off.max() > most:
            said.append(f"the planned tip is {1e3 * off.max():.3g} um beside the corner at row {row}")
    return said


@dataclass(frozen=True)
class _Way:
    """A move along the rows that it stands for: how far each lies from it, its share of it, and its length [mm]."""

    off: Array
    share: Array
    length: float


def _lay_move(x: Array, move: Move, base: Array) -> _Way:
    if move.kind == "curve":
        assert move.bend is not None
        return _lay_curve(x, base[:3, :3] @ move.bend[0], base[:3, :3] @ move.bend[1])
    if move.kind == "arc":
        assert move.via is not None
        return _follow_arc(x, (base @ move.via)[:3, 3])
    chord = x[-1] - x[0]
    square = float(chord @ chord)
    share = (x - x[0]) @ chord / square if square > 0.0 else np.linspace(0.0, 1.0, len(x))
    return _Way(np.linalg.norm(x - x[0] - share[:, None] * chord, axis=1), share, float(np.sqrt(square)))


def _lay_curve(x: Array, leaves: Array, comes: Array) -> _Way:
    """Hold rows against a cubic from the first to the last, of these derivatives by its share at its ends. [mm]."""
    points = np.array([x[0], x[0] + leaves / 3.0, x[-1] - comes / 3.0, x[-1]])  # of Bezier

    def place(u: Array) -> Array:
        v = 1.0 - u
        return np.column_stack([v**3, 3 * u * v * v, 3 * u * u * v, u**3]) @ points

    along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))]
    share = along / max(float(along[-1]), 1e-12)
    for _ in range(4):  # to the foot of each row
        v, edges = 1.0 - share, np.diff(points, axis=0)
        slope = 3.0 * np.column_stack([v * v, 2 * share * v, share * share]) @ edges
        step = np.einsum("ni,ni->n", x - place(share), slope) / np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-12)
        share = np.clip(share + step, 0.0, 1.0)
    half = 0.5 * (share[:-1] + share[1:])
    chord = np.diff(x, axis=0)
    arm = place(half) - x[:-1]
    part = np.einsum("ni,ni->n", arm, chord) / np.maximum(np.einsum("ni,ni->n", chord, chord), 1e-18)
    bulge = np.linalg.norm(arm - part[:, None] * chord, axis=1)
    fine = place(np.linspace(0.0, 1.0, 16 * len(x)))
    length = float(np.linalg.norm(np.diff(fine, axis=0), axis=1).sum())
    return _Way(np.maximum(np.linalg.norm(x - place(share), axis=1), np.r_[0.0, bulge]), share, length)


def _follow(rows: PlannedRows, a: int, b: int, way: _Way) -> str:
    """Say how far rows lie beside a move where that is too far."""
    off, share = way.off, way.share
    if off.max() > rows.tolerance[a + 1 : b + 1].min() + ROUNDING:
        return f"the planned tip is {1e3 * off.max():.3g} um beside the move"
    if (np.diff(share) < -1e-6).any() and np.ptp(share) * way.length > ROUNDING:
        return "the path turns back"
    turned = Rotation.from_matrix(rows.rotation[a : b + 1])
    around = (turned[0].inv() * turned).as_rotvec(degrees=True)
    most = float(np.linalg.norm(around - share[:, None] * around[-1], axis=1).max())
    return f"the tool is turned by {most:.3g} deg beside an even turn" if most > TURN else ""


def _lay_arc(start: Array, via: Array, end: Array) -> tuple[Array, Array, Array, Array]:
    """Return centre and axes of the circle through three places: towards the start, along the travel, across."""
    u = (via - start) / np.linalg.norm(via - start)
    across = np.cross(u, end - start)
    across = across / np.linalg.norm(across)
    v = np.cross(across, u)
    half, (p, q) = 0.5 * float(np.linalg.norm(via - start)), (float((end - start) @ u), float((end - start) @ v))
    centre = start + half * u + (p * p + q * q - 2.0 * half * p) / (2.0 * q) * v
    first = (start - centre) / np.linalg.norm(start - centre)
    return centre, first, np.cross(across, first), across


def _follow_arc(x: Array, via: Array) -> _Way:
    """Hold rows against an arc from the first to the last through a place, and it against their chords. [mm]."""
    centre, u, v, across = _lay_arc(x[0], via, x[-1])
    arm = x - centre
    radius = float(np.linalg.norm(arm[0]))
    angle = np.unwrap(np.arctan2(arm @ v, arm @ u))
    if not angle[-1] > 0.0:
        angle = np.where(angle < 0.0, angle + 2.0 * np.pi, angle)
    bulge = radius * (1.0 - np.cos(0.5 * np.diff(angle, prepend=0.0)))
    off = np.hypot(np.hypot(arm @ u, arm @ v) - radius, arm @ across)
    return _Way(np.maximum(off, bulge), angle / max(float(angle[-1]), 1e-12), radius * float(angle[-1]))


def _time(rows: PlannedRows, a: int, b: int, length: float, speed: Array, feed: float | None) -> str:
    """Say where the feed of a move takes another time than that of the speeds to be sent, or less than a cycle."""
    if feed is None or rows.free[b] or length < 1e-6:
        return ""
    step = np.linalg.norm(np.diff(rows.position[a : b + 1], axis=0), axis=1)
    lasts = float(np.where(step > 0.0, step / np.maximum(speed, 1e-9), np.diff(rows.time[a : b + 1])).sum())
    wanted = length / max(lasts, rows.cycle)
    if max(feed, wanted, float(speed.max())) <= CRAWL:
        return ""
    if abs(feed - wanted) > FEED * wanted + FEED_STEP:
        return f"a feed of {feed:.4g} mm/s, the plan takes {wanted:.4g}"
    if lasts <= SHORT * rows.cycle:
        return ""
    off = np.abs(speed - wanted)
    if off.max() > UNEVEN * wanted + FEED_STEP:
        return f"a feed of {feed:.4g} mm/s, the plan has {speed[off.argmax()]:.4g}"
    return ""
