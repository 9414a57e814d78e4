"""Where a gap lies: by place and by what it follows, and over the rows.

By place and factor: `shares`. By direction, run and region: how much of the sum of squares lies there,
before and after. Intervals hold 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import FEW_ROWS, SAMPLE, SEED
from compplan.diagnosis.results.shares import (
    UNEXPLAINED,
    Share,
    Shares,
    SmallErrors,
    divide_gap,
    draw_blocks,
    find_interval,
)
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis

#: Decimals to which rows are dealt to regions and levels: micrometres and micronewtons, far above rounding (theory).
RESOLVED = 6


@dataclass(frozen=True, eq=False)
class Division:
    """How a gap spreads over the rows: rms of the nominal model [m], by axis, and by run and region."""

    rms: float
    by_axis: dict[str, Share]
    by_run: dict[str, dict[str, Any]]
    by_region: list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Split:
    """Where a gap lies."""

    shares: Shares  #: Shares of places and factors.
    spread: Division  #: How the gap spreads over the rows.
    #: The gap divided among the errors of the robot that goes out; None where the nominal one does.
    small_errors: SmallErrors | None = None

    @property
    def by_joint(self) -> dict[str, Share]:
        """Share of each place: joints, other parts of the cell, small errors everywhere, not explained."""
        return self.shares.by_place

    def to_json(self) -> dict[str, Any]:
        """Return what stands under `where` in diagnosis.json."""
        shares, spread = self.shares, self.spread
        calibrated = {} if self.small_errors is None else {"calibrated": self.small_errors.to_json()}
        return {
            **calibrated,
            "rms_mm": 1e3 * spread.rms,
            "by_joint": {name: share.to_json() for name, share in shares.by_place.items()},
            "by_factor": {name: share.to_json() for name, share in shares.by_factor.items()},
            "noise_share": shares.noise,
            "unexplained_share": shares.by_place[UNEXPLAINED].share,
            "by_axis": {name: share.to_json() for name, share in spread.by_axis.items()},
            "by_run": spread.by_run,
            "by_region": spread.by_region,
        }


def split_diagnosis(diagnosis: Diagnosis, seed: int = SEED) -> Split:
    """Split the gap of a diagnosis: what its nominal robot leaves, outliers left out."""
    campaign = diagnosis.fit.problem.campaign
    before, after = diagnosis.residual_before, diagnosis.residual_after
    used = campaign.usable & np.isfinite(before).all(1) & np.isfinite(after).all(1)
    used[diagnosis.outliers] = False
    shares, small = divide_gap(diagnosis, seed)
    return Split(shares, spread_gap(diagnosis.robot, campaign, before, after, used, seed), small)


def spread_gap(
    robot: Robot, campaign: Campaign, before: Array, after: Array, used: NDArray[np.bool_], seed: int = SEED
) -> Division:
    """Spread a gap over direction, runs and region; shapes (n, 3) [m], (n, 3), (n,)."""
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(used)
    rows = rows[:: -(-len(rows) // SAMPLE)]
    _, block = np.unique(draw_blocks(campaign, rng)[rows], return_inverse=True)
    count = int(block.max(initial=0)) + 1
    draws = rng.multinomial(count, np.full(count, 1.0 / count), size=SAMPLE).astype(float)
    table = GapTable(before[rows], after[rows], block, draws)
    frames = locate_frames(build_chain(robot), campaign.q[rows])
    run = campaign.run[rows]
    by_axis = {axis: table.along(np.eye(3)[k]) for k, axis in enumerate("xyz")}
    return Division(
        rms=float(np.sqrt(table.size.mean())),
        by_axis={**by_axis, "tool_z": table.along(frames.tcp_rotation[:, :, 2])},
        by_run={str(name): table.describe(run == name) for name in dict.fromkeys(run.tolist())},
        by_region=split_region(table, frames.tcp_position),
    )


class GapTable:
    """Sums of squared deviation over parts of the rows, with intervals over drawn blocks.

    `block` is the group of poses of each row, `draws` how often each draw holds each group. Shapes (n,), (draws,
    groups).
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
