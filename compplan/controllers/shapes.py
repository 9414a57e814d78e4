"""Lines and arcs through rows of a path, how far rows lie from one, and the speeds that are sent along them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array

#: Rows that an arc has to go by, its length [mm], greatest radius [mm], and greatest sweep [rad].
ARC_ROWS, ARC_LENGTH, ARC_RADIUS, ARC_SWEEP = 2, 0.5, 2e4, float(np.radians(170.0))
#: Least share of an arc at which the point between may lie, at either end.
MIDDLE = 0.2
#: Least angle that the point between and the end make at the start. RAPID asks for it, as for 0.1 mm between. [rad]
ARC_ANGLE = float(np.radians(1.0))
#: Greatest ratio of two speeds within a move.
RATIO = 1.05
#: Share by which the feed of a move has to differ from the one before, so that another feed is written.
HELD = 0.01
#: Cycles below which a move may join rows of any speed.
SHORT = 2.0
#: Least feed that is written, the least that every language states: 1 cm/min in FANUC programs. [mm/s]
LEAST_FEED = 1.0 / 6.0
#: Time beside a rest in which the controller changes the speed by itself [s], and the ratio of speeds that ends it.
RAMP, REACHED = 0.5, 1.01


def size_of(vector: Array) -> float:
    """Return the length of a vector, with numpy's digits in a fifth of its time. Shape (3,)."""
    return math.sqrt(vector @ vector)


def sizes_of(vectors: Array) -> Array:
    """Return the lengths of vectors, with numpy's digits. Shape (k, 3) -> (k,)."""
    square = vectors * vectors
    return np.asarray(np.sqrt(square[:, 0] + square[:, 1] + square[:, 2]))


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
        return sizes_of(arm), np.linspace(0.0, 1.0, len(x))
    share = arm @ chord / square
    return sizes_of(arm - share[:, None] * chord), share


def follow_arc(x: Array, via: Array) -> tuple[Array, Array] | None:
    """Return the same of the arc from the first row through a place to the last; None where controllers take none.

    Shapes (k, 3), (3,). [mm]
    """
    circle = find_circle(x[0], via, x[-1])
    if circle is None:
        return None
    centre, u, v, normal = circle
    radius = size_of(x[0] - centre)
    arm = x - centre
    along, aside, height = arm @ u, arm @ v, arm @ normal
    angle = np.arctan2(aside, along)
    steps = np.diff(angle)
    if np.abs(steps).max() > np.pi:
        angle = np.unwrap(angle)
        steps = np.diff(angle)
    sweep, between = float(angle[-1]), float(np.arctan2((via - centre) @ v, (via - centre) @ u))
    if radius > ARC_RADIUS or not 0.0 < sweep < ARC_SWEEP or not MIDDLE <= between / sweep <= 1.0 - MIDDLE:
        return None
    off = np.hypot(np.hypot(along, aside) - radius, height)
    off[1:] = np.maximum(off[1:], radius * (1.0 - np.cos(0.5 * steps)))
    return off, angle / sweep


def is_flat(start: Array, via: Array, end: Array) -> bool:
    """Tell whether controllers may refuse an arc as too flat. Shape (3,) each."""
    first, second = via - start, end - start
    return bool(size_of(cross(first, second)) < np.tan(ARC_ANGLE) * (first @ second))


def find_via(x: Array, middle: int) -> Array:
    """Return a place beside a middle row, on the circle from the first row to the last that lies nearest to all.

    Of circles through both ends in the plane of the greatest bulge, with t along the chord of length L and y across, c
    = sum y (t^2 + y^2 - L t) / (2 sum y^2) puts the centre of the one of least squares at (L / 2, c). Where the rows
    lie on a line the place is the row itself. Shape (k, 3). [mm]
    """
    chord = x[-1] - x[0]
    length = size_of(chord)
    arm = x - x[0]
    if length <= 0.0:
        return x[middle]
    along = chord / length
    t = arm @ along
    aside = arm - t[:, None] * along
    across = aside.sum(axis=0)
    across = (aside @ across) @ aside
    size = size_of(across)
    if size <= 0.0:
        return x[middle]
    across = across / size
    y = aside @ across
    c = float(y @ (t * t + y * y - length * t) / (2.0 * (y @ y)))
    centre = x[0] + 0.5 * length * along + c * across
    radius = float(np.hypot(0.5 * length, c))
    spoke = (t[middle] - 0.5 * length) * along + (y[middle] - c) * across
    return np.asarray(centre + radius / max(size_of(spoke), 1e-12) * spoke)


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
    u = -arm / size_of(arm)
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


def send_speeds(
    step: Array, lasts: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], asked: Array | None
) -> Array:
    """Return the speed that is sent for the move to each row, starts from rest and stops left to the controller.

    Args:
        step: Way to each row. Shape (n,). [mm]
        lasts: Time of it. Shape (n,). [s]
        stops: Rows where the tool stands. Shape (n,).
        corners: Rows that are corners, which a zone leads around. Shape (n,).
        asked: Feed that the CAM file asks for; without it no leg has a speed of its own. Shape (n,). [mm/s]

    Returns:
        Shape (n,). [mm/s]
    """
    speed = step / np.maximum(lasts, 1e-9)
    if asked is not None:
        speed = _level_legs(speed, lasts, stops, corners, asked)
    return _leave_ramps(speed, lasts, stops | corners)


def _level_legs(
    speed: Array, lasts: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], asked: Array
) -> Array:
    """Return speeds that do not change along short legs from rest or corner to rest or corner.

    There the controller changes the speed by itself. A leg between two corners takes the time that the plan takes; one
    from rest, or to it, has the greatest speed of the plan, as the controller still has to come to it.

    A leg ends where the feed changes that is asked for.
    """
    level, cuts = speed.copy(), asked > 0.0  # rapid moves ask for no feed
    changes = np.append(cuts[1:] & cuts[:-1] & (np.abs(np.diff(asked)) > 1e-9 * asked[:-1]), False)
    at = np.flatnonzero(stops | corners | changes)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        leg = slice(a + 1, b + 1)
        if lasts[leg].sum() <= 2.0 * RAMP and not (changes[a] or changes[b]):
            rests = stops[a] or stops[b]
            level[leg] = speed[leg].max() if rests else speed[leg] @ lasts[leg] / max(lasts[leg].sum(), 1e-9)
    return level


def _leave_ramps(speed: Array, lasts: Array, stops: NDArray[np.bool_]) -> Array:
    """Return speeds as they are sent: beside a rest the one that the plan has reached, or comes from, within `RAMP`.

    The speed has to rise from row to row up to there, and not to fall at once again.
    """
    sent, at = speed.copy(), np.flatnonzero(stops)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if b - a < 2:
            continue
        for way in (slice(a + 1, b + 1), slice(b, a, -1)):
            v, time = speed[way], np.cumsum(lasts[way])
            near = v[: max(int(np.searchsorted(time, RAMP)), 1)]
            reached = int(np.argmax(near * REACHED >= near.max()))
            stays = reached == 0 or reached + 1 == len(v) or v[reached + 1] > REACHED * v[reached - 1]
            if stays and (np.diff(v[: reached + 1]) > 0.0).all():
                sent[way][:reached] = v[reached]
    return sent
