"""Repeats: test whether repeated poses scatter beyond a stated sigma, and whether they creep.

With residuals r_i of the updated robot at poses repeated under the same load, and stated sigma_i,

    sum |r_i - mean of its pose|^2 / sigma_i^2 ~ chi-square of 3 (rows - poses)

if they scatter by the instrument alone. Creep and settling grow within a stay: along the motion of one joint, in the
direction of its last move or of its load, times log(1 + t / s), t the time since the first row of the stay.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, stdtrit

from compplan.diagnosis.data.noise import group_repeats
from compplan.effects.linearization import Linearization
from compplan.robot import Array

#: Level of both tests (theory: one campaign in a hundred by chance).
CHANCE = 0.01


@dataclass(frozen=True)
class RepeatCheck:
    """Scatter of repeats beyond the stated sigma."""

    times_sigma: float  #: Scatter over the stated sigma.
    chance: float  #: The ratio that noise alone exceeds in one campaign in a hundred.
    values: int  #: Degrees of freedom.
    joint: str | None = None  #: Joint whose motion the scatter follows with the time of the stay, or None.
    driver: str | None = None  #: "direction of approach" or "load": determines the sign of that motion.
    correlation: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the check in the format of diagnosis.json."""
        return {key: round(v, 3) if isinstance(v, float) else v for key, v in asdict(self).items()}

    @property
    def sentence(self) -> str:
        """Description in one sentence."""
        text = f"scatter by {self.times_sigma:.2g} times the stated sigma (chance: up to {self.chance:.2g})"
        if self.joint is None:
            return text
        return f"{text} and creep within a stay, along {self.joint} with its {self.driver} (r {self.correlation:.2f})"


def check_repeats(at: Linearization, residual: Array) -> RepeatCheck | None:
    """Compare repeats with the stated sigma; `residual`: measured minus predicted, NaN where unused. (n, 3) [m]"""
    campaign = at.campaign
    if campaign.sigma is None:
        return None
    stated = np.isfinite(residual).all(axis=1) & (np.nan_to_num(campaign.sigma) > 0)
    rows = np.flatnonzero(stated & campaign.measured & ~campaign.on_path)
    sigma = campaign.sigma[rows, None]
    scatter, freedom = _centre(residual[rows] / sigma, group_repeats(campaign, rows))
    if freedom < 2:
        return None
    ratio, chance = np.sqrt(np.sum(scatter**2) / freedom), np.sqrt(chdtri(freedom, CHANCE) / freedom)
    if ratio <= chance:
        return None
    found, stay = RepeatCheck(float(ratio), float(chance), freedom), campaign.stay[rows]
    scatter, freedom = _centre(residual[rows] / sigma, stay)
    if campaign.time is None or freedom < 2:
        return found
    start = campaign.time[np.unique(campaign.stay, return_index=True)[1]][stay]
    since = np.log1p(np.maximum(campaign.time[rows] - start, 0.0))[:, None]
    tried = []
    for index, joint in enumerate(at.robot.joint_names):
        for driver, sign in (("direction of approach", campaign.approach), ("load", at.own_load)):
            moved = np.nan_to_num(since * sign[rows, index, None] * at.motion[rows, :3, index])
            moved = _centre(moved / sigma, stay)[0]
            size = float(np.sqrt(np.sum(moved**2) * np.sum(scatter**2)))
            tried.append((float(np.sum(moved * scatter)) / max(size, 1e-300), joint, driver))
    correlation, joint, driver = max(tried, key=lambda one: abs(one[0]))
    t = stdtrit(freedom - 1, 1.0 - 0.5 * CHANCE / len(tried))
    if abs(correlation) * np.sqrt(freedom - 1) <= t * np.sqrt(1.0 - correlation**2):
        return found
    return replace(found, joint=joint, driver=driver, correlation=correlation)


def _centre(values: Array, group: NDArray[np.int_]) -> tuple[Array, int]:
    """Subtract the mean of each group from values (r, 3); also return the remaining degrees of freedom."""
    _, index, count = np.unique(group, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(index, values[:, k]) / count for k in range(3)], axis=1)
    return np.asarray(values - means[index]), 3 * (len(values) - len(count))
