"""Corners of a toolpath, rounded by parabolas within a tolerance, so that the feed need not drop to nothing there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.files.tables import Array
from compplan.path.toolpath import Toolpath, divide_toolpath

#: Turns of the travel below this are no corners. [rad]
CORNER = float(np.radians(8.0))
#: A corner turns this much more than its neighbours; a sampled curve does not.
SHARPER = 3.0
#: Points on a rounded corner; share of a move that its roundings may take at either end.
ROUND_POINTS, SHARE = 7, 0.45


def round_corners(toolpath: Toolpath, tolerance: float) -> Toolpath:
    """Round the corners of the cut by parabolas that stay within a tolerance of the path.

    A corner turns the travel by more than a few degrees and much more than its neighbours do. A parabola from a before
    to a after a corner of turn phi passes it at a sin(phi / 2) / 2. The tool axis turns along a parabola too. Points
    crowd towards the corner, so that interpolation between them does not swing out.

    Args:
        toolpath: The toolpath.
        tolerance: Greatest distance from the path. [m]

    """
    corners, turn = find_corners(toolpath)
    if tolerance <= 0 or not len(corners):
        return toolpath
    steps, position = toolpath.steps, toolpath.position
    room = SHARE * np.minimum(steps[corners - 1], steps[corners])
    reach = np.minimum(2 * tolerance / np.sin(0.5 * turn[corners]), room)
    places: list[float] = []
    shifts: list[Array] = []
    leans: list[Array] = []
    marked = dict(zip(corners.tolist(), reach.tolist(), strict=True))
    for i in range(len(toolpath)):
        if i not in marked:
            places.append(float(i))
            shifts.append(np.zeros(3))
            leans.append(np.zeros(3))
            continue
        a, before, after = marked[i], steps[i - 1], steps[i]
        arrive = (position[i] - position[i - 1]) / before
        leave = (position[i + 1] - position[i]) / after
        for away in _crowd(a, SHARE * before)[::-1]:
            places.append(i - away / before)
            shifts.append(np.zeros(3))
            leans.append(np.zeros(3))
        for t in np.linspace(0.0, 1.0, ROUND_POINTS):
            curve = -a * (1 - t) ** 2 * arrive + a * t**2 * leave
            on_path = -a * (1 - 2 * t) * arrive if t <= 0.5 else a * (2 * t - 1) * leave
            places.append(i - a * (1 - 2 * t) / before if t <= 0.5 else i + a * (2 * t - 1) / after)
            shifts.append(curve - on_path)
            tilt = (toolpath.axis[i] - toolpath.axis[i - 1]) / before, (toolpath.axis[i + 1] - toolpath.axis[i]) / after
            bent = -a * (1 - t) ** 2 * tilt[0] + a * t**2 * tilt[1]
            leans.append(bent - (-a * (1 - 2 * t) * tilt[0] if t <= 0.5 else a * (2 * t - 1) * tilt[1]))
        for away in _crowd(a, SHARE * after):
            places.append(i + away / after)
            shifts.append(np.zeros(3))
            leans.append(np.zeros(3))
    divided = divide_toolpath(toolpath, np.array(places))
    axis = divided.axis + np.array(leans)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return replace(divided, position=divided.position + np.array(shifts), axis=axis)


def find_corners(toolpath: Toolpath) -> tuple[NDArray[np.int_], Array]:
    """Find the corners of the cut; also return the turn of the travel at every waypoint, shape (n,) [rad]."""
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


def _crowd(nearest: float, farthest: float) -> list[float]:
    """Return distances from just beyond a rounding outwards, each twice the one before."""
    distances, distance = [], 1.6 * nearest
    while distance < farthest:
        distances.append(distance)
        distance *= 2.0
    return distances
