"""Sensitivity analysis: total Sobol indices of the rms deviation of each strategy, by group of factors.

A total index is the share of the variance that would remain if all other groups were known [Homma1996]; SciPy computes
points and estimates [Saltelli2010]. The path is thinned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap, qmc, sobol_indices

from compplan.robot import Array
from compplan.studies.runner import evaluate_chunks
from compplan.studies.study import Study, thin_study
from compplan.studies.workers import Workers

#: Greatest number of waypoints.
WAYPOINTS = 300
#: Base points of the design; the number of samples is (groups + 2) times as large.
BASE = 128
#: Bootstrap resamples of the base points for an interval.
RESAMPLES = 200


@dataclass(frozen=True)
class Sensitivity:
    """Total Sobol indices."""

    groups: tuple[str, ...]  #: Names of the groups.
    total: dict[str, Array]  #: Total index of each group, by strategy. Shape (groups,) each.
    half_width: dict[str, Array]  #: Half width of the 95 % interval (bootstrap), by strategy. Shape (groups,) each.
    samples: int  #: Number of samples.
    waypoints: int  #: Number of waypoints.

    def describe(self, strategy: str) -> dict[str, dict[str, float]]:
        """Return index and half interval of every group for a strategy."""
        found = zip(self.groups, self.total[strategy], self.half_width[strategy], strict=True)
        return {group: {"total": float(total), "half_width95": float(half)} for group, total, half in found}


def measure_sensitivity(
    study: Study,
    seed: int,
    *,
    base: int = BASE,
    folder: Path | None = None,
    workforce: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sensitivity | None:
    """Estimate total Sobol indices by group; None for fewer than two groups. base: base points, a power of two."""
    thin = thin_study(study, WAYPOINTS)
    names = thin.context.factors.groups
    groups = tuple(dict.fromkeys(filter(None, names)))
    if len(groups) < 2:
        return None
    points = design_points(np.array(names, dtype=object), groups, base, seed)
    found, _ = evaluate_chunks(
        thin, len(points), lambda rows: points[rows.start : rows.stop],
        about={"sensitivity": base, "design": "A, B, AB by group", "seed": seed}, folder=folder, workforce=workforce,
        progress=progress,
    )  # fmt: skip
    total, half = estimate_totals(found.rms.T.reshape(len(study.strategies), len(groups) + 2, base), seed)
    totals = dict(zip(study.strategies, total, strict=True))
    return Sensitivity(groups, totals, dict(zip(study.strategies, half, strict=True)), len(points), len(thin.task))


def design_points(names: Array, groups: tuple[str, ...], base: int, seed: int) -> Array:
    """Return the base points A and B, and A with one group's columns of B for every group. Shape (.., factors)."""
    free = np.flatnonzero([bool(name) for name in names])
    drawn = qmc.Sobol(2 * len(free), scramble=True, rng=np.random.default_rng(seed)).random(base)
    a, b = np.full((2, base, len(names)), 0.5)
    a[:, free], b[:, free] = np.clip(np.split(drawn, 2, axis=1), 1e-12, 1.0 - 1e-12)
    return np.concatenate([a, b, *(np.where(names == group, b, a) for group in groups)])


def estimate_totals(values: Array, seed: int) -> tuple[Array, Array]:
    """Return total indices and half widths of their 95 % intervals (bootstrap). Shape (strategies, groups).

    values: results of the study at A, B, and A with one group of B. Shape (strategies, groups + 2, base).
    """
    shape = (values.shape[0], values.shape[1] - 2)

    def estimate(rows: Any) -> Array:
        a, b, *mixed = np.moveaxis(values[..., rows], 1, 0)
        result = sobol_indices(func={"f_A": a, "f_B": b, "f_AB": np.stack(mixed)}, n=len(rows))
        return np.asarray(result.total_order, float).reshape(shape)

    rows = np.arange(values.shape[2])
    spread = bootstrap(
        (rows,), estimate, n_resamples=RESAMPLES, vectorized=False, method="basic", rng=np.random.default_rng(seed)
    )
    return estimate(rows), 1.96 * np.nan_to_num(spread.standard_error)
