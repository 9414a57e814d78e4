"""How a campaign is run and what its log says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.campaigns.description import Array


@dataclass(frozen=True)
class Visits:
    """How a campaign is run and what its log says.

    Args:
        design: "plain" (no load), "weights" (dead weights), "rich" (loads of all directions, paths) or "many" (100-500
            poses).
        stays: Poses approached in every static run. Shape (n_runs,).
        weights_kg: Dead weight of every static run, 0 for none; None where forces have any direction.
        hang: Where weights hang, TCP frame. Shape (3,). [m]
        paths: Number of path runs.
        again: Share of stays that go back to an earlier pose, not the last one.
        pace: Typical seconds between readings. [s]
        warm_up: Rise [K], two time constants [s], share of the first, wander [K] and its period [s].
        start_rise: Temperature above the reference when the campaign begins. [K]
        region: Share of the joint ranges covered, around a drawn posture.
        outliers: Share of rows that are gross outliers.
        missing: Share of measured fields that are empty.
        tracker: Where the instrument stands, base frame. Shape (3,). [m]
        noise: Standard deviation per axis of the instrument: constant part [m] and part per metre of distance.
        force_noise: Standard deviation of the force sensor [N]; moments a tenth [N m].
        orientation, link_encoders, temperature, time, sigma_column, si_units: Columns and units of the log.
    """

    design: str
    stays: tuple[int, ...]
    weights_kg: tuple[float, ...] | None
    hang: tuple[float, float, float]
    paths: int
    again: float
    pace: float
    warm_up: tuple[float, float, float, float, float, float]
    region: float
    outliers: float
    missing: float
    tracker: tuple[float, float, float]
    noise: tuple[float, float]
    force_noise: float
    start_rise: float = 0.0
    orientation: bool = False
    link_encoders: bool = False
    temperature: bool = False
    time: bool = False
    sigma_column: bool = False
    si_units: bool = False

    @property
    def loaded(self) -> bool:
        """Tell whether the log has wrench columns."""
        return self.weights_kg is None or any(self.weights_kg)

    def sigma(self, position: Array) -> Array:
        """Return the instrument's standard deviation per axis at TCP positions. Shape (n,). [m]"""
        distance = np.linalg.norm(position - np.array(self.tracker), axis=1)
        return np.asarray(self.noise[0] + self.noise[1] * distance)
