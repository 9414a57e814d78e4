"""How a gap spreads over runs, time, load, direction and region: sums of squares over parts of the rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, LISTED
from compplan.diagnosis.results.shares import Share, find_interval
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

#: Decimals to which rows are dealt to regions and levels: micrometres and micronewtons, far above rounding (theory).
RESOLVED = 6


class GapTable:
    """Sums of squared deviation over parts of the rows, with intervals over drawn blocks.

    Args:
        before: Measured minus expected by the nominal robot. Shape (n, 3). [m]
        after: The same by the updated robot. Shape (n, 3). [m]
        block: Group of poses of each row, counted from 0. Shape (n,).
        draws: How often each draw holds each group. Shape (draws, groups).
    """

    def __init__(self, before: Array, after: Array, block: NDArray[np.int_], draws: Array) -> None:
        self.deviation, self.block, self.draws = before, block, draws
        self.size, self.left = (before**2).sum(1), (after**2).sum(1)

    def of(self, square: Array) -> Share:
        """Share of squares, one a row, of the whole."""
        count = self.draws.shape[1]
        parts, whole = (np.bincount(self.block, values, count).astype(float) for values in (square, self.size))
        drawn = (self.draws @ parts) / np.maximum(self.draws @ whole, 1e-300)
        return find_interval(float(parts.sum()) / max(float(whole.sum()), 1e-300), drawn)

    def along(self, direction: Array) -> Share:
        """Share along a direction, fixed or one a row."""
        return self.of((self.deviation * direction).sum(1) ** 2)

    def describe(self, inside: NDArray[np.bool_]) -> dict[str, Any]:
        """Describe part of the rows: how many, rms before and after, share of all squares, mean deviation."""
        before, after = (1e3 * float(np.sqrt(size[inside].mean())) for size in (self.size, self.left))
        mean = 1e3 * self.deviation[inside].mean(axis=0)
        entry = {"rows": int(inside.sum()), "rms_mm": round(before, 6), "after_rms_mm": round(after, 6)}
        return {**entry, **self.of(self.size * inside).to_json(), "mean_mm": [round(float(value), 6) for value in mean]}


def split_runs(table: GapTable, run: NDArray[np.str_]) -> dict[str, dict[str, Any]]:
    """Split the rows by run."""
    return {str(name): table.describe(run == name) for name in dict.fromkeys(run.tolist())}


def split_time(table: GapTable, campaign: Campaign, rows: NDArray[np.int_]) -> list[dict[str, Any]]:
    """Split the log into some stretches with equally many rows."""
    count = min(LISTED, max(len(rows) // ENOUGH_ROWS, 1))
    stretch = np.arange(len(rows)) * count // len(rows)
    entries = []
    for number in range(count):
        inside = stretch == number
        entry: dict[str, Any] = {"rows_from": int(rows[inside][0]), "rows_to": int(rows[inside][-1])}
        if campaign.time is not None:
            entry["time_s"] = [round(float(campaign.time[row]), 3) for row in rows[inside][[0, -1]]]
        entries.append({**entry, **table.describe(inside)})
    return entries


def split_load(table: GapTable, campaign: Campaign, rows: NDArray[np.int_]) -> list[dict[str, Any]]:
    """Split the rows into unloaded ones and three levels of force."""
    force = np.linalg.norm(np.nan_to_num(campaign.wrench[rows, :3]), axis=1).round(RESOLVED)
    loaded = ~campaign.unloaded[rows]
    level = np.zeros(len(rows), int)
    if loaded.any():
        edges = np.unique(np.quantile(force[loaded], np.arange(1, 3) / 3))
        level[loaded] = 1 + np.searchsorted(edges, force[loaded])
    entries = []
    for number in np.unique(level):
        inside = level == number
        if inside.sum() >= FEW_ROWS:
            reach = [round(float(force[inside].min()), 1), round(float(force[inside].max()), 1)]
            entries.append({"force_N": reach, **table.describe(inside)})
    return entries


def split_region(table: GapTable, position: Array) -> list[dict[str, Any]]:
    """Split the workspace by reach from the base axis and by height, three parts each."""
    parts = []
    for values in (np.hypot(position[:, 0], position[:, 1]).round(RESOLVED), position[:, 2].round(RESOLVED)):
        edges = np.quantile(values, np.arange(4) / 3)
        parts.append((np.clip(np.searchsorted(edges[1:-1], values, side="right"), 0, 2), edges))
    (ring, ring_edges), (layer, layer_edges) = parts
    entries = []
    for i in range(3):
        for j in range(3):
            inside = (ring == i) & (layer == j)
            if inside.sum() >= FEW_ROWS:
                limits = {
                    "reach_mm": [round(1e3 * float(value), 1) for value in ring_edges[i : i + 2]],
                    "height_mm": [round(1e3 * float(value), 1) for value in layer_edges[j : j + 2]],
                }
                entries.append({**limits, **table.describe(inside)})
    return entries
