"""Monte Carlo study and comparison of strategies of a job; finished samples are stored on disk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.io.provenance import note_seed
from compplan.job.job import Job
from compplan.job.noise import NoiseTable
from compplan.measurement.distance import LEVEL
from compplan.planning.compare import Comparison, MonteCarloResult, compare_task
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.task import PlanTask
from compplan.studies.runner import CHUNK, Run, Settings, discard_chunks, run_study
from compplan.studies.sensitivity import Sensitivity, measure_sensitivity
from compplan.studies.study import MOST_WAYPOINTS, prepare_study
from compplan.studies.summary import estimate_quantile, summarise_run
from compplan.studies.workers import Workers, start_workers
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.sensitivities import ForceSpread, read_force_spread

SAMPLES = "samples"
#: Robots drawn for a comparison, their seed, and greatest number of waypoints.
DRAWS, SEED, WAYPOINTS = 200, 1, 300


@dataclass(frozen=True)
class JobStudy:
    """A study of a job with the content of its report."""

    job: Job  #: The job.
    run: Run  #: The samples.
    sensitivity: Sensitivity | None  #: Total Sobol indices, or None.
    summary: dict[str, Any]  #: Content of montecarlo.json.


def study_job(
    job: Job,
    settings: Settings,
    folder: Path,
    *,
    strategies: Sequence[str] = (),
    most_waypoints: int = MOST_WAYPOINTS,
    sensitivity: bool = True,
    discard: bool = False,
    workforce: Workers | None = None,
    announce: Callable[[str], None] = lambda text: None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> JobStudy:
    """Run the Monte Carlo study of a job; finished samples are stored in `folder`.

    strategies: all that the robot supports if empty; most_waypoints: a longer path is thinned evenly to this number;
    discard: whether to delete finished samples of any study in the folder first; announce: called with the name of each
    step; progress: called with the name of a stage, finished samples and total samples.

    Raises:
        InputError: If the job is invalid, or the folder cannot be written.
    """
    note_seed("samples", settings.seed)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file, expected a folder to write to", file=folder)
    workforce = workforce or Workers()
    workforce.check()
    # the worker processes import modules while this one prepares the study
    with start_workers(workforce, -(-settings.samples // CHUNK)) as crew:
        announce("posture")
        robot, nominal, options = prepare_job(job)
        task, force = build_task(robot, nominal, options, file=job.file), read_force_spread(job)
        study = prepare_study(
            task, job.noise, strategies, most_waypoints=most_waypoints, force=force, announce=announce
        )
        announce("samples")
        store = folder / SAMPLES
        if discard:
            discard_chunks(store)
        run = run_study(study, settings, folder=store, workforce=crew, progress=partial(progress, "samples"))
        indices = None
        if sensitivity:
            announce("sensitivity")
            indices = measure_sensitivity(
                study,
                settings.seed,
                folder=store / "sensitivity",
                workforce=crew,
                progress=partial(progress, "sensitivity"),
            )
    announce("summary")
    summary = summarise_run(run, indices, name=job.name or job.file.stem, main=options.strategy)
    return JobStudy(job, run, indices, summary)


def compare_job(job: Job, *, announce: Callable[[str], None] = lambda text: None) -> Comparison:
    """Compare every strategy on a job.

    Raises:
        InputError: If the job is invalid, or the part is out of reach.
    """
    announce("robot, toolpath and posture")
    robot, nominal, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    comparison = compare_task(task, name=job.name or job.file.stem, announce=announce)
    announce("robots drawn from the uncertainty")
    return replace(comparison, job=job, drawn=draw_strategies(task, job.noise, read_force_spread(job)))


def draw_strategies(task: PlanTask, noise: NoiseTable, force: ForceSpread, draws: int = DRAWS) -> MonteCarloResult:
    """Evaluate every strategy on the same robots, drawn as in a Monte Carlo study."""
    study = prepare_study(task, noise, most_waypoints=WAYPOINTS, force=force)
    found = run_study(study, Settings(draws, SEED), workforce=Workers(workers=1)).evaluated
    rms = dict(zip(study.strategies, found.rms.T, strict=True))
    greatest = dict(zip(study.strategies, np.quantile(found.max, LEVEL, axis=0).tolist(), strict=True))
    ends = {name: estimate_quantile(values, 0.5) for name, values in rms.items()}
    source = f"{robot_uncertainty(task.robot).source}; force {force.source}"
    return MonteCarloResult(source, rms, greatest, {name: (median.low, median.high) for name, median in ends.items()})
