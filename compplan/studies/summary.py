"""Content of montecarlo.json: figures of every strategy with intervals, paired differences, sensitivity.

Points of one scrambled sequence are dependent, the replicates are independent: the interval of a mean is Student's t on
the means of the replicates [Owen1995]. Intervals of quantiles and shares are those of independent samples, conservative
for low-discrepancy points.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binom, binomtest, t

from compplan.job.noise import describe_noise
from compplan.process.learned_force import FILE as PROCESS
from compplan.robot import Array
from compplan.studies.runner import Run
from compplan.studies.sensitivity import Sensitivity
from compplan.studies.study import Study
from compplan.uncertainty.assumed import list_assumed, robot_uncertainty

#: Errors that a study does not include.
LEFT_OUT = (
    "left out of every sample: the stiffness of the process (the force does not depend on the deflection),"
    " the steps of quantised encoders (their errors are drawn as normal noise)"
)
#: Confidence level of the intervals.
LEVEL = 0.95


def _describe_draws(study: Study) -> list[str]:
    """Describe the distributions of robots and noise, and the correlation of the force with the robots."""
    robot, force = study.task.robot, study.context.force
    said = [f"robots are drawn from what is known: {robot_uncertainty(robot).source}", *list_assumed(robot)]
    if not force.source.startswith(PROCESS):
        return [*describe_noise(study.noise), *said]
    taken = ("noise.wrench_level ", "noise.wrench_direction_deg ")
    tied = " go with the robot" if len(force.robot) else ""
    said.append(f"level and direction of the force ({force.level:.0%}, {np.degrees(force.direction):.2g} deg){tied}:"
                f" {force.source}")  # fmt: skip
    return [*(sentence for sentence in describe_noise(study.noise) if not sentence.startswith(taken)), *said]


def summarise_run(
    run: Run, sensitivity: Sensitivity | None = None, *, name: str = "", main: str = ""
) -> dict[str, Any]:
    """Return the content of montecarlo.json; `main` is the strategy of the top-level sensitivity."""
    study, settings = run.study, run.settings
    strategies = study.strategies
    main = main if main in strategies else strategies[-1]
    summary: dict[str, Any] = {
        "schema": 1,
        "samples": len(run.evaluated.rms),
        "seed": settings.seed,
        "name": name,
        "robot": study.task.robot.name,
        "robot_grade": study.task.robot.grade,
        "waypoints": len(study.task),
        "waypoints_of_path": study.waypoints_of_path,
        "tolerance_mm": study.task.tolerance * 1e3,
        "replicates": settings.replicates,
        "strategies": {strategy: _figures(run, k) for k, strategy in enumerate(strategies)},
        "paired_differences": compare_pairs(run),
        "sensitivity": {},
        "sensitivity_of": main,
        "within_tolerance_means": "share of samples whose greatest deviation stays within the tolerance",
        "intervals": "ci95 of a mean: Student's t on independent replicates; of quantiles: order statistics",
        "assumptions": [LEFT_OUT, *_describe_draws(study)],
    }
    if sensitivity is not None:
        summary["sensitivity"] = dict(zip(sensitivity.groups, sensitivity.total[main].tolist(), strict=True))
        summary["sensitivity_by_strategy"] = {strategy: sensitivity.describe(strategy) for strategy in strategies}
        summary["sensitivity_samples"] = sensitivity.samples
        summary["sensitivity_waypoints"] = sensitivity.waypoints
    return summary


def compare_pairs(run: Run) -> list[dict[str, Any]]:
    """Compare every two strategies sample by sample: mean rms difference and its 95 % interval."""
    pairs = []
    for (i, a), (j, b) in combinations(enumerate(run.study.strategies), 2):
        difference = 1e3 * (run.evaluated.rms[:, j] - run.evaluated.rms[:, i])
        mean = estimate_mean(difference, run.settings.replicates)
        rms = {"mean": mean.value, "ci95": list(mean[1:])}
        pairs.append({"strategies": [a, b], "rms_mm": rms, "second_better": float((difference < 0.0).mean())})
    return pairs


def _figures(run: Run, k: int) -> dict[str, Any]:
    evaluated, replicates = run.evaluated, run.settings.replicates
    good = int((evaluated.max[:, k] <= run.study.task.tolerance).sum())
    share = estimate_share(good, len(evaluated.max))
    figures: dict[str, Any] = {
        "rms_mm": _spread(1e3 * evaluated.rms[:, k], replicates),
        "mean_mm": _spread(1e3 * evaluated.mean[:, k], replicates),
        "max_mm": _spread(1e3 * evaluated.max[:, k], replicates),
        "within_tolerance": share.value,
        "within_tolerance_ci95": [share.low, share.high],
        "waypoints_within_tolerance": float(evaluated.within[:, k].mean()),
    }
    if "none" in run.study.strategies:
        first = run.study.strategies.index("none")
        figures["of_uncorrected"] = float(np.mean(evaluated.rms[:, k]) / np.mean(evaluated.rms[:, first]))
    return figures


def _spread(values: Array, replicates: int) -> dict[str, Any]:
    mean = estimate_mean(values, replicates)
    median, high = (estimate_quantile(values, share) for share in (0.5, 0.95))
    figures = {"mean": mean.value, "p50": median.value, "p95": high.value}
    return {**figures, "ci95": list(mean[1:]), "p50_ci95": list(median[1:]), "p95_ci95": list(high[1:])}


class Interval(NamedTuple):
    """An estimate and its interval."""

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Return half the width of the interval."""
        return 0.5 * (self.high - self.low)


def estimate_mean(values: Array, replicates: int) -> Interval:
    """Estimate a mean from replicated samples, shape (samples,); sample i belongs to replicate i % replicates."""
    means = np.array([values[k::replicates].mean() for k in range(replicates)])
    centre = float(means.mean())
    half = float(t.ppf(0.5 + 0.5 * LEVEL, replicates - 1) * means.std(ddof=1) / np.sqrt(replicates))
    return Interval(centre, centre - half, centre + half)


def estimate_quantile(values: Array, share: float) -> Interval:
    """Estimate a quantile, with a distribution-free interval between order statistics."""
    ordered, n = np.sort(values), len(values)
    low = int(binom.ppf(0.5 - 0.5 * LEVEL, n, share)) - 1
    high = int(binom.ppf(0.5 + 0.5 * LEVEL, n, share))
    return Interval(float(np.quantile(ordered, share)), float(ordered[max(low, 0)]), float(ordered[min(high, n - 1)]))


def estimate_share(hits: int, n: int) -> Interval:
    """Estimate a probability from hits among n [Clopper1934]."""
    interval = binomtest(hits, n).proportion_ci(LEVEL)
    return Interval(hits / n, float(interval.low), float(interval.high))
