"""Do the moves of a program stand for all rows that were planned? Each is followed along them.

Its line or arc is worked out anew from what was read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.poses import Move
from compplan.controllers.shapes import HELD, LEAST_FEED, RATIO, SHORT, find_arc, follow_arc, follow_line, send_speeds
from compplan.robot import Array
from compplan.toolpath.corners import STRAYS, measure_beside

#: Rounding of written positions. [mm]
ROUNDING = 5e-4
#: Greatest turn of the tool beside an even one. [deg]
TURN = 0.02
#: A feed stands until another differs by `HELD` of it, and is written with one decimal at least; speeds within a move
#: differ by `RATIO` at most. [1, mm/s, 1]
FEED, FEED_STEP, UNEVEN = HELD / (1.0 - HELD), 0.05 * (1.0 + 1e-6), RATIO - 1.0


@dataclass(frozen=True)
class PlannedRows:
    """The rows that a program stands for."""

    position: Array  #: Commanded tip. Shape (m, 3). [mm]
    rotation: Array  #: Commanded orientation. Shape (m, 3, 3).
    time: Array  #: Shape (m,). [s]
    kept: NDArray[np.bool_]  #: Rows that a move has to end at. Shape (m,).
    free: NDArray[np.bool_]  #: Rows whose speed is of no account. Shape (m,).
    tolerance: float  #: How far rows may lie beside the move that stands for them. [mm]
    cycle: float  #: Least time of a move. [s]
    #: Feed that the CAM file asks for; without it no leg has a speed of its own. Shape (m,). [mm/s]
    asked: Array | None = None
    corners: NDArray[np.bool_] | None = None  #: Rows that are corners, which a zone leads around. Shape (m,).


def follow_moves(rows: PlannedRows, ends: NDArray[np.int_], moves: Sequence[Move], bases: Sequence[Array]) -> list[str]:
    """Say where a line or arc first leaves the rows that it stands for, or takes another time.

    `ends` is the row at which each move ends, `bases` the frame that its positions count from, seen from the base. [mm]
    """
    step = np.linalg.norm(np.diff(rows.position, axis=0, prepend=rows.position[:1]), axis=1)
    lasts, stops = np.diff(rows.time, prepend=rows.time[0] - 1.0), np.zeros(len(step), bool)
    stops[ends[[move.stops for move in moves]]] = True
    corners = np.zeros(len(step), bool) if rows.corners is None else rows.corners
    lasts[step > 0.0] = (step / np.maximum(send_speeds(step, lasts, stops, corners, rows.asked), 1e-9))[step > 0.0]
    for a, b, move, base in zip(ends[:-1].tolist(), ends[1:].tolist(), moves[1:], bases[1:], strict=True):
        if move.kind != "joint":
            wrong = _follow(rows, a, b, move, base) or _time(rows, a, b, move, base, step, lasts)
        else:
            wrong = "a joint move leads past rows" if b > a + 1 else ""
        if wrong:
            return [f"{wrong} between rows {a} and {b}"]
    return []


def check_corners(position: Array, corner: Array, beside: Array) -> list[str]:
    """Say where the rounding of a corner lies farther from the legs of it than zones may lead.

    `corner` is the way from a row to the corner that stands for it, nan at rows beside, `beside` how far zones may
    lead. Shapes (m, 3), (m, 3), (m,). [mm]
    """
    said, left_out = [], np.isnan(corner[:, 0])
    for row in np.flatnonzero(np.nan_to_num(np.abs(corner).max(axis=1)) > 0.0).tolist():
        first, last = row - 1, row + 1
        while left_out[first]:
            first -= 1
        while left_out[last]:
            last += 1
        off = measure_beside(position[first : last + 1], position[row] + corner[row])
        if off > STRAYS * max(float(np.linalg.norm(corner[row])), float(beside[row])) + ROUNDING:
            said.append(f"the planned tip is {1e3 * off:.3g} um off the corner at row {row}")
    return said


def _follow(rows: PlannedRows, a: int, b: int, move: Move, base: Array) -> str:
    """Say how far the rows of a move lie beside it where that is too far."""
    x = rows.position[a : b + 1]
    if move.kind == "arc":
        assert move.via is not None
        arc = follow_arc(x, (base @ move.via)[:3, 3])
        if arc is None:
            return "an arc that is too flat, too long or not passed by its middle"
        found = arc
    else:
        found = follow_line(x)
    off, share = found
    if off.max() > rows.tolerance + ROUNDING:
        return f"the planned tip is {1e3 * off.max():.3g} um off the move"
    if (np.diff(share) < -1e-6).any() and np.ptp(share) * np.linalg.norm(x[-1] - x[0]) > ROUNDING:
        return "the path turns back"
    turned = Rotation.from_matrix(rows.rotation[a : b + 1])
    around = (turned[0].inv() * turned).as_rotvec(degrees=True)
    most = float(np.linalg.norm(around - share[:, None] * around[-1], axis=1).max())
    return f"the tool is turned by {most:.3g} deg off an even turn" if most > TURN else ""


def _time(rows: PlannedRows, a: int, b: int, move: Move, base: Array, step: Array, lasts: Array) -> str:
    """Say where the feed of a move takes another time than is to be sent, or less than a cycle."""
    leg, start, end = slice(a + 1, b + 1), rows.position[a], rows.position[b]
    arc = None if move.via is None else find_arc(start, (base @ move.via)[:3, 3], end)
    length = float(np.linalg.norm(end - start)) if arc is None else arc.length
    if move.feed is None or rows.free[b] or length < 1e-6:
        return ""
    time, speed = float(lasts[leg].sum()), step[leg] / np.maximum(lasts[leg], 1e-9)
    wanted = max(length / max(time, rows.cycle), LEAST_FEED)
    if abs(move.feed - wanted) > FEED * wanted + FEED_STEP:
        return f"a feed of {move.feed:.4g} mm/s, the plan takes {wanted:.4g}"
    off = np.abs(speed - wanted)
    if time > SHORT * rows.cycle and off.max() > UNEVEN * wanted + FEED_STEP and speed.max() > LEAST_FEED:
        return f"a feed of {move.feed:.4g} mm/s, the plan has {speed[off.argmax()]:.4g}"
    return ""
