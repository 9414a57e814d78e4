"""The jobs of the posture benchmark: robots, paths and tools, each with its judge."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.job.job import Job, check_job
from compplan.job.loading import load_nominal
from compplan.planning.plan import job_robot
from compplan.robot import Robot
from compplan.simulation.exact import ExactRobot, build_exact_robot
from compplan.toolpath.toolpath import Toolpath

Array = NDArray[np.float64]
PATHS = Path(__file__).resolve().parent.parent / "paths"

#: Robot, place of the part [mm], and how its flange carries a tool: axis out of the flange as column of a rotation.
ROBOTS: dict[str, tuple[tuple[float, float, float], str]] = {
    "kuka_kr270": ((1700.0, 0.0, 700.0), "x"),
    "kuka_kr240": ((1700.0, 0.0, 700.0), "x"),
    "staubli_tx200": ((1300.0, 0.0, 500.0), "z"),
}
PATH_TABLES: dict[str, dict[str, Any]] = {
    "circle": {"toolpath": {"generator": "circle", "radius_mm": 200.0, "feed_mm_s": 50.0, "step_mm": 2.0}},
    "spiral": {"toolpath": {"generator": "spiral", "outer_radius_mm": 200.0, "length_mm": 2500.0, "feed_mm_s": 50.0,
                            "step_mm": 2.0}},
    "cone": {"toolpath": {"generator": "isf_cone", "diameter_mm": 160.0, "depth_mm": 40.0, "wall_angle_deg": 45.0,
                          "pitch_mm": 4.0, "feed_mm_s": 30.0, "step_mm": 2.0}},
    "freeform": {"toolpath": "freeform.csv"},
}  # fmt: skip
PROCESSES: dict[str, dict[str, Any]] = {
    "circle": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
    "spiral": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
    "cone": {"model": "isf", "axial_N": 1200.0, "lateral_N": 400.0},
    "freeform": {"model": "constant", "force_N": [-250.0, 150.0, 350.0], "frame": "path"},
}
#: Where the part may be placed: the room in front of the robot.
PLACES = {"x_mm": [800.0, 2200.0], "y_mm": [-800.0, 800.0], "z_mm": [0.0, 1400.0], "step_mm": 200.0}
ANGLES = (0.0, 45.0, 90.0)
#: Mount: bracket along the flange axis, then spindle under the angle. [mm]
BRACKET, SPINDLE = 150.0, 300.0


@dataclass(frozen=True)
class Case:
    """One job of the benchmark with everything that belongs to it."""

    name: str
    job: Job
    robot: Robot
    nominal: Toolpath
    judge: ExactRobot
    angle: float


def make_case(robot: str, path: str, angle: float, tool_x: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Case:
    """Make a job: a robot, a path and a spindle under an angle to the flange axis [deg]."""
    place, out = ROBOTS[robot]
    bend = np.radians(angle)
    if out == "x":
        tip = [BRACKET + SPINDLE * np.cos(bend), 0.0, -SPINDLE * np.sin(bend)]
        turn = [0.0, 90.0 + angle, 0.0]
    else:
        tip = [SPINDLE * np.sin(bend), 0.0, BRACKET + SPINDLE * np.cos(bend)]
        turn = [0.0, angle, 0.0]
    table = {
        "schema": 1, "robot": robot, **PATH_TABLES[path], "process": PROCESSES[path],
        "part": {"position_mm": list(place)}, "tool": {"position_mm": tip, "rotation_deg": turn, "mass_kg": 15.0},
        "plan": {"tool_x": list(tool_x)}, "place": PLACES,
    }  # fmt: skip
    job = check_job(table, PATHS / "benchmark.toml")
    loaded = job_robot(job)
    return Case(f"{path}, {robot}, {angle:g} deg", job, loaded, load_nominal(job), build_exact_robot(loaded), angle)


def list_cases() -> list[Case]:
    """List the 12 jobs: every robot with every path, the three tools in turn."""
    cases = []
    for r, robot in enumerate(ROBOTS):
        for p, path in enumerate(PATH_TABLES):
            cases.append(make_case(robot, path, ANGLES[(r + p) % 3]))
    return cases
