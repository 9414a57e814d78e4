"""Corners that a block asks to round or to cut off (,R ,C; Siemens RND CHR CHF) between two straight moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

from compplan.toolpath.readers.arcs import NOTHING, Arc, Point, arc_about, combine, cross, dot


@dataclass(frozen=True)
class GcodeCorner:
    """Hold a straight move that ends in a corner, until the move after it is known.

    Args:
        kind: ROUND (radius), LEG (from the corner to either end of the chamfer) or CHAMFER (its length).
        size: The size. [mm]
        start: Where the move begins. [mm]
        point: The corner. [mm]
        feed: Feed of the move. [mm/s]
        line: Line of its block.

    """

    kind: str
    size: float
    start: Point
    point: Point
    feed: float
    line: int


def cut_corner(corner: GcodeCorner, end: Point) -> tuple[Point, Point, Arc | None]:
    """Return where the first move ends, where the second begins, and the arc between them (None: a straight cut).

    With the angle t by which the path turns, a rounding of radius r begins r tan(t / 2) before the corner, and a
    chamfer of length c begins c / (2 cos(t / 2)) before it.

    Args:
        corner: The corner.
        end: Where the second move ends. [mm]

    Raises:
        ValueError: If the moves are too short, or turn back on each other.

    """
    before, after = combine(1.0, corner.point, -1.0, corner.start), combine(1.0, end, -1.0, corner.point)
    lengths = math.hypot(*before), math.hypot(*after)
    if min(lengths) <= NOTHING:
        raise ValueError("a corner needs a move before and a move after it")
    one, other = combine(1.0 / lengths[0], before, 0.0, before), combine(1.0 / lengths[1], after, 0.0, after)
    normal = cross(one, other)
    turn = math.atan2(math.hypot(*normal), dot(one, other))
    if turn > math.radians(179.9):
        raise ValueError("the path turns back at this corner")
    if turn < 1e-6 or corner.size == 0.0:
        return corner.point, corner.point, None
    reach = {
        "ROUND": corner.size * math.tan(0.5 * turn), "LEG": corner.size,
        "CHAMFER": 0.5 * corner.size / math.cos(0.5 * turn),
    }[corner.kind]  # fmt: skip
    if corner.size < 0.0 or reach > min(lengths) + 1e-6:
        raise ValueError(f"a corner of {corner.size:g} mm takes {reach:g} mm of moves of {min(lengths):g} mm")
    first, last = combine(1.0, corner.point, -reach, one), combine(1.0, corner.point, reach, other)
    if corner.kind != "ROUND":
        return first, last, None
    size = math.hypot(*normal)
    normal = combine(1.0 / size, normal, 0.0, normal)
    centre = combine(1.0, first, corner.size, cross(normal, one))
    return first, last, arc_about(first, last, centre, normal, right_hand=True)
