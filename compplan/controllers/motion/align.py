"""Alignment of log rows with a program: position along the path and distance from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.motion.geometry import Path
from compplan.robot import Array

#: Rows that are placed at once, and search margin around their expected position. [m]
BLOCK, MARGIN = 12, 0.012
#: Distance from the path above which a block is lost. [m]
LOST = 0.02
#: Distance penalty per metre from the expected position. [m/m]
PULL = 0.15
#: Fewest candidate starts along the path, and greatest distance between two. [m]
PLACES, SPACING = 4000, 0.005
#: Rows of a log's head that are compared there, and its length: blends cut corners, so a longer head drifts. [m]
HELD, HEAD = 160, 0.5
#: Candidates that are tried by placing the head's rows: greatest number, allowed excess over the best cost, and least
#: distance between two. [m]
MOST_TRIED, WORSE, APART = 300, 0.005, 0.05
#: Pieces to either side in the search for the nearest point.
SIDE = 6


def place_rows(path: Path, tip: Array, way: Array) -> tuple[Array, Array]:
    """Find every row of a log on the programmed path, in order, block by block.

    The distance moved by the tip so far limits the search, so that repeated passes of the same place are distinguished.
    Tips of the rows have shape (n, 3), the distance moved up to each (n,). [m]

    Returns:
        Length along the path, shape (n,), and nearest point of the path, shape (n, 3). [m]
    """
    s = _follow_rows(path, tip, way, find_start(path, tip, way))
    index = np.searchsorted(path.s, s)
    point, share = find_nearest(path.position, index, tip, SIDE)
    return np.interp(share, np.arange(len(path.s)), path.s), point


def _follow_rows(path: Path, tip: Array, way: Array, here: float) -> Array:
    """Return the path length of the point nearest to each row, the first near `here`. Shape (n,). [m]"""
    s = np.empty(len(tip))
    for first in range(0, len(tip), BLOCK):
        rows = slice(first, first + BLOCK)
        expected = np.clip(here + way[rows] - way[first - 1 if first else 0], path.s[0], path.s[-1])
        margin = MARGIN + 0.1 * (expected[-1] - expected[0])
        low = int(np.searchsorted(path.s, expected[0] - margin))
        high = int(np.searchsorted(path.s, expected[-1] + margin)) + 1
        points = path.position[low:high]
        cost = ((tip[rows, None] - points) ** 2).sum(axis=2) + (PULL * (path.s[low:high] - expected[:, None])) ** 2
        s[rows] = path.s[low + cost.argmin(axis=1)]
        if np.sqrt(cost.min(axis=1).min()) > LOST:  # the distance moved leads nowhere near: search the complete path
            s[rows] = path.s[((tip[rows, None] - path.position[::4]) ** 2).sum(axis=2).argmin(axis=1) * 4]
        here = float(s[min(first + BLOCK, len(tip)) - 1])
    return s


def find_start(path: Path, tip: Array, way: Array) -> float:
    """Return the path length at which a log begins: where the rows of its head are nearest to the path. [m]

    The distance moved selects candidates; nearly equal layers are distinguished by placing the head's rows.
    """
    head = slice(0, int(np.searchsorted(way, way[0] + HEAD, "right")))
    rows = np.unique(np.searchsorted(way, np.linspace(way[0], way[head][-1], HELD)).clip(0, len(way) - 1))
    count = max(PLACES, int(np.ceil(path.s[-1] / SPACING)))
    starts = np.linspace(path.s[0], path.s[-1], count)
    cost = _score_starts(path, tip, way, rows, starts)
    tried: list[float] = []
    for k in np.argsort(cost, kind="stable"):
        if cost[k] > cost.min() + WORSE or len(tried) == MOST_TRIED:
            break
        if not tried or np.abs(np.array(tried) - starts[k]).min() > APART:
            tried.append(float(starts[k]))
    found = np.array([_nearest_around(path, tip[0], start) for start in sorted(tried)])
    left = []
    for start in found:
        near = find_nearest(path.position, np.searchsorted(path.s, _follow_rows(path, tip[head], way[head], start)),
                            tip[head], SIDE)[0]  # fmt: skip
        over = max(0.0, start + way[-1] - way[0] - path.s[-1])
        left.append(round(float(np.median(np.linalg.norm(tip[head] - near, axis=1))) + 1e-3 * over, 6))
    return float(found[int(np.argmin(left))])


def _nearest_around(path: Path, tip: Array, start: float) -> float:
    """Return the path length of the point nearest to a tip, close to a start. [m]"""
    low, high = np.searchsorted(path.s, [start - APART, start + APART])
    away = ((path.position[low : high + 1] - tip) ** 2).sum(axis=1)
    return float(path.s[low + (away + (PULL * (path.s[low : high + 1] - start)) ** 2).argmin()])


def _score_starts(path: Path, tip: Array, way: Array, rows: NDArray[np.int_], starts: Array) -> Array:
    """Return the mean distance of rows from a path that begins at each start. Shape (k,). [m]"""
    cost = np.zeros(len(starts))
    for row in rows:  # about 160, for any length of the log
        place = np.clip(starts + way[row] - way[0], path.s[0], path.s[-1])
        at = np.searchsorted(path.s, place).clip(0, len(path.s) - 1)
        cost += np.minimum(np.linalg.norm(path.position[at] - tip[row], axis=1), 1.0)
        cost += 1e-3 * np.maximum(starts + way[-1] - way[0] - path.s[-1], 0.0)
    return cost / len(rows)


def find_nearest(points: Array, index: NDArray[np.int_], tip: Array, side: int) -> tuple[Array, Array]:
    """Return the nearest point of a polyline to each row, and its position, counted in points.

    `index` is a point near each row, `side` the number of pieces to either side in the search. Shapes (m, 3), (n,),
    (n, 3). [m]
    """
    best = np.full(len(tip), np.inf)
    nearest, share = np.empty_like(tip), np.empty(len(tip))
    for k in range(-side, side):
        i = np.clip(index + k, 0, len(points) - 2)
        edge = points[i + 1] - points[i]
        size = np.maximum((edge**2).sum(axis=1), 1e-24)
        u = np.clip(((tip - points[i]) * edge).sum(axis=1) / size, 0.0, 1.0)
        point = points[i] + u[:, None] * edge
        away = ((tip - point) ** 2).sum(axis=1)
        nearer = away < best
        best[nearer], nearest[nearer], share[nearer] = away[nearer], point[nearer], (i + u)[nearer]
    return nearest, share


def measure_way(time: Array, tip: Array, span: float = 0.05) -> Array:
    """Return the distance moved by a tip, averaged over a time so that noise at rest does not count. Shape (n,). [m]"""
    width = max(1, round(span / float(np.median(np.diff(time)))))
    total = np.cumsum(np.vstack([np.zeros((1, 3)), tip]), axis=0)
    low, high = np.maximum(np.arange(len(tip)) - width, 0), np.minimum(np.arange(len(tip)) + width + 1, len(tip))
    smooth = (total[high] - total[low]) / (high - low)[:, None]
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))]
