"""Location of a gap: by place, by driver, and over the rows.

By place and factor: `shares`, with 95 % intervals. By direction, run and region: share of the sum of squares, before
and after.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import FEW_ROWS, SEED
from compplan.diagnosis.results.shares import UNEXPLAINED, Share, Shares, SmallErrors, divide_gap
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis

#: Decimals for the division of rows into regions and levels: micrometres and micronewtons, far above rounding (theory).
RESOLVED = 6


@dataclass(frozen=True, eq=False)
class Split:
    """Location of a gap."""

    shares: Shares  #: Shares of places and factors.
    spread: dict[str, Any]  #: Distribution of the gap over the rows, in the format of diagnosis.json.
    #: The gap divided among the errors of the delivered robot; None for the nominal one.
    small_errors: SmallErrors | None = None

    @property
    def by_joint(self) -> dict[str, Share]:
        """Share of each place: joints, other parts of the cell, small errors everywhere, not explained."""
        return self.shares.by_place

    def to_json(self) -> dict[str, Any]:
        """Return the content of `where` in diagnosis.json."""
        shares = self.shares
        calibrated = {} if self.small_errors is None else {"calibrated": self.small_errors.to_json()}
        return {
            **calibrated,
            "by_joint": {name: share.to_json() for name, share in shares.by_place.items()},
            "by_factor": {name: share.to_json() for name, share in shares.by_factor.items()},
            "noise_share": shares.noise,
            "unexplained_share": shares.by_place[UNEXPLAINED].share,
            **self.spread,
        }


def split_diagnosis(diagnosis: Diagnosis, seed: int = SEED) -> Split:
    """Split the gap of the nominal robot of a diagnosis, without outliers."""
    campaign = diagnosis.fit.problem.campaign
    before, after = diagnosis.residual_before, diagnosis.residual_after
    used = campaign.usable & np.isfinite(before).all(1) & np.isfinite(after).all(1)
    used[diagnosis.outliers] = False
    shares, small = divide_gap(diagnosis, seed)
    return Split(shares, spread_gap(diagnosis.robot, campaign, before, after, used), small)


def spread_gap(
    robot: Robot, campaign: Campaign, before: Array, after: Array, used: NDArray[np.bool_]
) -> dict[str, Any]:
    """Divide a gap by direction, run and region, in the format of diagnosis.json; shapes (n, 3) [m], (n, 3), (n,)."""
    gap, size, left = before[used], np.sum(before[used] ** 2, axis=1), np.sum(after[used] ** 2, axis=1)
    frames = locate_frames(build_chain(robot), campaign.q[used])
    run, place = campaign.run[used], frames.tcp_position
    directions = {axis: np.eye(3)[k] for k, axis in enumerate("xyz")} | {"tool_z": frames.tcp_rotation[:, :, 2]}

    def share_of(square: Array) -> float:
        return round(float(square.sum() / max(size.sum(), 1e-300)), 4)

    def describe(inside: NDArray[np.bool_]) -> dict[str, Any]:
        rms, after_rms = (round(1e3 * float(np.sqrt(square[inside].mean())), 6) for square in (size, left))
        mean = [round(1e3 * float(value), 6) for value in gap[inside].mean(axis=0)]
        found = {"rows": int(inside.sum()), "rms_mm": rms, "after_rms_mm": after_rms}
        return {**found, "share": share_of(size[inside]), "mean_mm": mean}

    (ring, reach), (layer, height) = (cut_in_three(v) for v in (np.hypot(place[:, 0], place[:, 1]), place[:, 2]))
    regions = [(i, j, (ring == i) & (layer == j)) for i in range(3) for j in range(3)]
    return {
        "rms_mm": 1e3 * float(np.sqrt(size.mean())),
        "by_axis": {name: {"share": share_of((gap * d).sum(axis=1) ** 2)} for name, d in directions.items()},
        "by_run": {str(name): describe(run == name) for name in dict.fromkeys(run.tolist())},
        "by_region": [
            {"reach_mm": reach[i : i + 2], "height_mm": height[j : j + 2], **describe(inside)}
            for i, j, inside in regions if inside.sum() >= FEW_ROWS
        ],
    }  # fmt: skip


def cut_in_three(values: Array) -> tuple[NDArray[np.int_], list[float]]:
    """Divide lengths into three parts of equal count; return the part of each, and the four limits. [mm]"""
    rounded = values.round(RESOLVED)
    edges = np.quantile(rounded, np.arange(4) / 3)
    part = np.searchsorted(edges[1:-1], rounded, side="right")
    return part, [round(1e3 * float(edge), 1) for edge in edges]
