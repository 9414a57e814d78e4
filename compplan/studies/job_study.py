"""From a job to its Monte Carlo study; the samples are on disk as they come."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.io.provenance import note_seed
from compplan.job.job import Job
from compplan.planning.plan import build_task, prepare_job
from compplan.studies.runner import Run, Settings, run_study
from compplan.studies.sensitivity import Sensitivity, measure_sensitivity
from compplan.studies.storage import discard_chunks
from compplan.studies.study import MOST_WAYPOINTS, prepare_study
from compplan.studies.summary import summarise_run
from compplan.studies.workers import Workers
from compplan.uncertainty.sensitivities import read_force_spread

SAMPLES = "samples"


@dataclass(frozen=True)
class JobStudy:
    """A study of a job with everything that its report shows."""

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
    announce: Callable[[str], None] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> JobStudy:
    """Study a job; samples go to a folder in the output folder as they come.

    Args:
        job: The job.
        settings: How it is sampled.
        folder: Output folder.
        strategies: Names; all that the robot can carry out if empty.
        most_waypoints: A longer path is thinned evenly to this many.
        sensitivity: Whether total Sobol indices are measured.
        discard: Whether finished samples of another study in the folder are taken away first.
        workforce: Who computes.
        announce: Called with what is done next.
        progress: Called with the name of a stage, samples done and samples wanted.

    Raises:
        InputError: If the job is not what it has to be, or the folder cannot be written.
    """
    say = announce or (lambda text: None)
    note_seed("samples", settings.seed)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file, expected a folder to write to", file=folder)
    workforce = workforce or Workers()
    workforce.check()
    say("posture")
    robot, nominal, options = prepare_job(job)
    task, force = build_task(robot, nominal, options, file=job.file), read_force_spread(job)
    study = prepare_study(task, job.noise, strategies, most_waypoints=most_waypoints, force=force, announce=say)

    def tell(stage: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(stage, done, total)

    say("samples")
    store = folder / SAMPLES
    if discard:
        discard_chunks(store)
    run = run_study(study, settings, folder=store, workforce=workforce, progress=tell("samples"))
    indices = None
    if sensitivity:
        say("sensitivity")
        indices = measure_sensitivity(
            study, settings.seed, folder=store / "sensitivity", workforce=workforce, progress=tell("sensitivity")
        )
    say("summary")
    summary = summarise_run(run, indices, name=job.name or job.file.stem, main=options.strategy)
    return JobStudy(job, run, indices, summary)
