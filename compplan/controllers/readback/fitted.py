"""Check that the moves of a program represent all planned rows: rows are compared with the line or arc of their move.

The line or arc is computed anew from the program that was read back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.poses import Move
from compplan.controllers.shapes import HELD, LEAST_FEED, RATIO, SHORT, find_arc, follow_arc, follow_line, send_speeds
from compplan.robot import Array

#: Rounding of written positions. [mm]
ROUNDING = 5e-4
#: Greatest departure of the tool from an even rotation. [deg]
TURN = 0.02
#: A feed is kept until it changes by `HELD`, and is written with at least one decimal; speeds within a move differ by
#: at most `RATIO`. [1, mm/s, 1]
FEED, FEED_STEP, UNEVEN = HELD / (1.0 - HELD), 0.05 * (1.0 + 1e-6), RATIO - 1.0


@dataclass(frozen=True)
class PlannedRows:
    """Planned motion at the rows of programs: approach, path, retreat. Shapes (m, ..)."""

    position: Array  #: Commanded tip. [mm]
    rotation: Array  #: Commanded orientation.
    q: Array  #: Commanded joint positions. [rad or m]
    time: Array  #: [s]
    feed: Array  #: Planned feed in the move to each row, 0 in rapid moves. [mm/s]
    exact_stops: NDArray[np.bool_]  #: Whether the tool has to stop, in addition to the ends of rapid moves.
    free: NDArray[np.bool_]  #: Whether the move to each row has no prescribed speed.
    #: Feed of the CAM file in the move to each row; without it the speed is not levelled along short legs. [mm/s]
    cam_feed: Array | None
    #: Vector to the corner that replaces a row in tool moves; nan at omitted rows of a rounded corner, 0 at other rows.
    #: Shape (m, 3). [mm]
    corner: Array
    fit: float  #: Greatest distance of rows from the tool moves that represent them. [mm]

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Rows at which a move has to end."""
        rapid = self.feed <= 0.0
        return rapid | self.exact_stops | np.append(rapid[1:], True)

    def square_corners(self) -> tuple[PlannedRows, NDArray[np.int_]]:
        """Return the rows with corners in place of their roundings, and the indices of the remaining rows."""
        kept = np.flatnonzero(np.isfinite(self.corner[:, 0]))
        rows = replace(
            self, **{key: values[kept] for key, values in vars(self).items() if key != "fit" and values is not None}
        )
        return replace(rows, position=rows.position + rows.corner), kept


def follow_moves(
    rows: PlannedRows, cycle: float, ends: NDArray[np.int_], moves: Sequence[Move], bases: Sequence[Array]
) -> list[str]:
    """Return a message on the first move that departs from its rows or their planned time, or no message.

    `ends` is the row at the end of each move, `bases` the frame of its positions, in the base frame [mm]; `cycle` is
    the least time of a move. [s]
    """
    step = np.linalg.norm(np.diff(rows.position, axis=0, prepend=rows.position[:1]), axis=1)
    duration, stops = np.diff(rows.time, prepend=rows.time[0] - 1.0), np.zeros(len(step), bool)
    stops[ends[[move.stops for move in moves]]] = True
    moving, corners = step > 0.0, np.abs(rows.corner).max(axis=1) > 0.0
    duration[moving] = (step / np.maximum(send_speeds(step, duration, stops, corners, rows.cam_feed), 1e-9))[moving]
    for a, b, move, base in zip(ends[:-1].tolist(), ends[1:].tolist(), moves[1:], bases[1:], strict=True):
        if move.kind != "joint":
            wrong = _follow(rows, a, b, move, base) or _time(rows, cycle, a, b, move, base, step, duration)
        else:
            wrong = "a joint move leads past rows" if b > a + 1 else ""
        if wrong:
            return [f"{wrong} between rows {a} and {b}"]
    return []


def _follow(rows: PlannedRows, a: int, b: int, move: Move, base: Array) -> str:
    """Return a message if rows of a move lie too far from it, or its rotation is not even; otherwise ""."""
    x = rows.position[a : b + 1]
    found = follow_line(x) if move.via is None else follow_arc(x, (base @ move.via)[:3, 3])
    if found is None:
        return "an arc that is too flat, too long or not passed by its middle"
    off, share = found
    if off.max() > rows.fit + ROUNDING:
        return f"the planned tip is {1e3 * off.max():.3g} um off the move"
    if (np.diff(share) < -1e-6).any() and np.ptp(share) * np.linalg.norm(x[-1] - x[0]) > ROUNDING:
        return "the path turns back"
    turned = Rotation.from_matrix(rows.rotation[a : b + 1])
    around = (turned[0].inv() * turned).as_rotvec(degrees=True)
    most = float(np.linalg.norm(around - share[:, None] * around[-1], axis=1).max())
    return f"the tool is turned by {most:.3g} deg off an even turn" if most > TURN else ""


def _time(
    rows: PlannedRows, cycle: float, a: int, b: int, move: Move, base: Array, step: Array, duration: Array
) -> str:
    """Return a message if the feed of a move does not match the planned time (at least a cycle) or speeds."""
    leg, start, end = slice(a + 1, b + 1), rows.position[a], rows.position[b]
    arc = None if move.via is None else find_arc(start, (base @ move.via)[:3, 3], end)
    length = float(np.linalg.norm(end - start)) if arc is None else arc.length
    if move.feed is None or rows.free[b] or length < 1e-6:
        return ""
    time, speed = float(duration[leg].sum()), step[leg] / np.maximum(duration[leg], 1e-9)
    planned = max(length / max(time, cycle), LEAST_FEED)
    if abs(move.feed - planned) > FEED * planned + FEED_STEP:
        return f"a feed of {move.feed:.4g} mm/s, the plan takes {planned:.4g}"
    off = np.abs(speed - planned)
    if time > SHORT * cycle and off.max() > UNEVEN * planned + FEED_STEP and speed.max() > LEAST_FEED:
        return f"a feed of {move.feed:.4g} mm/s, the plan has {speed[off.argmax()]:.4g}"
    return ""
