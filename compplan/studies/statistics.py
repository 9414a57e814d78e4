"""Figures of a study with intervals that hold: means from replicates, quantiles from order statistics.

Points of one scrambled sequence depend on each other, the replicates do not: the interval of a mean is Student's t on
the means of the replicates [Owen1995]. Intervals of quantiles and shares are those of independent samples, which are
too wide rather than too narrow for spread-out points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import beta, binom, t

from compplan.robot import Array

#: Share of intervals that hold.
LEVEL = 0.95


class Interval(NamedTuple):
    """An estimate and its interval."""

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def estimate_mean(values: Array, replicates: int) -> Interval:
    """Estimate a mean from replicated samples, shape (samples,); sample i belongs to replicate i % replicates."""
    means = np.array([values[k::replicates].mean() for k in range(replicates)])
    centre = float(means.mean())
    half = float(t.ppf(0.5 + 0.5 * LEVEL, replicates - 1) * means.std(ddof=1) / np.sqrt(replicates))
    return Interval(centre, centre - half, centre + half)


def estimate_quantile(values: Array, share: float) -> Interval:
    """Estimate a quantile; the interval lies between order statistics, whatever the distribution."""
    ordered, n = np.sort(values), len(values)
    low = int(binom.ppf(0.5 - 0.5 * LEVEL, n, share)) - 1
    high = int(binom.ppf(0.5 + 0.5 * LEVEL, n, share))
    return Interval(float(np.quantile(ordered, share)), float(ordered[max(low, 0)]), float(ordered[min(high, n - 1)]))


def estimate_share(hits: int, n: int) -> Interval:
    """Estimate a probability from hits among n [Clopper1934]."""
    tail = 0.5 - 0.5 * LEVEL
    low = float(beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return Interval(hits / n, low, high)


def trace_convergence(values: Array, replicates: int) -> list[tuple[int, Interval]]:
    """Trace how the interval of a mean narrows with the number of samples."""
    first = 4 * replicates
    if len(values) <= first:
        return [(len(values), estimate_mean(values, replicates))]
    counts = np.unique((np.geomspace(first, len(values), 24) // replicates * replicates).astype(int))
    return [(int(n), estimate_mean(values[:n], replicates)) for n in counts]
