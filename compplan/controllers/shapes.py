"""Lines and arcs fitted to path rows, distances of rows from them, and speeds sent to the controller."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.toolpath.readers.arcs import Arc, arc_through

#: Fewest rows of an arc, its least length [mm], greatest radius [mm], and greatest sweep [rad].
ARC_ROWS, ARC_LENGTH, ARC_RADIUS, ARC_SWEEP = 2, 0.5, 2e4, float(np.radians(170.0))
#: Least share of an arc's sweep between the via point and either end.
MIDDLE = 0.2
#: Least angle at the start between via point and end point. RAPID requires it, as well as 0.1 mm between. [rad]
ARC_ANGLE = float(np.radians(1.0))
#: Greatest ratio of two speeds within a move.
RATIO = 1.05
#: Relative difference to the previous move's feed from which a new feed is written.
HELD = 0.01
#: Duration below which a move may join rows of any speed. [interpolator cycles]
SHORT = 2.0
#: Least feed that is written; every language can state it: 1 cm/min in FANUC programs. [mm/s]
LEAST_FEED = 1.0 / 6.0
#: Time before or after a rest in which the controller sets the speed itself [s], and ratio of speeds that ends it.
RAMP, REACHED = 0.5, 1.01


def size_of(vector: Array) -> float:
    """Return the length of a vector, with numpy's digits in a fifth of its time. Shape (3,)."""
    return math.sqrt(vector @ vector)


def sizes_of(vectors: Array) -> Array:
    """Return the lengths of vectors, with numpy's digits. Shape (k, 3) -> (k,)."""
    square = vectors * vectors
    return np.asarray(np.sqrt(square[:, 0] + square[:, 1] + square[:, 2]))


def follow_line(x: Array) -> tuple[Array, Array]:
    """Return distances of rows from the line between first and last, and their shares along it. Shape (k, 3) [mm]."""
    arm, chord = x - x[0], x[-1] - x[0]
    square = float(chord @ chord)
    if square <= 0.0:
        return sizes_of(arm), np.linspace(0.0, 1.0, len(x))
    share = arm @ chord / square
    return sizes_of(arm - share[:, None] * chord), share


def follow_arc(x: Array, via: Array) -> tuple[Array, Array] | None:
    """Return distances and shares for the arc from the first row through a via point to the last.

    None where controllers do not accept the arc. Shapes (k, 3), (3,). [mm]
    """
    arc = find_arc(x[0], via, x[-1])
    if arc is None:
        return None
    centre, axes = np.array(arc.centre), np.array([arc.first, arc.tangent(0.0), arc.normal])
    along, aside, height = axes @ (x - centre).T
    angle = np.arctan2(aside, along)
    steps = np.diff(angle)
    if np.abs(steps).max() > np.pi:
        angle = np.unwrap(angle)
        steps = np.diff(angle)
    sweep, between = float(angle[-1]), float(np.arctan2(*(axes[1::-1] @ (via - centre))))
    if arc.radius > ARC_RADIUS or not 0.0 < sweep < ARC_SWEEP or not MIDDLE <= between / sweep <= 1.0 - MIDDLE:
        return None
    off = np.hypot(np.hypot(along, aside) - arc.radius, height)
    off[1:] = np.maximum(off[1:], arc.radius * (1.0 - np.cos(0.5 * steps)))
    return off, angle / sweep


def is_flat(start: Array, via: Array, end: Array) -> bool:
    """Return whether controllers may refuse an arc as too flat. Shape (3,) each."""
    first, second = via - start, end - start
    return bool(first @ second > math.cos(ARC_ANGLE) * size_of(first) * size_of(second))


def find_via(x: Array, middle: int) -> Array:
    """Return a via point near a middle row, on the circle from the first row to the last that fits all rows best.

    Among circles through both ends in the plane of the greatest bulge, the least-squares centre is at (L / 2, c), with
    c = sum y (t^2 + y^2 - L t) / (2 sum y^2). t is the coordinate along the chord of length L, y the one across it.
    Where the rows lie on a line, the via point is the row itself. Shape (k, 3). [mm]
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


def find_arc(start: Array, via: Array, end: Array) -> Arc | None:
    """Return the arc from one point through a second to a third; None where they lie on a line. Shape (3,) each."""
    return arc_through(start.tolist(), via.tolist(), end.tolist())


def send_speeds(
    step: Array, duration: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], cam_feed: Array | None
) -> Array:
    """Return the speed that is sent for the move to each row; the controller adds ramps from rest and to stops.

    Args:
        step: Distance to each row. Shape (n,). [mm]
        duration: Duration of each step. Shape (n,). [s]
        stops: Rows where the tool stops. Shape (n,).
        corners: Rows that are corners with a blend zone. Shape (n,).
        cam_feed: Feed of the CAM file; without it the speed is not levelled along short legs. Shape (n,). [mm/s]

    Returns:
        Shape (n,). [mm/s]
    """
    speed = step / np.maximum(duration, 1e-9)
    if cam_feed is not None:
        speed = _level_legs(speed, duration, stops, corners, cam_feed)
    return _leave_ramps(speed, duration, stops | corners)


def _level_legs(
    speed: Array, duration: Array, stops: NDArray[np.bool_], corners: NDArray[np.bool_], cam_feed: Array
) -> Array:
    """Return speeds that are constant along short legs between rests and corners.

    There the controller changes the speed by itself. A leg between two corners takes the planned time. A leg from rest
    or to rest has the greatest planned speed, because the controller still has to accelerate to it.

    A leg also ends where the feed of the CAM file changes.
    """
    level, cuts = speed.copy(), cam_feed > 0.0  # rapid moves have no CAM feed
    changes = np.append(cuts[1:] & cuts[:-1] & (np.abs(np.diff(cam_feed)) > 1e-9 * cam_feed[:-1]), False)
    at = np.flatnonzero(stops | corners | changes)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        leg = slice(a + 1, b + 1)
        if duration[leg].sum() <= 2.0 * RAMP and not (changes[a] or changes[b]):
            rests = stops[a] or stops[b]
            level[leg] = speed[leg].max() if rests else speed[leg] @ duration[leg] / max(duration[leg].sum(), 1e-9)
    return level


def _leave_ramps(speed: Array, duration: Array, stops: NDArray[np.bool_]) -> Array:
    """Return the speeds that are sent: next to a rest, the planned speed at the end of the ramp within `RAMP`.

    The planned speed must increase from row to row up to that row, and must not drop directly after it.
    """
    sent, at = speed.copy(), np.flatnonzero(stops)
    for a, b in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if b - a < 2:
            continue
        for way in (slice(a + 1, b + 1), slice(b, a, -1)):
            v, time = speed[way], np.cumsum(duration[way])
            near = v[: max(int(np.searchsorted(time, RAMP)), 1)]
            reached = int(np.argmax(near * REACHED >= near.max()))
            stays = reached == 0 or reached + 1 == len(v) or v[reached + 1] > REACHED * v[reached - 1]
            if stays and (np.diff(v[: reached + 1]) > 0.0).all():
                sent[way][:reached] = v[reached]
    return sent
