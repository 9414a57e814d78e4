"""Frames of a CNC program: maps from program coordinates to the part frame [mm], for single points as tuples."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from compplan.toolpath.readers.arcs import Point, combine, cross, dot, set_levels

Rows = tuple[Point, Point, Point]
UNIT: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Point = (0.0, 0.0, 0.0)
UP: Point = (0.0, 0.0, 1.0)
#: Normals of the planes G17 to G19, their first and second axis, and the infeed axis (tool axis).
PLANE_NORMALS: dict[int, Point] = {17: (0.0, 0.0, 1.0), 18: (0.0, 1.0, 0.0), 19: (1.0, 0.0, 0.0)}
PLANE_AXES = {17: (0, 1), 18: (2, 0), 19: (1, 2)}
DEEP_AXIS = {17: 2, 18: 1, 19: 0}


@dataclass(frozen=True)
class Frame:
    """Affine map p_part = rows p + origin [mm]; `rows` combines rotations, mirrors and scales.

    `scale` holds for a similarity.
    """

    rows: Rows = UNIT
    origin: Point = ORIGIN

    @property
    def plain(self) -> bool:
        """Whether the frame is a pure translation."""
        return self.rows is UNIT or self.rows == UNIT

    def apply(self, point: Point) -> Point:
        """Transform a point of the frame to the part."""
        x, y, z = self.origin
        if self.rows is UNIT:
            return point[0] + x, point[1] + y, point[2] + z
        a, b, c = self.rows
        return dot(a, point) + x, dot(b, point) + y, dot(c, point) + z

    def turn(self, vector: Point) -> Point:
        """Transform a direction of the frame to the part, without the origin."""
        a, b, c = self.rows
        return dot(a, vector), dot(b, vector), dot(c, vector)

    def then(self, other: Frame) -> Frame:
        """Return the composition with `other`, a frame inside this one."""
        columns = tuple(zip(*other.rows, strict=True))
        rows = tuple(tuple(dot(row, column) for column in columns) for row in self.rows)  # type: ignore[arg-type]
        return Frame(UNIT if rows == UNIT else rows, self.apply(other.origin))  # type: ignore[arg-type]

    def invert(self) -> Frame:
        """Return the inverse map."""
        if self.rows is UNIT:
            return Frame(UNIT, (-self.origin[0], -self.origin[1], -self.origin[2]))
        a, b, c = self.rows
        columns = cross(b, c), cross(c, a), cross(a, b)
        size = dot(a, columns[0])
        rows = tuple(tuple(column[i] / size for column in columns) for i in range(3))
        back = Frame(rows)  # type: ignore[arg-type]
        x, y, z = back.turn(self.origin)
        return Frame(back.rows, (-x, -y, -z))

    @property
    def similar(self) -> bool:
        """Whether the scale is the same in all directions."""
        a, b, c = self.rows
        size = dot(a, a)
        apart = (dot(a, b), dot(b, c), dot(c, a), dot(b, b) - size, dot(c, c) - size)
        return max(map(abs, apart)) <= 1e-9 * size

    @property
    def mirrored(self) -> bool:
        """Whether the frame is left-handed."""
        return dot(cross(self.rows[0], self.rows[1]), self.rows[2]) < 0.0


def rotate(axis: int, degrees: float) -> Frame:
    """Return a right-hand rotation about X, Y or Z (0, 1, 2); quarter turns are exact."""
    quarter = round(degrees / 90.0)
    if degrees == 90.0 * quarter:
        sine, cosine = ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))[quarter % 4]
    else:
        sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rows = [list(row) for row in UNIT]
    rows[one][one] = rows[other][other] = cosine
    rows[one][other], rows[other][one] = -sine, sine
    return Frame(tuple(tuple(row) for row in rows))  # type: ignore[arg-type]


def stretch(scales: Point, centre: Point = ORIGIN) -> Frame:
    """Return a scaling by a factor for each axis about a point [mm]; negative factors mirror."""
    x, y, z = (middle * (1.0 - scale) for middle, scale in zip(centre, scales, strict=True))
    return Frame(((scales[0], 0.0, 0.0), (0.0, scales[1], 0.0), (0.0, 0.0, scales[2])), (x, y, z))


def mirror(axes: Iterable[int], centre: Point = ORIGIN) -> Frame:
    """Return a mirror image along axes about a point [mm]."""
    return stretch(set_levels((1.0, 1.0, 1.0), dict.fromkeys(axes, -1.0)), centre)


def turn_about(centre: Point, turn: Frame) -> Frame:
    """Return a rotation about a point [mm]."""
    return Frame(turn.rows, combine(1.0, centre, -1.0, turn.turn(centre)))
