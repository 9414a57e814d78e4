"""Jobs with a spindle under an angle, and the best posture of each by brute force with Pinocchio's Jacobians."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from compplan.job.job import Job, check_job
from compplan.job.loading import load_nominal
from compplan.planning.plan import job_robot
from compplan.planning.posture.lattice import orient_tool, pick_stations
from compplan.robot import Robot
from compplan.simulation.exact import ExactRobot, build_exact_robot
from compplan.statics.ik import build_arm, solve_branches
from compplan.toolpath.toolpath import Toolpath

Array = NDArray[np.float64]
PATHS = Path(__file__).resolve().parents[2] / "paths"
#: Errors of wrench and compliance, stations and steps of the brute force.
ERROR, STATIONS, STEP = 0.1, 80, np.radians(1.0)
#: Limits of the search that the brute force keeps too.
ROOM, SINGULAR, WINDOW = np.radians(2.0), 0.03, 30

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
}  # fmt: skip
PROCESSES: dict[str, dict[str, Any]] = {
    "circle": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
    "spiral": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
    "cone": {"model": "isf", "axial_N": 1200.0, "lateral_N": 400.0},
}
BRACKET, SPINDLE = 150.0, 300.0


@dataclass(frozen=True)
class Case:
    """One job of the benchmark with everything that belongs to it."""

    name: str
    job: Job
    robot: Robot
    nominal: Toolpath
    exact_robot: ExactRobot
    angle: float


def make_case(robot: str, path: str, angle: float) -> Case:
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
        "plan": {"tool_x": [1.0, 0.0, 0.0]},
    }  # fmt: skip
    job = check_job(table, PATHS / "benchmark.toml")
    loaded = job_robot(job)
    return Case(f"{path}, {robot}, {angle:g} deg", job, loaded, load_nominal(job), build_exact_robot(loaded), angle)


def compute_exact_columns(exact_robot: ExactRobot, q: Array, wrench: Array) -> tuple[Array, Array]:
    """Return by Pinocchio what the errors leave at the tip, (n, 3, errors) [m], and joint Jacobians (n, 6, nq)."""
    data, elastic = exact_robot.model.createData(), exact_robot.elastic
    linear = np.empty((len(q), 6, exact_robot.model.nv))
    for i in range(len(q)):
        configuration = exact_robot.commanded @ q[i] + exact_robot.shift
        linear[i] = pin.computeFrameJacobian(
            exact_robot.model, data, configuration, exact_robot.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
    springs = linear[:, :, elastic]
    bend = np.einsum("nij,ni->nj", springs, wrench) @ exact_robot.compliance
    by_spring = springs[:, :3] * bend[:, None]
    yielding = springs[:, :3] @ exact_robot.compliance @ np.swapaxes(springs, 1, 2)
    by_wrench = yielding * wrench[:, None]
    return ERROR * np.concatenate([by_spring, by_wrench], axis=2), linear @ exact_robot.commanded


def mean_square(case: Case, q: Array, rows: Array, share: Array) -> float:
    """Return the expected square of the remaining deviation over the cut. [mm^2]"""
    columns = compute_exact_columns(case.exact_robot, q[rows], _wrench(case)[rows])[0]
    return float(1e6 * (share * (columns**2).sum(axis=(1, 2))).sum())


def cut_stations(nominal: Toolpath) -> tuple[Array, Array]:
    """Return stations of the cut and the share that each stands for."""
    rows = pick_stations(nominal, STATIONS)
    along = np.r_[0.0, np.cumsum(np.where(nominal.rapid[1:], 0.0, nominal.steps))][rows]
    share = np.gradient(along)
    share[nominal.rapid[rows] & (share < 1e-9)] = 0.0
    return rows[share > 0], share[share > 0] / share[share > 0].sum()


def brute_force(case: Case, rows: Array, share: Array) -> float:
    """Return the least mean square over all configurations and rotations in steps of 1 degree. [mm^2]

    Bellman's recursion; a rotation may turn by up to 30 degrees between stations. Joint steps are not limited, so the
    figure is a lower bound of what a continuous motion in one configuration can reach.
    """
    arm, robot, wrench = build_arm(case.robot), case.robot, _wrench(case)
    count = round(2 * np.pi / STEP)
    spins = np.tile(np.arange(count) * STEP, (len(rows), 1))
    rotation = orient_tool(case.nominal, case.job.tool_x_base, rows, spins, 0 * spins, 0 * spins)
    position = np.repeat(case.nominal.position[rows], count, axis=0)
    q = solve_branches(arm, position, rotation.reshape(-1, 3, 3))
    q = _inside(q, robot)
    cost = np.full(q.shape[:2], np.inf)
    node = np.nonzero(np.isfinite(q[..., 0]))
    station = node[0] // count
    columns, joints = compute_exact_columns(case.exact_robot, q[node], wrench[rows[station]])
    scaled = joints.copy()
    scaled[:, :3] /= _balance(case.exact_robot, robot)
    singular = np.linalg.svd(scaled, compute_uv=False)
    dexterity = 6.0 / np.sqrt((singular**2).sum(axis=1) * (1.0 / np.maximum(singular, 1e-12) ** 2).sum(axis=1))
    cost[node] = np.where(dexterity > SINGULAR, 1e6 * (columns**2).sum(axis=(1, 2)), np.inf)
    cost = cost.reshape(len(rows), count, -1) * share[:, None, None]
    value = cost[0]
    for here in cost[1:]:
        value = here + minimum_filter1d(value, 2 * WINDOW + 1, axis=0, mode="wrap")
    return float(value.min())


def _wrench(case: Case) -> Array:
    return np.zeros((len(case.nominal), 6)) if case.nominal.wrench is None else case.nominal.wrench


def _inside(q: Array, robot: Robot) -> Array:
    """Shift joints by full turns into the limits; what does not fit becomes NaN."""
    for shift in (-2 * np.pi, 2 * np.pi):
        moved = q + shift
        fits = (moved >= robot.lower + ROOM) & (moved <= robot.upper - ROOM)
        out = (q < robot.lower + ROOM) | (q > robot.upper - ROOM)
        q = np.where(out & fits, moved, q)
    good = ((q >= robot.lower + ROOM) & (q <= robot.upper - ROOM)).all(axis=2)
    return np.where(good[..., None], q, np.nan)


def _balance(exact_robot: ExactRobot, robot: Robot) -> float:
    """Return the length that balances linear and angular rows over random postures."""
    low, high = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = low + (high - low) * np.random.default_rng(0).random((64, robot.nq))
    joints = compute_exact_columns(exact_robot, q, np.zeros((64, 6)))[1]
    return float(np.sqrt((joints[:, :3] ** 2).sum() / (joints[:, 3:] ** 2).sum()))
