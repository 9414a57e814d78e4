"""Which uncertainty matters: total Sobol indices of each strategy's rms deviation, by group of factors.

A total index is the share of the variance that would be left if everything but the group were known [Homma1996];
SALib makes the points and the estimates. The path is thinned for this.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.robot import Array
from compplan.study.runner import chunk_size, judge_chunks
from compplan.study.study import Study, thin_study
from compplan.study.workforce import Workforce

#: Waypoints that the analysis looks at.
WAYPOINTS = 300
#: Base points of the design; the analysis takes (groups + 2) times as many samples.
BASE = 128


@dataclass(frozen=True)
class Sensitivity:
    """Total Sobol indices.

    Attributes:
        groups: Names of the groups.
        total: By strategy, the total index of each group. Shape (groups,) each.
        half_width: By strategy, half the 95 % interval of each (bootstrap). Shape (groups,) each.
        samples: Number of samples behind them.
        waypoints: Number of waypoints that they look at.

    """

    groups: tuple[str, ...]
    total: dict[str, Array]
    half_width: dict[str, Array]
    samples: int
    waypoints: int


def measure_sensitivity(
    study: Study,
    seed: int,
    *,
    base: int = BASE,
    folder: Path | None = None,
    workforce: Workforce | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sensitivity | None:
    """Measure total Sobol indices by group; None where nothing is uncertain.

    Args:
        study: The study.
        seed: Seed of the design.
        base: Base points, a power of two.
        folder: Folder for the chunks, or None.
        workforce: Who computes.
        progress: Called with samples done and wanted.

    """
    from SALib.analyze import sobol as analyse
    from SALib.sample import sobol as sample

    thin = thin_study(study, WAYPOINTS)
    factors = thin.surroundings.factors
    if len(factors.groups) < 2:
        return None
    names = factors.group_names()
    columns = [k for k, name in enumerate(names) if name]
    problem = {
        "num_vars": len(columns),
        "names": [f"x{k}" for k in columns],
        "groups": [names[k] for k in columns],
        "bounds": [[0.0, 1.0]] * len(columns),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        drawn = sample.sample(problem, base, calc_second_order=False, scramble=True, seed=seed)
    points = np.full((len(drawn), factors.size), 0.5)
    points[:, columns] = np.clip(drawn, 1e-12, 1.0 - 1e-12)
    size = chunk_size(thin)
    chunks = [range(a, min(a + size, len(points))) for a in range(0, len(points), size)]
    about: dict[str, object] = {"sensitivity": base, "seed": seed, "chunk": size}
    done, _, _ = judge_chunks(
        thin, chunks, lambda n: points[chunks[n].start : chunks[n].stop],
        about=about, folder=folder, workforce=workforce, progress=progress,
    )  # fmt: skip
    rms = np.concatenate([done[n].rms for n in range(len(chunks))])
    total, half = {}, {}
    groups: tuple[str, ...] = tuple(dict.fromkeys(names[k] for k in columns))
    for k, name in enumerate(study.strategies):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = analyse.analyze(problem, rms[:, k], calc_second_order=False, seed=seed, num_resamples=200)
        total[name] = np.nan_to_num(np.asarray(found["ST"], float))
        half[name] = np.nan_to_num(np.asarray(found["ST_conf"], float))
    return Sensitivity(groups, total, half, len(points), len(thin.task))
