"""Compare strategies on a job: in the cell as modelled, in cells that differ, and on the drawn robots of a study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from compplan.job.job import Job
from compplan.job.noise import NoiseTable
from compplan.planning.compare import Comparison, Drawn, compare_task
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.task import PlanTask
from compplan.studies.runner import Settings, run_study
from compplan.studies.statistics import estimate_quantile
from compplan.studies.study import prepare_study
from compplan.studies.workers import Workers
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.sensitivities import ForceSpread, read_force_spread

#: Robots that are drawn, their seed, and the waypoints at which they are looked at.
DRAWS, SEED, WAYPOINTS = 200, 1, 300


def compare_job(job: Job, *, announce: Callable[[str], None] = lambda text: None) -> Comparison:
    """Compare every strategy on a job.

    Raises:
        InputError: If the job is not what it has to be, or the part is out of reach.
    """
    announce("robot, toolpath and posture")
    robot, nominal, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    comparison = compare_task(task, name=job.name or job.file.stem, announce=announce)
    announce("robots drawn from the uncertainty")
    return replace(comparison, job=job, drawn=draw_strategies(task, job.noise, read_force_spread(job)))


def draw_strategies(task: PlanTask, noise: NoiseTable, force: ForceSpread, draws: int = DRAWS) -> Drawn:
    """Let every strategy cut the path on the drawn robots of a Monte Carlo study, the same ones for all."""
    study = prepare_study(task, noise, most_waypoints=WAYPOINTS, force=force)
    found = run_study(study, Settings(draws, SEED), workforce=Workers(workers=1)).evaluated.rms
    rms = dict(zip(study.strategies, found.T, strict=True))
    ends = {name: estimate_quantile(values, 0.5) for name, values in rms.items()}
    source = f"{robot_uncertainty(task.robot).source}; force {force.source}"
    return Drawn(source, rms, {name: (median.low, median.high) for name, median in ends.items()})
