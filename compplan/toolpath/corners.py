"""Rounding of toolpath corners within a tolerance, so that the tool does not stop there.

A rounding superposes the end of the move before a corner C and the start of the move after it. It begins at the
distance a before C and ends at a after C. At the parameter u from 0 to 1,

    x(u) = p(-a (1 - u)^n) + p(a u^n) - C,

with p the path as a function of its length from the corner. n = 2 is a parabola between straight moves, which has the
least curvature. With n = 4 and u linear in time the tool decelerates and accelerates as in a smoothed motion
(`compplan.planning.timing`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.toolpath.toolpath import Toolpath, divide_toolpath

#: Least change of direction of a corner. [rad]
CORNER = float(np.radians(8.0))
#: Least ratio of the turn of a corner to the turns at its neighbours; distinguishes it from a sampled curve.
SHARPER = 3.0
#: Powers n of a rounding: at constant feed, and with deceleration.
KEPT, SLOWED = 2, 4
#: Points on a rounded corner, by its power; greatest share of the distance to the next corner that one may occupy.
ROUND_POINTS, SHARE = {KEPT: 7, SLOWED: 17}, 0.45
#: Share of the tolerance that is used next to an arc; least turn between the chords of an arc. [1, rad]
ARC_SHARE, BEND = 0.95, 1e-4
#: Greatest bulge of a leg of a corner, as a share of the allowed deviation at the corner.
ON_LINE = 0.1
#: Greatest distance of the commanded tip from the legs of a corner, in multiples of the allowed deviation there:
#: beyond it, the planned correction of the decelerating tool does not hold where a zone rounds the corner (assumed).
MAX_LEG_DISTANCE = 2.0


def round_corners(toolpath: Toolpath, tolerance: float, power: int = KEPT) -> Toolpath:
    """Round the corners of the cut within a tolerance of the path.

    A corner changes the direction by at least 8 deg and much more than its neighbours. The rounding of a corner of
    turn phi passes it at the distance 2 a sin(phi / 2) / 2^n. a is measured along the path; waypoints within it are
    replaced. The tool axis is rounded like the path. Points become denser towards the corner, so that interpolation
    does not overshoot. The tolerance is the greatest distance from the path [m], the power n KEPT or SLOWED.
    """
    corners, turn = find_corners(toolpath)
    if tolerance <= 0 or not len(corners):
        return toolpath
    along = np.r_[0.0, np.cumsum(toolpath.steps)]
    reach = _reach_corners(toolpath, corners, along, turn, 2.0 ** (power - 1) * tolerance / np.sin(0.5 * turn[corners]))
    grid = np.linspace(0.0, 1.0, ROUND_POINTS[power])
    before, behind = (1.0 - grid) ** power, grid**power
    places: list[Array] = []
    lengths = np.maximum.accumulate(along + 1e-15 * np.arange(len(along)))
    kept = np.ones(len(toolpath), bool)
    for i, a in zip(corners.tolist(), reach.tolist(), strict=True):
        near = np.arange(*np.searchsorted(along, [along[i] - a, along[i] + a]))
        kept[near[np.abs(along[near] - along[i]) < a * (1.0 - 1e-9)]] = False
        places.append(np.interp(along[i] + a * (behind - before), lengths, np.arange(len(along))))
        for side, end in ((-1, along[i - 1]), (1, along[i + 1])):
            count = max(math.ceil(math.log2(max(SHARE * abs(float(end - along[i])) / (1.6 * a), 1e-9))), 0)
            far = 1.6 * a * 2.0 ** np.arange(count)  # outwards from the end of the rounding, with doubled distances
            places.append(np.interp(along[i] + side * far, lengths, np.arange(len(along))))
    every = np.unique(np.concatenate([np.flatnonzero(kept), *places]))
    divided = divide_toolpath(toolpath, every)
    position, axis, moved = divided.position.copy(), divided.axis.copy(), np.zeros(len(every))
    for k, i in enumerate(corners.tolist()):
        own = np.searchsorted(every, places[3 * k])
        for values, old in ((position, toolpath.position), (axis, toolpath.axis)):
            sides = (along[i] - reach[k] * before, along[i] + reach[k] * behind)
            parts = (np.stack([np.interp(side, lengths, column) for column in old.T], axis=1) for side in sides)
            values[own] = sum(parts) - old[i]
        moved[own[1:-1]] = np.linalg.norm((position - divided.position)[own[1:-1]], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    found = "1 corner of the cut is" if len(corners) == 1 else f"{len(corners)} corners of the cut are"
    note = (f"{found} rounded, by {1e3 * float(moved.max()):.3g} mm at most, so that the tool does not stop there; "
            "feed.corner_tolerance_mm = 0 keeps them sharp.")  # fmt: skip
    arc = None if divided.arc is None else np.where((moved > 0.0) | (np.r_[0.0, moved[:-1]] > 0.0), 0, divided.arc)
    return replace(divided, position=position, axis=axis, rounded=moved, notes=(*divided.notes, note), arc=arc)


def _reach_corners(toolpath: Toolpath, corners: NDArray[np.int_], along: Array, turn: Array, wanted: Array) -> Array:
    """Return the length a of each rounding, limited by other corners, events and ends of cuts. Shape (k,) [m]."""
    rapid, n = toolpath.rapid, len(toolpath)
    fixed = np.zeros(n, bool)
    fixed[[0, -1]] = True
    fixed |= rapid | np.r_[rapid[1:], True]
    fixed[[event.place for event in toolpath.events if 0 <= event.place < n]] = True
    stops, marks = along[fixed], along[corners]
    every = np.unique(np.r_[stops, marks])
    at = np.searchsorted(every, marks)
    room = np.minimum(marks - every[np.maximum(at - 1, 0)], every[np.minimum(at + 1, len(every) - 1)] - marks)
    bends = along[(turn > BEND) & ~np.isin(np.arange(n), corners)]
    curved = np.searchsorted(bends, marks + wanted) > np.searchsorted(bends, marks - wanted, side="right")
    return np.asarray(np.minimum(np.where(curved, ARC_SHARE, 1.0) * wanted, SHARE * room))


def find_corners(toolpath: Toolpath) -> tuple[NDArray[np.int_], Array]:
    """Find the corners of the cut; also return the change of direction at every waypoint, shape (n,) [rad]."""
    steps = np.diff(toolpath.position, axis=0)
    length = np.linalg.norm(steps, axis=1, keepdims=True)
    travel = steps / np.maximum(length, 1e-12)
    turn = np.zeros(len(toolpath))
    turn[1:-1] = np.arccos(np.clip(np.einsum("ni,ni->n", travel[:-1], travel[1:]), -1.0, 1.0))
    cut = np.zeros(len(toolpath), bool)
    cut[1:-1] = ~toolpath.rapid[1:-1] & ~toolpath.rapid[2:]
    moves = np.minimum(length[:-1, 0], length[1:, 0])
    cut[1:-1] &= moves > 1e-9
    around = np.zeros(len(toolpath))
    around[1:-1] = np.minimum(turn[:-2], turn[2:])
    sharp = cut & (turn > CORNER) & (turn > SHARPER * around) & (turn < np.pi - CORNER)
    return np.flatnonzero(sharp), turn


def find_roundings(toolpath: Toolpath) -> list[tuple[int, int]]:
    """Return the first and last waypoint of every rounded corner."""
    if toolpath.rounded is None:
        return []
    edges = np.diff(np.r_[0, (toolpath.rounded > 0.0).astype(int), 0])
    return list(zip((np.flatnonzero(edges == 1) - 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def find_corner_shifts(toolpath: Toolpath, tip: Array, beside: Array) -> Array | None:
    """Return the vector from the middle waypoint of each rounding to its sharp corner, for programs with zones.

    Between straight moves the middle of a rounding lies on the line from the midpoint of its ends to the corner. A
    rounding is kept where a leg is curved, or the commanded tip (n, 3) [m] is too far from the legs. `beside` (n,) [m]
    is the greatest deviation of the zones of a program from the path. Shape (n, 3) [m]: 0 at other waypoints, nan at
    the other waypoints of a replaced rounding, which programs omit; None without such a corner.
    """
    x = toolpath.position
    shift, found = np.zeros_like(toolpath.position), False
    for first, last in find_roundings(toolpath):
        assert toolpath.rounded is not None
        middle = first + 1 + int(np.argmax(toolpath.rounded[first + 1 : last]))
        away = x[middle] - 0.5 * (x[first] + x[last])
        away *= toolpath.rounded[middle] / max(float(np.linalg.norm(away)), 1e-12)
        legs = x[middle] + away - x[[first, last]]
        steps = x[[first + 1, last - 1]] - x[[first, last]]
        reach, step = (np.linalg.norm(vectors, axis=1) for vectors in (legs, steps))
        cosine = (legs * steps).sum(axis=1) / np.maximum(reach * step, 1e-24)
        bulge = 0.25 * reach * np.arccos(np.clip(cosine, -1.0, 1.0))
        most = max(float(toolpath.rounded[middle]), float(beside[middle]))
        off = measure_leg_distance(tip[first : last + 1], tip[middle] + away)
        if (bulge <= ON_LINE * most).all() and off <= MAX_LEG_DISTANCE * most:
            shift[first + 1 : last], shift[middle], found = np.nan, away, True
    return shift if found else None


def measure_leg_distance(x: Array, corner: Array) -> float:
    """Return the greatest distance of points (k, 3) from the lines that join the first and last one to a corner [m]."""
    arms = x - corner
    off = []
    for leg in (arms[0], arms[-1]):
        share = np.clip(arms @ leg / max(float(leg @ leg), 1e-24), 0.0, 1.0)
        off.append(np.linalg.norm(arms - share[:, None] * leg, axis=1))
    return float(np.min(off, axis=0).max())


def compute_parameters(position: Array) -> tuple[Array, float]:
    """Compute the parameter u of waypoints on a rounding of power SLOWED, and the ratio of `a` to its length.

    Between straight moves |x'(u)| = 4 a |(1 - u)^3 t_1 + u^3 t_2|, t the directions of the moves. `position` holds the
    waypoints from first to last, shape (k, 3) [m]; u is from 0 to 1, shape (k,).
    """
    steps = np.diff(position, axis=0)
    length = np.linalg.norm(steps, axis=1)
    along = np.r_[0.0, np.cumsum(length)]
    cosine = float(steps[0] @ steps[-1] / max(length[0] * length[-1], 1e-24))
    u = np.linspace(0.0, 1.0, 201)
    rate = np.sqrt(np.maximum((1 - u) ** 6 + u**6 + 2 * cosine * ((1 - u) * u) ** 3, 1e-12))
    whole = np.r_[0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(u))]
    return np.interp(along / along[-1], whole / whole[-1], u), float(0.25 / whole[-1])
