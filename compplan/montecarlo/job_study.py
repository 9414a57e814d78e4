"""From a job to its Monte Carlo study on disk: montecarlo.json, report.html, and the samples."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.job import Job
from compplan.montecarlo.curves import ErrorCurves, trace_model_error
from compplan.montecarlo.encoder_table import EncoderTable, tabulate_encoders
from compplan.montecarlo.runner import Run, Settings, run_study
from compplan.montecarlo.sensitivity import Sensitivity, measure_sensitivity
from compplan.montecarlo.study import MOST_WAYPOINTS, prepare_study
from compplan.montecarlo.summary import summarise_run
from compplan.montecarlo.workforce import Workforce
from compplan.plan import PlanOptions, build_task, prepare_job
from compplan.robot import Robot
from compplan.strategies.online import PLAIN
from compplan.tables import write_text
from compplan.task import PlanTask
from compplan.toolpath import Toolpath

SAMPLES = "samples"


@dataclass(frozen=True)
class JobStudy:
    """A study of a job with everything that its report shows.

    Attributes:
        job: The job.
        run: The samples.
        sensitivity: Total Sobol indices, or None.
        curves: Deviation against model error.
        encoders: What each encoder strategy leaves under loads of all directions, or None without two encoders.
        summary: Content of montecarlo.json.

    """

    job: Job
    run: Run
    sensitivity: Sensitivity | None
    curves: ErrorCurves
    encoders: EncoderTable | None
    summary: dict[str, Any]


def study_job(
    job: Job,
    settings: Settings,
    folder: Path,
    *,
    strategies: Sequence[str] = (),
    most_waypoints: int = MOST_WAYPOINTS,
    sensitivity: bool = True,
    workforce: Workforce | None = None,
    announce: Callable[[str], None] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[dict[str, Any], list[Path]]:
    """Study a job and write montecarlo.json and report.html; samples go to a folder beside them as they come.

    Args:
        job: The job.
        settings: How it is sampled.
        folder: Folder to write to.
        strategies: Names of the strategies; all that the robot can carry out if empty.
        most_waypoints: A longer path is thinned evenly to this many waypoints.
        sensitivity: Whether total Sobol indices are measured.
        workforce: Who computes.
        announce: Called with what is done next.
        progress: Called with the name of a stage, samples done and samples wanted.

    Returns:
        The content of montecarlo.json, and the files written.

    Raises:
        InputError: If the job is not what it has to be, or the folder cannot be written.

    """
    from compplan.report.montecarlo_page import write_montecarlo_report

    say = announce or (lambda text: None)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file, expected a folder to write to", file=folder)
    say("posture")
    robot, nominal, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    plain = _plain_task(robot, nominal, options) if not strategies or PLAIN in strategies else None
    study = prepare_study(
        task, job.noise, strategies or None, most_waypoints=most_waypoints, plain=plain, announce=say
    )

    def tell(stage: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(stage, done, total)

    say("samples")
    store = folder / SAMPLES
    run = run_study(study, settings, folder=store, workforce=workforce, progress=tell("samples"))
    indices = None
    if sensitivity:
        say("sensitivity")
        indices = measure_sensitivity(
            study, settings.seed, folder=store / "sensitivity", workforce=workforce, progress=tell("sensitivity")
        )
    say("report")
    main = options.strategy
    summary = summarise_run(run, indices, name=job.name or job.file.stem, main=main)
    result = JobStudy(job, run, indices, trace_model_error(study), tabulate_encoders(study.task), summary)
    files = [write_montecarlo_report(result, folder), folder / "montecarlo.json"]
    write_text(files[1], json.dumps(summary, indent=2) + "\n")
    return summary, sorted(files)


def _plain_task(robot: Robot, nominal: Toolpath, options: PlanOptions) -> PlanTask | None:
    """Build the task at one configuration with the tool held as the job points it; None where that misses waypoints."""
    try:
        task = build_task(robot, nominal, replace(options, posture=None))
    except InputError:
        return None
    return None if task.missed.any() else task
