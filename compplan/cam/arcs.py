"""Circular and helical arcs in space: their length, and points on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.tables import Array

#: Greatest step of angle between points on an arc, however small it is. [rad]
COARSEST = np.radians(10.0)
#: How far start and end may differ in radius: rounding of CAM output. [mm, share of the radius]
MISMATCH_MM = 0.02
MISMATCH_SHARE = 2e-3


@dataclass(frozen=True)
class Arc:
    """Describe an arc: it begins at centre + radius first and turns by `sweep` about `normal`.

    Args:
        centre: Centre, at the height of the start. Shape (3,). [mm]
        first: Unit vector from the centre to the start. Shape (3,).
        normal: Unit vector that the sweep turns about by the right hand. Shape (3,).
        radius: Radius at the start. [mm]
        end_radius: Radius at the end: that of the start but for rounding. [mm]
        sweep: Angle, signed. [rad]
        rise: Travel along the normal. [mm]
    """

    centre: Array
    first: Array
    normal: Array
    radius: float
    end_radius: float
    sweep: float
    rise: float = 0.0

    @property
    def length(self) -> float:
        """Length of the (helical) arc [mm]."""
        return float(np.hypot(0.5 * (self.radius + self.end_radius) * self.sweep, self.rise))

    def sample(self, chord: float) -> Array:
        """Return points after the start up to the end, no chord further than `chord` [mm] from the arc. Shape (n, 3).

        The greatest and smallest x, y and z of a flat arc are among the points.
        """
        step = 2.0 * np.arccos(max(1.0 - chord / self.radius, np.cos(0.5 * COARSEST)))
        count = max(1, int(np.ceil(abs(self.sweep) / step - 1e-9)))
        angles = np.linspace(0.0, self.sweep, count + 1)[1:]
        second = np.cross(self.normal, self.first)
        low, high = min(0.0, self.sweep), max(0.0, self.sweep)
        extremes = []
        for one, other in zip(self.first, second, strict=True):
            if np.hypot(one, other) > 1e-9:
                base = np.arctan2(other, one)
                turns = np.arange(np.ceil((low - base) / np.pi), np.floor((high - base) / np.pi) + 1.0)
                extremes.append(base + turns * np.pi)
        extra = np.concatenate(extremes) if extremes else np.empty(0)
        extra = extra[np.abs(extra - self.sweep) > 1e-9]
        extra = extra[np.abs(extra) > 1e-9]
        angles = np.unique(np.concatenate([angles, extra]) * np.sign(self.sweep)) * np.sign(self.sweep)
        share = angles / self.sweep
        radius = self.radius + (self.end_radius - self.radius) * share
        around = np.cos(angles)[:, None] * self.first + np.sin(angles)[:, None] * second
        return np.asarray(self.centre + radius[:, None] * around + (self.rise * share)[:, None] * self.normal)


def fits_circle(radius: float, end_radius: float) -> bool:
    """Return whether start and end lie on one circle but for rounding."""
    return abs(radius - end_radius) <= max(MISMATCH_MM, MISMATCH_SHARE * radius)


def arc_about(start: Array, end: Array, centre: Array, normal: Array, *, right_hand: bool, turns: int = 1) -> Arc:
    """Return the arc from start to end about an axis; start and end at one place make a full circle.

    Args:
        start: Start. Shape (3,). [mm]
        end: End. Shape (3,). [mm]
        centre: A point of the axis. Shape (3,). [mm]
        normal: Direction of the axis, unit vector. Shape (3,).
        right_hand: Whether the arc turns about `normal` by the right hand, else against it.
        turns: 1 for less than a turn or a full circle; each further one adds a full turn.
    """
    rise = float((end - start) @ normal)
    middle = centre + normal * float((start - centre) @ normal)
    to_start, to_end = start - middle, end - rise * normal - middle
    radius, end_radius = float(np.linalg.norm(to_start)), float(np.linalg.norm(to_end))
    first = to_start / max(radius, 1e-300)
    second = np.cross(normal, first)
    angle = float(np.arctan2(to_end @ second, to_end @ first))
    closed = float(np.linalg.norm(to_end - to_start)) < 1e-9
    if closed:
        angle = 0.0
    sweep = angle % (2.0 * np.pi) if right_hand else -(-angle % (2.0 * np.pi))
    if closed or sweep == 0.0:
        sweep = 2.0 * np.pi if right_hand else -2.0 * np.pi
    sweep += np.copysign(2.0 * np.pi * (turns - 1), sweep)
    return Arc(middle, first, normal, radius, end_radius, sweep, rise)


def centre_from_radius(start: Array, end: Array, normal: Array, radius: float, *, right_hand: bool) -> Array | None:
    """Return the centre of an arc that is given by its radius; None where no circle of this radius meets both ends.

    Args:
        start: Start. Shape (3,). [mm]
        end: End. Shape (3,). [mm]
        normal: Unit normal of the plane. Shape (3,).
        radius: Radius; negative: the longer of the two arcs. [mm]
        right_hand: Whether the arc turns about `normal` by the right hand.
    """
    across = end - start
    across = across - float(across @ normal) * normal
    chord = float(np.linalg.norm(across))
    if chord <= 1e-9 or 0.5 * chord - abs(radius) > max(0.25 * MISMATCH_MM, 0.25 * MISMATCH_SHARE * abs(radius)):
        return None
    height = np.sqrt(max(radius * radius - 0.25 * chord * chord, 0.0))
    side = np.cross(normal, across / chord)
    sign = 1.0 if right_hand == (radius > 0.0) else -1.0
    return np.asarray(start + 0.5 * across + sign * height * side)
