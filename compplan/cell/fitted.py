"""Do the lines and arcs of a program stand for all rows that were planned? Each move is followed along them.

Nothing here goes through the writers: a move is found by where it ends, its line or arc is worked out anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.robot import Array
from compplan.second.programs.poses import Move

#: How near a move has to end to a planned row [mm], and rounding of written positions [mm].
NEAR, ROUNDING = 5e-3, 5e-4
#: Greatest turn of the tool beside an even one. [deg]
TURN = 0.02
#: Speeds within a move may differ from its feed by this share, and by what feeds with one decimal leave. [1, mm/s]
FEED, FEED_STEP = 0.012, 0.06
#: Rows that are searched at once, and cycles below which a move may join rows of any speed.
WINDOW, SHORT = 256, 2.0


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

    """

    position: Array
    rotation: Array
    time: Array
    kept: NDArray[np.bool_]
    free: NDArray[np.bool_]
    tolerance: Array
    cycle: float


def find_rows(rows: PlannedRows, tips: Array) -> NDArray[np.int_] | str:
    """Return the row at which each move ends, or what speaks against it.

    Args:
        rows: What was planned.
        tips: Where moves end; nan where that is the next row that has to be kept. Shape (k, 3). [mm]

    """
    found, at, n = [], -1, len(rows.position)
    for number, tip in enumerate(tips):
        row = _find_kept(rows, at) if np.isnan(tip[0]) else _find_row(rows, at, tip)
        if row is None:
            return f"move {number} ends where no row beyond {at} was planned"
        at = row
        found.append(at)
    missed = np.setdiff1d(np.flatnonzero(rows.kept), found)
    if len(missed):
        return f"no move ends at row {missed[0]}, {n} are planned"
    return np.array(found)


def _find_kept(rows: PlannedRows, at: int) -> int | None:
    after = np.flatnonzero(rows.kept[at + 1 :])
    return int(at + 1 + after[0]) if len(after) else None


def _find_row(rows: PlannedRows, at: int, tip: Array) -> int | None:
    """Return the row at which the path first comes nearest to a place, of equal ones the last before a kept one."""
    n = len(rows.position)
    for start in range(at + 1, n, WINDOW):
        off = np.linalg.norm(rows.position[start : start + 2 * WINDOW] - tip, axis=1)
        near = np.flatnonzero(off[:WINDOW] <= NEAR)
        if not len(near):
            continue
        row = int(near[0])
        while row + 1 < len(off) and off[row + 1] <= off[row] + 1e-5 and not rows.kept[start + row]:
            row += 1
        return start + row
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
    for k in range(1, len(moves)):
        a, b, move = int(ends[k - 1]), int(ends[k]), moves[k]
        if move.kind == "joint":
            if b > a + 1:
                said.append(f"a joint move leads from row {a} to row {b}")
            continue
        via = None
        if move.kind == "arc":
            assert move.via is not None
            via = (bases[k] @ move.via)[:3, 3]
        wrong = _follow(rows, a, b, via) or _time(rows, a, b, via, move.feed)
        if wrong:
            said.append(f"{wrong} between rows {a} and {b}")
        if len(said) > 2:
            break
    return said[:1]


def _follow(rows: PlannedRows, a: int, b: int, via: Array | None) -> str:
    """Say how far rows lie beside a line, or an arc through a place, where that is too far."""
    if b == a + 1 and via is None:
        return ""
    x, start, end = rows.position[a : b + 1], rows.position[a], rows.position[b]
    if via is None:
        chord = end - start
        square = float(chord @ chord)
        share = (x - start) @ chord / square if square > 0.0 else np.linspace(0.0, 1.0, len(x))
        off = np.linalg.norm(x - start - share[:, None] * chord, axis=1)
    else:
        off, share = _follow_arc(x, via)
    if off.max() > rows.tolerance[a + 1 : b + 1].min() + ROUNDING:
        return f"the planned tip is {1e3 * off.max():.3g} um beside the move"
    if (np.diff(share) < -1e-6).any():
        return "the path turns back"
    turned = Rotation.from_matrix(rows.rotation[a : b + 1])
    way = (turned[0].inv() * turned).as_rotvec(degrees=True)
    most = float(np.linalg.norm(way - share[:, None] * way[-1], axis=1).max())
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


def _follow_arc(x: Array, via: Array) -> tuple[Array, Array]:
    """Return how far rows lie from an arc, and it from their chords, and the share of it at each."""
    centre, u, v, across = _lay_arc(x[0], via, x[-1])
    arm = x - centre
    radius = float(np.linalg.norm(arm[0]))
    angle = np.unwrap(np.arctan2(arm @ v, arm @ u))
    if not angle[-1] > 0.0:
        angle = np.where(angle < 0.0, angle + 2.0 * np.pi, angle)
    bulge = radius * (1.0 - np.cos(0.5 * np.diff(angle, prepend=0.0)))
    off = np.hypot(np.hypot(arm @ u, arm @ v) - radius, arm @ across)
    return np.maximum(off, bulge), angle / max(float(angle[-1]), 1e-12)


def _time(rows: PlannedRows, a: int, b: int, via: Array | None, feed: float | None) -> str:
    """Say where the feed of a move takes another time than planned, or less than a cycle."""
    x, lasts = rows.position[a : b + 1], float(rows.time[b] - rows.time[a])
    if feed is None or rows.free[b]:
        return ""
    length = float(np.linalg.norm(x[-1] - x[0]))
    if via is not None:
        centre, u, v, _ = _lay_arc(x[0], via, x[-1])
        angle = np.arctan2((x[-1] - centre) @ v, (x[-1] - centre) @ u) % (2.0 * np.pi)
        length = float(np.linalg.norm(x[0] - centre) * angle)
    if length < 1e-6:
        return ""
    wanted = length / max(lasts, rows.cycle)
    if abs(feed - wanted) > FEED * wanted + FEED_STEP:
        return f"a feed of {feed:.4g} mm/s, the plan takes {wanted:.4g}"
    if lasts <= SHORT * rows.cycle:
        return ""
    speed = np.linalg.norm(np.diff(x, axis=0), axis=1) / np.maximum(np.diff(rows.time[a : b + 1]), 1e-9)
    off = np.abs(speed - wanted)
    if off.max() > FEED * wanted + FEED_STEP:
        return f"a feed of {feed:.4g} mm/s, the plan has {speed[off.argmax()]:.4g}"
    return ""
