"""Measure Monte Carlo studies: `OMP_NUM_THREADS=1 python -m benchmarks.montecarlo [SAMPLES]`.

Prints loaded poses a second of one core, the time of 1,000 samples x 8 strategies x 2,000 waypoints, the agreement with
the judge, and what a second Dask worker brings. CPU times are what a busy machine does not spoil.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from compplan.cell.judge import build_judge, judge_pose
from compplan.job.job import load_job
from compplan.plan.plan import build_task, prepare_job
from compplan.study.draw import draw_cells
from compplan.study.factors import draw_points
from compplan.study.kernel import settle_tips
from compplan.study.runner import Settings, run_study
from compplan.study.study import Study, prepare_study
from compplan.study.workforce import Workforce

JOB = Path(__file__).parent.parent / "paths" / "isf_cone.toml"
EIGHT = ("none", "mirror", "iterated_mirror", "nlp", "secondary_encoder", "both_encoders", "encoder_force",
         "force_sensor_full")  # fmt: skip


def measure_kernel(study: Study, repeats: int = 5) -> tuple[float, float]:
    """Poses a second of one core, and the greatest distance from the judge on a few of them [m]."""
    n, b = len(study.task), 8
    cells = draw_cells(study.surroundings, draw_points(study.surroundings.factors, 1, 8, range(b)))
    worker = study.workers["none"]
    q = np.repeat(worker.q, b, axis=1).reshape(len(worker.q), -1)
    wrench = cells.wrench[-1].reshape(6, -1)
    factor = np.repeat(cells.factor, n, axis=1)
    theta = np.tile(worker.theta, (1, b)) * factor
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        tips = settle_tips(study.kernel, q, wrench, factor, theta)
        best = min(best, time.process_time() - start)
    rows = np.arange(0, b * n, b * n // 60)
    worst = 0.0
    for row in rows:
        robot = study.task.robot
        springs = tuple(
            replace(s, compliance=s.compliance * f) for s, f in zip(robot.springs, factor[:, row], strict=True)
        )
        judged, _, _ = judge_pose(build_judge(replace(robot, springs=springs)), q[:, row][None], wrench[:, row][None])
        worst = max(worst, float(np.abs(judged[0] - tips[:, row]).max()))
    return b * n / best, worst


def cpu() -> float:
    """CPU time of this process and those that it has waited for. [s]"""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage)


def measure_study(study: Study, samples: int, workforce: Workforce) -> tuple[float, float]:
    """Wall and CPU time of a study. [s]"""
    start, spent = time.perf_counter(), cpu()
    run_study(study, Settings(samples, 1), workforce=workforce)
    return time.perf_counter() - start, cpu() - spent


def measure_cluster(study: Study, samples: int) -> tuple[float, float]:
    """Wall time on one and on two Dask workers. [s]"""
    from distributed import LocalCluster

    times = []
    for workers in (1, 2):
        with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
            there = Workforce(scheduler=cluster.scheduler_address)
            run_study(study, Settings(8 * 16, 2), workforce=there)  # workers have imported everything
            start = time.perf_counter()
            run_study(study, Settings(samples, 1), workforce=there)
            times.append(time.perf_counter() - start)
    return times[0], times[1]


def main(samples: int = 1000) -> None:
    """Print the figures."""
    job = load_job(JOB)
    task = build_task(*prepare_job(job))
    study = prepare_study(task, job.noise, EIGHT, most_waypoints=2000)
    speed, worst = measure_kernel(study)
    print(f"kernel: {speed / 1e6:.2f} million loaded poses a second a core, within {worst * 1e9:.2g} nm of the judge")
    wall, spent = measure_study(study, samples, Workforce(workers=2))
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print(f"{samples} samples x 8 strategies x {len(study.task)} waypoints, two processes: {wall:.1f} s wall, "
          f"{spent:.1f} s CPU, {peak:.0f} MB at most a process; load {os.getloadavg()[0]:.1f}")  # fmt: skip
    one, two = measure_cluster(study, samples // 2)
    load = os.getloadavg()[0]
    print(f"Dask: {one:.1f} s with one worker, {two:.1f} s with two, ratio {one / two:.2f}; load {load:.1f}")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:2]))
