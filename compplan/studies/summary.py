"""The content of montecarlo.json: figures of every strategy with intervals, paired differences, sensitivity."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from compplan.job.noise import describe_noise
from compplan.robot import Array
from compplan.studies.runner import Run
from compplan.studies.sensitivity import Sensitivity
from compplan.studies.statistics import Interval, estimate_mean, estimate_quantile, estimate_share
from compplan.studies.study import Study
from compplan.uncertainty.assumed import list_assumed, robot_uncertainty

#: What a study leaves out.
UNCOUPLED = "the stiffness of the process (the force does not depend on the deflection), "
LEFT_OUT = "the steps of quantised encoders (their errors are drawn as normal noise)"


def _describe_reach(study: Study) -> list[str]:
    """Say what every sample leaves out."""
    return [f"left out of every sample: {UNCOUPLED}{LEFT_OUT}"]


def _describe_draws(study: Study) -> list[str]:
    """Say what robots are drawn from, where that is what the folder knows, and what of the force goes with them."""
    robot, posterior = study.task.robot, study.surroundings.posterior
    said = [f"robots are drawn from what is known: {robot_uncertainty(robot).source}", *list_assumed(robot)]
    if (force := posterior.force) is None:
        return [*describe_noise(study.noise), *said]
    taken = ("noise.wrench_level ", "noise.wrench_direction_deg ")
    said += [f"level and direction of the force ({force.level:.0%}, {np.degrees(force.direction):.2g} deg) go with the"
             f" robot: {force.source}"]  # fmt: skip
    return [*(sentence for sentence in describe_noise(study.noise) if not sentence.startswith(taken)), *said]


def summarise_run(
    run: Run, sensitivity: Sensitivity | None = None, *, name: str = "", main: str = ""
) -> dict[str, Any]:
    """Return the content of montecarlo.json; `main` is the strategy whose sensitivity stands at the top."""
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
        "assumptions": [*_describe_reach(study), *_describe_draws(study)],
    }
    if sensitivity is not None:
        summary["sensitivity"] = dict(zip(sensitivity.groups, sensitivity.total[main].tolist(), strict=True))
        summary["sensitivity_by_strategy"] = {
            strategy: {
                group: {"total": float(total), "half_width95": float(half)}
                for group, total, half in zip(
                    sensitivity.groups, sensitivity.total[strategy], sensitivity.half_width[strategy], strict=True
                )
            }
            for strategy in strategies
        }
        summary["sensitivity_samples"] = sensitivity.samples
        summary["sensitivity_waypoints"] = sensitivity.waypoints
    return summary


def compare_pairs(run: Run) -> list[dict[str, Any]]:
    """Compare every two strategies sample by sample: mean difference of the rms with its interval."""
    pairs = []
    for (i, a), (j, b) in combinations(enumerate(run.study.strategies), 2):
        difference = 1e3 * (run.evaluated.rms[:, j] - run.evaluated.rms[:, i])
        mean = estimate_mean(difference, run.settings.replicates)
        pairs.append(
            {
                "strategies": [a, b],
                "rms_mm": {"mean": mean.value, "ci95": [mean.low, mean.high]},
                "second_better": float((difference < 0.0).mean()),
            }
        )
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
    return {
        "mean": mean.value,
        "p50": median.value,
        "p95": high.value,
        "ci95": _ends(mean),
        "p50_ci95": _ends(median),
        "p95_ci95": _ends(high),
    }


def _ends(interval: Interval) -> list[float]:
    return [interval.low, interval.high]
