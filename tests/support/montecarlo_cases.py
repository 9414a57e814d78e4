"""Small studies that several tests share."""

from __future__ import annotations

from functools import cache

import numpy as np

from compplan.job.job import Job, check_job
from compplan.job.noise import NoiseTable
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.studies.sampling import SampledRobots
from compplan.studies.study import Study, prepare_study


def cone_job(*, pitch_mm: float = 5.0, step_mm: float = 3.0, robot: str = "staubli_tx200", **noise: float) -> Job:
    """A coarse ISF cone, after Johra 2022."""
    return check_job(
        {
            "schema": 1,
            "name": "coarse cone",
            "robot": robot,
            "toolpath": {
                "generator": "isf_cone", "diameter_mm": 40.0, "depth_mm": 10.0, "wall_angle_deg": 45.0,
                "pitch_mm": pitch_mm, "feed_mm_s": 20.0, "step_mm": step_mm, "approach_mm": 20.0,
            },
            "part": {"position_mm": [1500.0, 0.0, 183.0]},
            "process": {"model": "isf", "axial_N": 1200.0, "lateral_N": 500.0, "start_share": 1.0, "ramp_mm": 20.0},
            "noise": noise,
        }
    )  # fmt: skip


@cache
def cone_task(robot: str = "staubli_tx200") -> PlanTask:
    """The task of the coarse cone."""
    job = cone_job(robot=robot)
    return build_task(*prepare_job(job))


@cache
def cone_study(most_waypoints: int = 60) -> Study:
    """A study of the coarse cone with every strategy."""
    return prepare_study(cone_task(), NoiseTable(), most_waypoints=most_waypoints)


@cache
def small_study() -> Study:
    """A study of two cheap strategies at a dozen waypoints."""
    return prepare_study(cone_task(), NoiseTable(), ["none", "secondary_encoder"], most_waypoints=12)


def noise_free_robots(study: Study, compliance: Array, level: Array) -> SampledRobots:
    """Make robots without noise, with all compliances and the wrench times factors. Shape (b,) each."""
    at, b, n = study.context, len(compliance), len(study.task)
    nq = at.nq
    still, rest = np.zeros((nq, b, n)), np.zeros((3, b, n))
    wrench = at.wrench[:, None, :] * level[:, None]
    return SampledRobots(
        factor=np.tile(compliance, (len(at.link_share), 1)),
        link_share=np.repeat(at.link_share[:, None], b, axis=1),
        zero=np.zeros((nq, b)),
        drive=still,
        causes=np.zeros((len(at.shift), b)),
        shift=rest,
        wrench=wrench,
        repeat=np.zeros((3, b)),
        motor=still,
        link=still,
        force=np.zeros((6, b, n)),
    )
