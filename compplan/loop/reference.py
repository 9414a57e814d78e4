"""Reference paths: a circle of 500 mm radius and the cone of incremental forming, placed where a robot reaches them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.errors import CompplanError
from compplan.path.generators import Pace, generate_circle, generate_cone
from compplan.path.toolpath import Toolpath, place_toolpath
from compplan.plan.plan import Plan, PlanOptions, plan_compensation
from compplan.promise.band import Promise, promise_path
from compplan.promise.slopes import ForceSpread, stage_path
from compplan.robot import Array, Robot

#: Centres that are tried, as shares of the longest reach: along x, and up (assumed).
PLACES = ((0.60, 0.30), (0.50, 0.30), (0.50, 0.15), (0.60, 0.10), (0.45, 0.45), (0.40, 0.25))
#: Forces of the published paths [N], and what arms below the reach [m] carry instead (assumed).
CIRCLE_FORCE, CONE_FORCE, SMALL, LIGHT = (440.0, 1370.0, -635.0), (0.0, 400.0, 1200.0), 2.2, 0.05
WAYPOINTS = 90


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference path on a robot.

    Attributes:
        name: What it is called.
        force: Force on the tool, base axes. Shape (3,). [N]
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
    """Plan both reference paths on a robot, each at the first place where that succeeds."""
    share = 1.0 if robot.longest_reach > SMALL else LIGHT
    circle = generate_circle(0.5, Pace(feed=0.1, waypoints=WAYPOINTS))
    cone = generate_cone(0.04, 0.015, np.pi / 4, 0.0025, Pace(feed=0.02, waypoints=WAYPOINTS))
    found = []
    for name, path, force in (
        ("circle, radius 500 mm", circle, CIRCLE_FORCE), ("ISF cone, 40 mm, 45 deg", cone, CONE_FORCE)
    ):  # fmt: skip
        found.append(plan_reference(robot, name, path, share * np.array(force)))
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
            plan = plan_compensation(robot, nominal, PlanOptions(chord=1.0, max_correction=0.02), name=name)
        except CompplanError as error:
            reason = " ".join(str(error).split())
            continue
        if plan.command.status == "solved":
            return Reference(name, force, place[:3, 3], plan, promise_plan(plan))
        reason = plan.explain_failures()
    return Reference(name, force, None, None, None, reason)


def promise_plan(plan: Plan) -> Promise:
    """Promise the waypoints of a plan whose force is known exactly."""
    task = plan.task
    scene = stage_path(task.robot, plan.q, task.wrench, task.step_time)
    return promise_path(task.robot, scene, task.cut, ForceSpread(0.0, 0.0, 0.0, "taken as known"))
