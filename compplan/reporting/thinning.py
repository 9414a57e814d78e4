"""Thin long paths for drawing: fewer rows, every peak kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array


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
