"""Thin long paths for drawing: fewer rows, every peak kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

#: Rows this near to the worst one, as a share, are as good to split at.
NEARLY = 0.9


def thin_rows(signals: Array | Sequence[Array], limit: int) -> NDArray[np.int_]:
    """Choose the rows that draw signals faithfully: ends, and the smallest and largest value of each signal per bucket.

    Args:
        signals: One or more signals over the same rows; NaN is passed over. Shape (n,) each, or (n, k).
        limit: About how many rows to keep; never fewer than two rows a signal and the two ends.

    Returns:
        Ascending row numbers. Shape (at most limit + 2 + 2 k,).
    """
    columns = np.asarray(signals, float) if isinstance(signals, np.ndarray) else np.column_stack(list(signals))
    columns = columns.reshape(len(columns), -1)
    n, k = columns.shape
    if n <= limit:
        return np.arange(n)
    buckets = max(limit // (2 * k), 1)
    width = -(-n // buckets)
    padded = np.full((buckets * width, k), np.nan)
    padded[:n] = columns
    blocks = padded.reshape(buckets, width, k)
    start = (np.arange(buckets) * width)[:, None]
    low = np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1) + start
    high = np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1) + start
    rows = np.unique(np.concatenate([[0, n - 1], low.ravel(), high.ravel()]))
    return rows[rows < n]


def thin_path(position: Array, signals: Array | Sequence[Array], limit: int) -> NDArray[np.int_]:
    """Choose the rows that draw a path in space and the signals along it.

    Args:
        position: Points of the path. Shape (n, 3). [any length]
        signals: As for `thin_rows`.
        limit: About how many rows to keep; a third of them evenly along the path.
    """
    n = len(position)
    if n <= limit:
        return np.arange(n)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    even = np.searchsorted(length, np.linspace(0, length[-1], limit // 3))
    return np.unique(np.concatenate([np.clip(even, 0, n - 1), thin_rows(signals, limit - limit // 3)]))


def simplify_path(points: Array, slack: float, limit: int) -> NDArray[np.int_]:
    """Choose the rows whose straight joins pass every other row within a slack, at the same path length.

    From both ends on, every stretch is split at its worst row until none is worse than the slack [Douglas, Peucker
    1973], the distance taken at the same path length, so that a signal beside the place is drawn as faithfully. Of
    rows that are nearly the worst the middle one is taken: passes of a raster are halved, not cut off one by one.

    Args:
        points: Place in the first three columns, signals scaled to it in further ones. Shape (n, 3 + k). [m]
        slack: [m]
        limit: How many rows to choose at most; the worst are split first.

    Returns:
        Ascending row numbers, both ends among them.
    """
    n = len(points)
    if n < 3:
        return np.arange(n)
    steps = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps + 1e-12)])
    kept, first, last = [np.array([0, n - 1])], np.array([0]), np.array([n - 1])
    room = limit - 2
    while room > 0 and len(first):
        stretch = np.repeat(np.arange(len(first)), last - first)  # its rows but the last one
        start = np.cumsum(last - first) - (last - first)
        rows = first[stretch] + np.arange(len(stretch)) - start[stretch]
        begin, end = first[stretch], last[stretch]
        share = (length[rows] - length[begin]) / (length[end] - length[begin])
        away = np.linalg.norm(points[rows] - points[begin] - share[:, None] * (points[end] - points[begin]), axis=1)
        worst = np.maximum.reduceat(away, start)
        split = np.argsort(-worst, kind="stable")[: min(room, int((worst > slack).sum()))]
        hits = np.flatnonzero(away >= NEARLY * worst[stretch])
        low, high = (np.searchsorted(stretch[hits], split, side) for side in ("left", "right"))
        at = rows[hits[(low + high) // 2]]
        kept.append(at)
        room -= len(at)
        first, last = np.concatenate([first[split], at]), np.concatenate([at, last[split]])
    return np.sort(np.concatenate(kept))
