"""Frames of a CNC program: where its coordinates stand in the part. Millimetres; plain numbers, one point at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from compplan.toolpath.readers.arcs import Point, combine, cross, dot, normalise

Rows = tuple[Point, Point, Point]
UNIT: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NOWHERE: Point = (0.0, 0.0, 0.0)
#: Normals of the planes G17 to G19, their first and second axis, and the one that a tool points along.
PLANE_NORMALS: dict[int, Point] = {17: (0.0, 0.0, 1.0), 18: (0.0, 1.0, 0.0), 19: (1.0, 0.0, 0.0)}
PLANE_AXES = {17: (0, 1), 18: (2, 0), 19: (1, 2)}
DEEP_AXIS = {17: 2, 18: 1, 19: 0}


@dataclass(frozen=True)
class Frame:
    """Hold an affine map: p_part = rows p + origin [mm]; rows is a rotation, mirrored or not, times a scale.

    `scale` is that of a similarity.
    """

    rows: Rows = UNIT
    origin: Point = NOWHERE

    @property
    def plain(self) -> bool:
        """Whether the frame is shifted at most."""
        return self.rows is UNIT or self.rows == UNIT

    def apply(self, point: Point) -> Point:
        """Return where a point of the frame stands."""
        x, y, z = self.origin
        if self.rows is UNIT:
            return point[0] + x, point[1] + y, point[2] + z
        a, b, c = self.rows
        return dot(a, point) + x, dot(b, point) + y, dot(c, point) + z

    def turn(self, vector: Point) -> Point:
        """Return a vector of the frame."""
        a, b, c = self.rows
        return dot(a, vector), dot(b, vector), dot(c, vector)

    def then(self, other: Frame) -> Frame:
        """Return the frame that stands at `other` in this one."""
        columns = tuple(zip(*other.rows, strict=True))
        rows = tuple(tuple(dot(row, column) for column in columns) for row in self.rows)  # type: ignore[arg-type]
        return Frame(UNIT if rows == UNIT else rows, self.apply(other.origin))  # type: ignore[arg-type]

    def invert(self) -> Frame:
        """Return the frame of the part as seen from this one."""
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
        """Whether lengths grow alike in all directions."""
        a, b, c = self.rows
        size = dot(a, a)
        apart = (dot(a, b), dot(b, c), dot(c, a), dot(b, b) - size, dot(c, c) - size)
        return max(map(abs, apart)) <= 1e-9 * size

    @property
    def mirrored(self) -> bool:
        """Whether the frame is left-handed."""
        return dot(cross(self.rows[0], self.rows[1]), self.rows[2]) < 0.0

    @property
    def scale(self) -> float:
        """How long a unit of the frame is."""
        return math.sqrt(dot(self.rows[0], self.rows[0]))


def shift(x: float, y: float, z: float) -> Frame:
    """Return a frame that is shifted."""
    return Frame(UNIT, (x, y, z))


def rotate(axis: int, degrees: float) -> Frame:
    """Return a frame that is turned about X, Y or Z (0, 1, 2) by the right hand; quarter turns are exact."""
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


def stretch(x: float, y: float, z: float) -> Frame:
    """Return a frame whose axes are mirrored or scaled by these factors, of one size."""
    return Frame(((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)))


def stand_on(first: Point, normal: Point) -> Frame:
    """Return the frame whose z points along a normal, and x as far as it can along a direction; else ValueError."""
    z = normalise(normal)
    y = normalise(cross(z, normalise(first)))
    x = cross(y, z)
    return Frame(tuple(zip(x, y, z, strict=True)))  # type: ignore[arg-type]


def scale_about(centre: Point, scales: Point) -> Frame:
    """Return a scaling of each axis about a point [mm]; negative scales mirror."""
    x, y, z = (centre[axis] * (1.0 - scales[axis]) for axis in range(3))
    return Frame(((scales[0], 0.0, 0.0), (0.0, scales[1], 0.0), (0.0, 0.0, scales[2])), (x, y, z))


def turn_about(centre: Point, turn: Frame) -> Frame:
    """Return a rotation about a point [mm]."""
    return Frame(turn.rows, combine(1.0, centre, -1.0, turn.turn(centre)))
