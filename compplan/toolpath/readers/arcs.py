"""Circular and helical arcs in space: construction, length and sampled points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from compplan.errors import InputError
from compplan.io.tables import Array

Point = tuple[float, float, float]
#: Greatest angle between points on an arc of any radius. [rad]
COARSEST = math.radians(10.0)
#: Tolerance of the radii at start and end, for rounded CAM output. [mm, share of the radius]
MISMATCH_MM = 0.02
MISMATCH_SHARE = 2e-3
#: Upper limit of this tolerance, as in LinuxCNC. [mm]
MOST_MISMATCH_MM = 0.5
#: Greatest plausible coordinate (100 km) and radius of an arc (1 km). [mm]
FARTHEST, LARGEST_RADIUS = 1e8, 1e6
#: Greatest number of turns of one arc or helix of a CNC program.
MOST_TURNS = 10_000
#: Greatest angle of a circle: 100 turns. [rad]
MOST_ANGLE = 200.0 * math.pi
#: Angles [rad] and lengths [mm] below this count as zero.
NOTHING = 1e-9


class OffCircleError(InputError):
    """Error of an arc whose start and end do not lie on one circle."""


@dataclass(frozen=True)
class Arc:
    """Circular or helical arc from centre + radius * first (a unit vector) by the angle `sweep` [rad] about `normal`.

    The centre is at the height of the start, `rise` is the displacement along the normal [mm]. `radius` and
    `end_radius` differ by rounding only [mm].
    """

    centre: Point
    first: Point
    normal: Point
    radius: float
    end_radius: float
    sweep: float
    rise: float = 0.0

    @property
    def length(self) -> float:
        """Length of the (helical) arc [mm]."""
        return math.hypot(0.5 * (self.radius + self.end_radius) * self.sweep, self.rise)

    @property
    def fits_circle(self) -> bool:
        """Whether start and end lie on one circle, within rounding."""
        return self.radius > NOTHING and abs(self.radius - self.end_radius) <= allow_mismatch(self.radius)

    def check_circle(self) -> None:
        """Refuse an arc whose start and end do not lie on one circle about its centre."""
        if not self.fits_circle:
            raise OffCircleError(f"arc starts {self.radius:.4f} mm from its centre and ends {self.end_radius:.4f} mm "
                                 "from it, expected the same radius; correct or re-post the arc")  # fmt: skip

    def tangent(self, angle: float) -> Point:
        """Return the tangent in the plane of the arc, without its pitch, after an angle of the sweep [rad]."""
        second = cross(self.normal, self.first)
        sense = math.copysign(1.0, self.sweep)
        turned, along = -math.sin(angle) * sense, math.cos(angle) * sense
        return combine(turned, self.first, along, second)

    def place(self, angles: Array) -> Array:
        """Return points on the arc after angles from its start [rad]. Shape (n,) -> (n, 3). [mm]"""
        share = angles / abs(self.sweep)
        reach = self.radius + (self.end_radius - self.radius) * share
        parts = np.array([reach * np.cos(angles), reach * np.sin(angles), self.rise * share])
        return np.asarray(np.asarray(self.centre) + parts.T @ np.array([self.first, self.tangent(0.0), self.normal]))


def dot(one: Point, other: Point) -> float:
    """Return the scalar product of two vectors."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def cross(one: Point, other: Point) -> Point:
    """Return the vector product of two vectors."""
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


def combine(a: float, one: Point, b: float, other: Point) -> Point:
    """Return a one + b other."""
    return a * one[0] + b * other[0], a * one[1] + b * other[1], a * one[2] + b * other[2]


def normalise(vector: Point) -> Point:
    """Return a vector scaled to length 1; raise a ValueError for a zero vector."""
    size = math.hypot(*vector)
    if size < 1e-12:
        raise ValueError("two points that coincide, or a vector without length, have no direction")
    return vector[0] / size, vector[1] / size, vector[2] / size


def orient(axis: Point, *, right_hand: bool) -> Point:
    """Return the axis about which a rotation is right-handed, from an axis and the sense of the rotation about it."""
    return axis if right_hand else (-axis[0], -axis[1], -axis[2])


def set_levels(point: Point, levels: Mapping[int, float]) -> Point:
    """Return a point with the coordinates of some axes replaced, by the number of the axis."""
    x, y, z = (levels.get(axis, level) for axis, level in enumerate(point))
    return x, y, z


def allow_mismatch(radius: float) -> float:
    """Return the allowed difference of the radii at start and end of an arc [mm]."""
    return min(max(MISMATCH_MM, MISMATCH_SHARE * radius), MOST_MISMATCH_MM)


def count_chords(arc: Arc, chord: float) -> int:
    """Return the number of chords of an arc with the chord error `chord` [mm], without its extreme points."""
    angle = 2.0 * math.acos(max(1.0 - chord / arc.radius, math.cos(0.5 * COARSEST)))
    return int(min(abs(arc.sweep) / angle, 1e9)) + 1


def arc_about(start: Point, end: Point, centre: Point, normal: Point, turns: int = 1) -> Arc:
    """Return the arc from start to end about an axis; a full circle if they coincide. [mm]

    The axis passes through the centre along the unit vector `normal`; the arc rotates about it by the right-hand rule.
    Each of the `turns` beyond the first adds a full turn.
    """
    travel, arm = combine(1.0, end, -1.0, start), combine(1.0, start, -1.0, centre)
    rise = dot(travel, normal)
    middle = combine(1.0, centre, dot(arm, normal), normal)
    to_start = combine(1.0, start, -1.0, middle)
    to_end = combine(1.0, combine(1.0, end, -rise, normal), -1.0, middle)
    radius, end_radius = math.hypot(*to_start), math.hypot(*to_end)
    first = combine(1.0 / max(radius, 1e-300), to_start, 0.0, to_start)
    full = 2.0 * math.pi
    sweep = full
    if math.dist(to_start, to_end) >= NOTHING:
        angle = math.atan2(dot(to_end, cross(normal, first)), dot(to_end, first))
        sweep = angle % full or full
    return Arc(middle, first, normal, radius, end_radius, sweep + full * (turns - 1), rise)


def centre_from_radius(start: Point, end: Point, normal: Point, radius: float) -> Point:
    """Return the centre of an arc with given radius; raise a ValueError if no such circle passes through both ends.

    A negative radius selects the longer of the two arcs; the arc rotates right-handed about the unit normal. [mm]
    """
    travel = combine(1.0, end, -1.0, start)
    across = combine(1.0, travel, -dot(travel, normal), normal)
    chord = math.hypot(*across)
    size = abs(radius)
    if chord <= NOTHING or 0.5 * chord - size > 0.25 * allow_mismatch(size):
        raise ValueError(f"arc of radius R {radius:g} mm cannot join ends that are {chord:g} mm apart, expected 0 < "
                         f"distance <= {2 * size:g} mm; correct R or an end point, or post arcs by centre")  # fmt: skip
    height = math.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0))
    middle = combine(1.0, start, 0.5, across)
    return combine(1.0, middle, math.copysign(height, radius) / chord, cross(normal, across))


def arc_through(start: Point, via: Point, end: Point) -> Arc | None:
    """Return the arc from start through a point to an end; None where they lie on a line. Any unit of length.

    With u from start to via, v from start to end and n = u x v, the centre lies at
    (|v|^2 (n x u) + |u|^2 (v x n)) / (2 |n|^2) from the start.
    """
    u, v = combine(1.0, via, -1.0, start), combine(1.0, end, -1.0, start)
    normal = cross(u, v)
    size, uu, vv = math.hypot(*normal), dot(u, u), dot(v, v)
    if size <= 1e-9 * max(uu, vv, 1e-18):
        return None
    offset = combine(vv, cross(normal, u), uu, cross(v, normal))
    centre = combine(1.0, start, 0.5 / (size * size), offset)
    return arc_about(start, end, centre, combine(1.0 / size, normal, 0.0, normal))


def build_arc(start: Point, via: Point, end: Point, angle: float | None = None) -> Arc:
    """Return the arc from start through a point to an end; raise an InputError where there is none. [mm]

    `angle` [rad], if given, replaces the sweep of the arc to `end`.
    """
    farthest = max(map(abs, (*start, *via, *end)))
    if not farthest < FARTHEST:
        raise InputError(f"circle through a point as far off as {farthest:g} mm, expected less than {FARTHEST:g} mm")
    arc = arc_through(start, via, end)
    if arc is None:
        raise InputError("start, middle and end of a circle lie on a line; correct a point, or write a straight move")
    if arc.radius > LARGEST_RADIUS:
        raise InputError(f"arc of radius {arc.radius:g} mm, at most {LARGEST_RADIUS:g} mm is read")
    if angle is None:
        return arc
    if not 0.0 < abs(angle) <= MOST_ANGLE:
        most = f"expected at most {math.degrees(MOST_ANGLE):g} and not 0"
        raise InputError(f"angle of a circle is {math.degrees(angle):g} deg, {most}")
    return Arc(arc.centre, arc.first, arc.normal, arc.radius, arc.radius, angle, 0.0)


def sample_arc(arc: Arc, chord: float) -> Array:
    """Return points on an arc, without its start, with a chord error of at most `chord` [mm]. Shape (n, 3). [mm]

    They are evenly spaced; the extreme points of a flat arc in x, y and z are added.
    """
    span, second = abs(arc.sweep), arc.tangent(0.0)
    step = 2.0 * math.acos(max(1.0 - chord / arc.radius, math.cos(0.5 * COARSEST)))
    count = max(math.ceil(span / step - NOTHING), 1)
    found = [(place + 1) * (span / count) for place in range(count)]
    for one, other in zip(arc.first, second, strict=True):
        base = math.atan2(other, one)  # angle of an extreme point: tan(angle) = second / first
        turns = range(math.ceil(-base / math.pi), math.floor((span - base) / math.pi) + 1)
        extremes = [base + turn * math.pi for turn in turns] if math.hypot(one, other) > NOTHING else []
        found += [angle for angle in extremes if NOTHING < angle < span - NOTHING]
    found.sort()
    return arc.place(
        np.array([one for before, one in zip([-1.0, *found], found, strict=False) if one - before >= NOTHING])
    )
