"""Reference paths of a certificate: those of jobs, or a large and a small circle of the robot's own size [ISO 9283]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.errors import CompplanError
from compplan.job.job import Job
from compplan.plan.plan import PlanOptions, plan_compensation, plan_job
from compplan.plan.result import Plan
from compplan.robot import Array, Robot
from compplan.robot.folder import read_rating
from compplan.robot.model import STANDARD_GRAVITY
from compplan.toolpath.generators import Pace, generate_circle
from compplan.toolpath.toolpath import Toolpath, place_toolpath
from compplan.uncertainty.band import Promise, promise_path
from compplan.uncertainty.slopes import ForceSpread, stage_path

#: Centres that are tried, as shares of the longest reach: along x, and up (assumed).
PLACES = ((0.60, 0.30), (0.50, 0.30), (0.50, 0.15), (0.60, 0.10), (0.45, 0.45), (0.40, 0.25))
#: Radius of the large circle as a share of the longest reach, rounded to this [m]; the small one is a tenth of it.
RADIUS, ROUND, SMALLER = 0.15, 0.01, 0.1
#: Force on the tool where no rating is known, per metre of reach. [N/m] (assumed)
FORCE = 50.0
WAYPOINTS = 90


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference path on a robot.

    Attributes:
        name: What it is called.
        force: Force on the tool, the greatest on the path, base axes. Shape (3,). [N]
        centre: Where it stands, base frame. Shape (3,). [m]; None where the robot does not reach it.
        plan: Its plan, or None.
        promise: What the robot alone can promise there, the force known exactly, or None.
        reason: Why there is none, "" otherwise.
    """

    name: str
    force: Array
    centre: Array | None
    plan: Plan | None
    promise: Promise | None
    reason: str = ""


def plan_references(robot: Robot) -> list[Reference]:
    """Plan the robot's own reference paths, each at the first place where that succeeds.

    The force is the weight of the rated payload, downwards, or an assumed one where no rating is known.
    """
    rating = read_rating(robot)
    down = FORCE * robot.longest_reach if rating is None else STANDARD_GRAVITY * rating[0]
    large = max(ROUND, round(RADIUS * robot.longest_reach / ROUND) * ROUND)
    found = []
    for radius in (large, SMALLER * large):
        path = generate_circle(radius, Pace(feed=0.1 * radius / 0.2, waypoints=WAYPOINTS))
        found.append(plan_reference(robot, f"circle, radius {1e3 * radius:.4g} mm", path, np.array([0.0, 0.0, -down])))
    return found


def plan_jobs(jobs: Sequence[Job]) -> list[Reference]:
    """Plan the paths of jobs, whose robot is the one that is certified."""
    found = []
    for job in jobs:
        name = job.name or job.file.stem
        try:
            plan = plan_job(job)
        except CompplanError as error:
            found.append(Reference(name, np.zeros(3), None, None, None, " ".join(str(error).split())))
            continue
        force = plan.task.wrench[plan.task.cut, :3]
        most = force[np.linalg.norm(force, axis=1).argmax()] if len(force) else np.zeros(3)
        centre = plan.task.position[plan.task.cut].mean(axis=0)
        if plan.command.status != "solved":
            found.append(Reference(name, most, centre, None, None, plan.explain_failures()))
            continue
        found.append(Reference(name, most, centre, plan, promise_plan(plan)))
    return found


def plan_reference(robot: Robot, name: str, path: Toolpath, force: Array) -> Reference:
    """Plan a path with a constant force where the robot reaches it."""
    wrench = np.tile(np.r_[force, np.zeros(3)], (len(path), 1))
    reason = "out of reach at every place that was tried"
    for along, up in PLACES:
        place = np.eye(4)
        place[:3, 3] = along * robot.longest_reach, 0.0, up * robot.longest_reach
        nominal = replace(place_toolpath(path, place), wrench=wrench)
        try:
            options = PlanOptions(chord=1.0, max_correction=0.02, inertia=False)
            plan = plan_compensation(robot, nominal, options, name=name)
        except CompplanError as error:
            reason = " ".join(str(error).split())
            continue
        if plan.command.status == "solved":
            return Reference(name, force, place[:3, 3], plan, promise_plan(plan))
        reason = plan.explain_failures()
    return Reference(name, force, None, None, None, reason)


def promise_plan(plan: Plan) -> Promise:
    """Compute the 95 % band of the waypoints of a plan whose force is known exactly."""
    task = plan.task
    scene = stage_path(task.robot, plan.q, task.wrench, task.step_time)
    return promise_path(task.robot, scene, task.cut, ForceSpread(0.0, 0.0, 0.0, "taken as known"))
