"""Circular and helical arcs in space: their length, and points on many of them at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.tables import Array

Point = tuple[float, float, float]
#: Greatest step of angle between points on an arc, however small it is. [rad]
COARSEST = math.radians(10.0)
#: How far start and end may differ in radius: rounding of CAM output. [mm, share of the radius]
MISMATCH_MM = 0.02
MISMATCH_SHARE = 2e-3
#: ... and never more than this, as in LinuxCNC. [mm]
MOST_MISMATCH_MM = 0.5
#: Greatest coordinate that is taken for true: a hundred kilometres; greatest radius of an arc: a kilometre. [mm]
FARTHEST, LARGEST_RADIUS = 1e8, 1e6
#: Greatest angle of a circle: a hundred turns. [rad]
MOST_ANGLE = 200.0 * math.pi
#: Angles [rad] and lengths [mm] below this count as zero.
NOTHING = 1e-9


@dataclass(frozen=True)
class Arc:
    """Describe an arc: it begins at centre + radius first and turns by `sweep` about `normal`.

    Args:
        centre: Centre, at the height of the start. [mm]
        first: Unit vector from the centre to the start.
        normal: Unit vector that the sweep turns about by the right hand.
        radius: Radius at the start. [mm]
        end_radius: Radius at the end: that of the start but for rounding. [mm]
        sweep: Angle, signed. [rad]
        rise: Travel along the normal. [mm]

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

    def tangent(self, angle: float) -> Point:
        """Return the direction of travel, pitch aside, after an angle of the sweep [rad]."""
        second = cross(self.normal, self.first)
        sense = math.copysign(1.0, self.sweep)
        turned, along = -math.sin(angle) * sense, math.cos(angle) * sense
        return combine(turned, self.first, along, second)


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
    """Return a vector of length 1."""
    size = math.hypot(*vector)
    return vector[0] / size, vector[1] / size, vector[2] / size


def set_level(point: Point, axis: int, level: float) -> Point:
    """Return a point at another level along an axis."""
    moved = list(point)
    moved[axis] = level
    return moved[0], moved[1], moved[2]


def fits_circle(radius: float, end_radius: float) -> bool:
    """Return whether start and end lie on one circle but for rounding."""
    return radius > NOTHING and abs(radius - end_radius) <= allow_mismatch(radius)


def allow_mismatch(radius: float) -> float:
    """Return how far the radii at start and end of an arc may differ [mm]."""
    return min(max(MISMATCH_MM, MISMATCH_SHARE * radius), MOST_MISMATCH_MM)


def count_chords(arc: Arc, chord: float) -> int:
    """Return how many chords, which keep to their arc, an arc takes, its extremes aside."""
    angle = 2.0 * math.acos(max(1.0 - chord / arc.radius, math.cos(0.5 * COARSEST)))
    return int(min(abs(arc.sweep) / angle, 1e9)) + 1


def arc_about(start: Point, end: Point, centre: Point, normal: Point, *, right_hand: bool, turns: int = 1) -> Arc:
    """Return the arc from start to end about an axis; start and end at one place make a full circle. [mm]

    The axis passes through the centre along the unit vector `normal`; the arc turns about it by the right-hand rule,
    or against it.
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
        sweep = (angle if right_hand else -angle) % full or full
    sweep += full * (turns - 1)
    return Arc(middle, first, normal, radius, end_radius, sweep if right_hand else -sweep, rise)


def centre_from_radius(start: Point, end: Point, normal: Point, radius: float, *, right_hand: bool) -> Point | None:
    """Return the centre of an arc that is given by its radius; None where no circle of this radius meets both ends.

    A negative radius makes the longer of the two arcs; the arc turns about the unit normal of the plane. [mm]
    """
    travel = combine(1.0, end, -1.0, start)
    across = combine(1.0, travel, -dot(travel, normal), normal)
    chord = math.hypot(*across)
    size = abs(radius)
    if chord <= NOTHING or 0.5 * chord - size > 0.25 * allow_mismatch(size):
        return None
    height = math.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0))
    sign = 1.0 if right_hand == (radius > 0.0) else -1.0
    middle = combine(1.0, start, 0.5, across)
    return combine(1.0, middle, sign * height / chord, cross(normal, across))


def find_arc(start: Point, via: Point, end: Point, angle: float | None = None) -> Arc:
    """Return the arc from start over a point to an end.

    With u from start to via, v from start to end and n = u x v, the centre lies at
    (|v|^2 (n x u) + |u|^2 (v x n)) / (2 |n|^2) from the start.

    Args:
        start: Start. [mm]
        via: Point on the way. [mm]
        end: End. [mm]
        angle: Angle of the arc in place of the one that ends at `end`. [rad]

    """
    u, v = combine(1.0, via, -1.0, start), combine(1.0, end, -1.0, start)
    normal = cross(u, v)
    size, uu, vv = math.hypot(*normal), dot(u, u), dot(v, v)
    farthest = max(map(abs, (*start, *via, *end)))
    if not farthest < FARTHEST:
        raise InputError(f"circle through a point as far off as {farthest:g} mm, expected less than {FARTHEST:g} mm")
    if size <= 1e-9 * max(uu, vv, 1e-9):
        raise InputError("start, middle and end of a circle lie on a line")
    offset = combine(vv, cross(normal, u), uu, cross(v, normal))
    centre = combine(1.0, start, 0.5 / (size * size), offset)
    arc = arc_about(start, end, centre, combine(1.0 / size, normal, 0.0, normal), right_hand=True)
    if arc.radius > LARGEST_RADIUS:
        raise InputError(f"arc of radius {arc.radius:g} mm, at most {LARGEST_RADIUS:g} mm is read")
    if angle is None:
        return arc
    if not 0.0 < abs(angle) <= MOST_ANGLE:
        most = f"expected at most {math.degrees(MOST_ANGLE):g} and not 0"
        raise InputError(f"angle of a circle is {math.degrees(angle):g} deg, {most}")
    return Arc(arc.centre, arc.first, arc.normal, arc.radius, arc.radius, angle, 0.0)


def sample_arcs(arcs: Sequence[Arc], chord: float) -> tuple[Array, NDArray[np.int64]]:
    """Return points on arcs, after the start of each up to its end, and how many each arc has.

    The points lie evenly; the greatest and smallest x, y and z of flat arcs are among them.

    Args:
        arcs: The arcs.
        chord: Greatest distance between an arc and its chords. [mm]

    Returns:
        Points, shape (m, 3) [mm], and their number for each arc, shape (len(arcs),).

    """
    if not arcs:
        return np.empty((0, 3)), np.empty(0, dtype=np.int64)
    centre, first, normal = (np.array([getattr(arc, name) for arc in arcs]) for name in ("centre", "first", "normal"))
    radius, end_radius, sweep, rise = np.array([(a.radius, a.end_radius, a.sweep, a.rise) for a in arcs]).T
    second = np.cross(normal, first) * np.sign(sweep)[:, None]
    span = np.abs(sweep)
    step = 2.0 * np.arccos(np.maximum(1.0 - chord / radius, math.cos(0.5 * COARSEST)))
    number = np.maximum(np.ceil(span / step - NOTHING), 1).astype(np.int64)
    owner, place = _count_up(number)
    owners, angles = [owner], [(place + 1) * (span / number)[owner]]
    for axis in range(3):  # extremes: tan(angle) = second / first
        base = np.arctan2(second[:, axis], first[:, axis])
        lowest = np.ceil(-base / np.pi)
        between = np.floor((span - base) / np.pi) - lowest + 1
        moves = np.hypot(second[:, axis], first[:, axis]) > NOTHING
        owner, place = _count_up(np.where(moves, np.maximum(between, 0), 0).astype(np.int64))
        angle = base[owner] + (lowest[owner] + place) * np.pi
        inside = (angle > NOTHING) & (angle < span[owner] - NOTHING)
        owners.append(owner[inside])
        angles.append(angle[inside])
    owner, angle = np.concatenate(owners), np.concatenate(angles)
    order = np.lexsort((angle, owner))
    owner, angle = owner[order], angle[order]
    repeated = (np.diff(owner) == 0) & (np.diff(angle) < NOTHING)
    keep = ~np.concatenate([repeated, [False]])
    owner, angle = owner[keep], angle[keep]
    share = angle / span[owner]
    reach = radius[owner] + (end_radius - radius)[owner] * share
    around = np.cos(angle)[:, None] * first[owner] + np.sin(angle)[:, None] * second[owner]
    points = centre[owner] + reach[:, None] * around + (rise[owner] * share)[:, None] * normal[owner]
    return points, np.bincount(owner, minlength=len(arcs))


def _count_up(number: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for groups of these sizes in a row, the group and the place in it (from 0) of every member."""
    group = np.repeat(np.arange(len(number)), number)
    return group, np.arange(len(group)) - (np.cumsum(number) - number)[group]
