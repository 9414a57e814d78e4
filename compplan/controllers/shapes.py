"""Lines and arcs through rows of a path: how far rows lie from one, and at which share of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from compplan.io.tables import Array

#: Rows that an arc has to go by, its length [mm], greatest radius [mm], and greatest sweep [rad].
ARC_ROWS, ARC_LENGTH, ARC_RADIUS, ARC_SWEEP = 2, 0.5, 2e4, float(np.radians(170.0))
#: Least share of an arc at which the point between may lie, at either end.
MIDDLE = 0.2
#: Least angle that the point between and the end make at the start. RAPID asks for it, as for 0.1 mm between. [rad]
ARC_ANGLE = float(np.radians(1.0))


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors, with numpy's digits in a tenth of its time. Shape (3,) each."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def follow_line(x: Array) -> tuple[Array, Array]:
    """Return how far rows lie from the line between first and last, and at which share of it. Shape (k, 3) [mm]."""
    arm, chord = x - x[0], x[-1] - x[0]
    square = float(chord @ chord)
    if square <= 0.0:
        return np.linalg.norm(arm, axis=1), np.linspace(0.0, 1.0, len(x))
    share = arm @ chord / square
    return np.linalg.norm(arm - share[:, None] * chord, axis=1), share


def follow_arc(x: Array, via: Array) -> tuple[Array, Array] | None:
    """Return the same of the arc from the first row through a place to the last; None where controllers take none.

    Shapes (k, 3), (3,). [mm]
    """
    circle = find_circle(x[0], via, x[-1])
    if circle is None:
        return None
    centre, u, v, normal = circle
    radius = float(np.linalg.norm(x[0] - centre))
    arm = x - centre
    along, aside, height = arm @ u, arm @ v, arm @ normal
    angle = np.unwrap(np.arctan2(aside, along))
    sweep, between = float(angle[-1]), float(np.arctan2((via - centre) @ v, (via - centre) @ u))
    if radius > ARC_RADIUS or not 0.0 < sweep < ARC_SWEEP or not MIDDLE <= between / sweep <= 1.0 - MIDDLE:
        return None
    bulge = radius * (1.0 - np.cos(0.5 * np.diff(angle, prepend=0.0)))
    return np.maximum(np.hypot(np.hypot(along, aside) - radius, height), bulge), angle / sweep


def is_flat(start: Array, via: Array, end: Array) -> bool:
    """Tell whether controllers may refuse an arc as too flat. Shape (3,) each."""
    first, second = via - start, end - start
    return bool(np.linalg.norm(cross(first, second)) < np.tan(ARC_ANGLE) * (first @ second))


def find_via(x: Array, middle: int) -> Array:
    """Return a place beside a middle row, on the circle from the first row to the last that lies nearest to all.

    Of circles through both ends in the plane of the greatest bulge, with t along the chord of length L and y across, c
    = sum y (t^2 + y^2 - L t) / (2 sum y^2) puts the centre of the one of least squares at (L / 2, c). Where the rows
    lie on a line the place is the row itself. Shape (k, 3). [mm]
    """
    chord = x[-1] - x[0]
    length = float(np.linalg.norm(chord))
    arm = x - x[0]
    if length <= 0.0:
        return x[middle]
    along = chord / length
    t = arm @ along
    aside = arm - t[:, None] * along
    across = aside.sum(axis=0)
    across = (aside @ across) @ aside
    size = float(np.linalg.norm(across))
    if size <= 0.0:
        return x[middle]
    across = across / size
    y = aside @ across
    c = float(y @ (t * t + y * y - length * t) / (2.0 * (y @ y)))
    centre = x[0] + 0.5 * length * along + c * across
    radius = float(np.hypot(0.5 * length, c))
    spoke = (t[middle] - 0.5 * length) * along + (y[middle] - c) * across
    return np.asarray(centre + radius / max(float(np.linalg.norm(spoke)), 1e-12) * spoke)


def find_circle(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array, Array] | None:
    """Return centre, direction to a, direction of travel there, and normal of the circle from a through b to c.

    None where the points lie on a line.
    """
    first, second = b - a, c - a
    normal = cross(first, second)
    square, scale = float(normal @ normal), float(first @ first) * float(second @ second)
    if square <= 1e-18 * scale or scale <= 0.0:
        return None
    arm = cross(first @ first * second - second @ second * first, normal) / (2.0 * square)
    u = -arm / np.linalg.norm(arm)
    normal = normal / np.sqrt(square)
    return a + arm, u, cross(normal, u), normal


class MoveArc(NamedTuple):
    """An arc: centre, arm from there to its start, that arm a right angle further, and the angle to its end [rad].

    Lengths in the unit of the places that it was found from. Shapes (3,).
    """

    centre: Array
    arm: Array
    side: Array
    sweep: float

    @property
    def length(self) -> float:
        """Length of the arc."""
        return float(np.linalg.norm(self.arm)) * self.sweep

    def place(self, share: Array) -> Array:
        """Return places at shares of the arc. Shape (k,) -> (k, 3)."""
        turned = share[:, None] * self.sweep
        return np.asarray(self.centre + np.cos(turned) * self.arm + np.sin(turned) * self.side)

    def directions(self) -> Array:
        """Return the directions of travel at start and end. Shape (2, 3)."""
        ways = np.stack([self.side, np.cos(self.sweep) * self.side - np.sin(self.sweep) * self.arm])
        return np.asarray(ways / max(float(np.linalg.norm(self.arm)), 1e-12))


def find_arc(start: Array, via: Array, end: Array) -> MoveArc | None:
    """Return the arc from one place through another to a third; None where they lie on a line."""
    circle = find_circle(start, via, end)
    if circle is None:
        return None
    centre, u, v, _ = circle
    reach, radius = end - centre, float(np.linalg.norm(start - centre))
    return MoveArc(centre, radius * u, radius * v, float(np.arctan2(reach @ v, reach @ u) % (2.0 * np.pi)))
