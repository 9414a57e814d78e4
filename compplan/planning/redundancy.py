"""Optimise spin, tilts, extra axes, offset within the tolerance (tube) and speed of a path by a nonlinear program.

The posture search provides the discrete choice and the initial guess. Variables: joints and speed at the stations (a
subset of the waypoints). Cost: time, widest 95 % band, joint motion. Constraint: pose under load. Spin, tilts and
offsets are then interpolated to all waypoints.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from compplan.errors import ConvergenceError
from compplan.planning.costs import Band, JointTravel, Smoothness, Time
from compplan.planning.costs.band import measure_deflection
from compplan.planning.dense import place_pose
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.limits import AccelerationLimit, JointRange, PoseEquation, VelocityLimit
from compplan.planning.limits.clearance import linearise_clearance
from compplan.planning.limits.torque import read_torques
from compplan.planning.nlp import Solution, solve_problem
from compplan.planning.posture.clearance import sweep_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.planning.posture.follow import find_jumps_along
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.start import build_start
from compplan.planning.posture.summary import PostureSummary, Start, summarise_costs
from compplan.planning.problem import Cost, Limit, PlanningProblem
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CLOSE, reach_pose
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.contact import path_axes, turn_about_axis
from compplan.toolpath.corners import find_corners
from compplan.toolpath.toolpath import divide_toolpath, interpolate
from compplan.uncertainty.sensitivities import ForceSpread

LOG = logging.getLogger(__name__)

#: Most stations, and most waypoints of which all are stations, without and with a tube.
STATIONS, FEW, FEW_IN_TUBE = 150, 300, 600
#: Reference motion of a revolute and a prismatic joint. [rad, m]
UNIT_TURN, UNIT_SLIDE = 0.3, 0.2
#: Initial guess of the squared speed, as a share of that of a known run: inside the limits.
BEGIN = 0.8
#: Most solves of the program with a collision scene, clearance added between stations, and least share of a step
#: before distances are linearised again. [1, m, 1]
CLEARANCE_SOLVES, RESERVE, LEAST_SHARE = 6, 1e-3, 0.05


class CostWeights(NamedTuple):
    """Weights of the costs, relative to the time as a share of the reference run's time."""

    band: float = 0.3  #: Of the mean square deflection by inertia, relative to the greatest of the reference run.
    motion: float = 2e-3  #: Of joint motion in reference motions.
    smooth: float = 0.3  #: Of the mean square of q'' / a_max.


class ReferenceRun(NamedTuple):
    """Reference quantities of the program, from a reference run."""

    time: float  #: Time along the runs, without smoothing. [s]
    deflection: float  #: Greatest quasi-static displacement of the tip by inertia. [m]
    #: Time at each waypoint of a run of the start: initial guess of the speed. Shape (n,). [s]
    passing: Array


class FreeCoordinates(NamedTuple):
    """Free coordinates at the stations of a task."""

    rows: NDArray[np.int_]  #: Waypoints that are stations. Shape (k,).
    names: tuple[str, ...]  #: "spin", "lead", "lean", names of extra axes, and "left", "up" of a tube.
    frame: Array  #: Axes of the path at the stations, as columns. Shape (k, 3, 3).
    room: Array  #: Allowed error of each row of the pose. Shape (k, 5). [m, rad]


@dataclass(frozen=True)
class PathRequest:
    """Requirements on a redundant path."""

    problem: PostureProblem  #: Posture search along the path with its programmed tool axis.
    force: ForceSpread  #: Uncertainty of the force.
    state: Callable[[Start], PlanTask]  #: Builds the task of a start.
    tube: float = 0.0  #: Allowed offset from the path, as a share of the tolerance.

    def time(self, task: PlanTask) -> float:
        """Compute the time of the fastest run of a task, its starts resolved; infinite if none keeps the limits. [s]"""
        try:
            task = resolve_starts(task)
            return float(time_run(task, task.q_start)[1].time[-1])
        except ConvergenceError:
            return np.inf


def find_free(task: PlanTask, posture_choice: PostureSummary, request: PathRequest) -> FreeCoordinates | None:
    """Find the free coordinates of a posture; None if there are none, or the path has no run to optimise."""
    settings, arm, nominal = posture_choice.settings, request.problem.arm, request.problem.nominal
    leans = {"lead": settings.lead, "lean": settings.lean}
    names = [*(["spin"] if settings.free_spin else []), *(name for name, most in leans.items() if most > 0.0)]
    rows = _pick_rows(task, FEW_IN_TUBE if request.tube > 0.0 else FEW)
    inside = task.cut.copy()  # no offset at rest
    inside[[end for run in task.runs for end in run]] = False
    across = request.tube * task.tolerance / np.sqrt(2.0) * inside[rows]  # equal shares of the square for both sides
    names += [*(task.robot.joint_names[j] for j in arm.held), *(("left", "up") if across.any() else ())]
    if not names or len(arm.arm) != 6 or len(rows) < 3 or not settings.free_spin:
        return None
    room = np.column_stack([0.0 * across, across, across,
                            *(np.full(len(rows), np.sin(most)) for most in leans.values())])  # fmt: skip
    return FreeCoordinates(rows, tuple(names), path_axes(divide_toolpath(nominal, task.origin[rows])), room)


def state_problem(
    task: PlanTask, free: FreeCoordinates, weights: CostWeights, reference: ReferenceRun
) -> PlanningProblem:
    """Build the problem of posture and speed.

    Args:
        task: The task at the start of the posture search.
        free: Free coordinates.
        weights: Weights of the costs.
        reference: Reference time and deflection.
    """
    rows, robot = free.rows, task.robot
    k = len(rows)
    along = np.r_[0.0, np.cumsum(task.step_time)][rows]
    place = {row: number for number, row in enumerate(rows.tolist())}
    runs = tuple((place[a], place[b]) for a, b in task.runs
                 if a in place and b in place and place[b] - place[a] >= 2)  # fmt: skip
    room = np.minimum(
        0.0 if task.start is None else robot.room(task.start.settings.limit_margin),
        np.minimum(task.q_start[rows] - robot.lower, robot.upper - task.q_start[rows]).min(axis=0),
    )
    room = np.maximum(room, 0.0)  # distance from the limits, at most that of the start
    bias = np.zeros((k, task.chain.n_springs))
    attained = attain_pose(task.chain, task.q_start[rows], task.wrench[rows], slope=False)
    most = np.where(np.isfinite(task.acceleration_limits), task.acceleration_limits, 20.0 * task.velocity_limits)
    limits: list[Limit] = [PoseEquation(free.room), JointRange(), VelocityLimit(task.velocity_limits),
                           AccelerationLimit(most)]  # fmt: skip
    unit = np.where(robot.prismatic, UNIT_SLIDE, UNIT_TURN)
    costs: list[Cost] = [
        Time(1.0, reference.time),
        JointTravel(weights.motion, unit),
        Smoothness(weights.smooth / max(float(along[-1] - along[0]), 1e-9), most),
    ]
    if task.torque_limits and (efforts := read_torques(task)) is not None:
        limits.append(efforts)
    if weights.band and reference.deflection > 0.0:
        deflection = measure_deflection(task, task.q_start[rows]) / reference.deflection
        costs.append(Band(weights.band / max(float(along[-1] - along[0]), 1e-9), deflection))
    position, frame = place_pose(task, rows, task.position[rows], free.frame)
    return PlanningProblem(
        chain=task.chain, joints=robot.joint_names, waypoint=rows, position=position, rotation=frame,
        wrench=task.wrench[rows], bias=bias, theta=attained.theta if attained.theta is not None else bias,
        loaded=np.ones(k, bool), q_start=task.q_start[rows], guess=task.q_start[rows],
        lower=np.tile(robot.lower + room, (k, 1)), upper=np.tile(robot.upper - room, (k, 1)), spin_free=True,
        axis_free=False, limits=tuple(limits), costs=tuple(costs), along=along, runs=runs,
        square=BEGIN * np.minimum(np.gradient(along, reference.passing[rows]), 1.0) ** 2,
    )  # fmt: skip


def shape_start(
    task: PlanTask, start: Start, request: PathRequest, weights: CostWeights, reference: ReferenceRun
) -> Start | None:
    """Solve the program of posture and speed from the start of a task; None if nothing is free or feasible."""
    posture_choice, settings = start.posture_choice, start.settings
    if posture_choice is None or task.missed.any():
        return None
    if (free := find_free(task, posture_choice, request)) is None:
        return None
    problem = state_problem(task, free, weights, reference)
    scene, clear = settings.scene, problem.q_start
    found, iterations = None, 0
    for _ in range(1 if scene is None else CLEARANCE_SOLVES):
        if scene is not None:
            rows = linearise_clearance(scene, clear, settings.clearance, RESERVE)
            kept = tuple(limit for limit in problem.limits if limit.name != rows.name)
            problem = replace(problem, limits=(*kept, rows), guess=clear)
        solution = solve_problem(problem)
        iterations += solution.iterations
        LOG.debug("posture and speed: %s, %d iterations, %.2f s CPU, time %.4f s beside %.4f", solution.status,
                  solution.iterations, solution.cpu, solution.time, reference.time)  # fmt: skip
        if solution.violation > CLOSE:
            return None
        found = _follow(task, posture_choice, request, free, solution, settings)
        if scene is None or found is None or _keeps_clear(scene, found.q, settings.clearance):
            break
        share, found = 1.0, None  # linearise again between old and new solution, where the arm is still clear
        while share > LEAST_SHARE and not _keeps_clear(scene, clear + share * (solution.q - clear), settings.clearance):
            share *= 0.5
        clear = clear + share * (solution.q - clear)
    facts = {**(start.program or {}), "free": list(free.names), "steps": iterations}
    return None if found is None else replace(found, program=facts)


def _follow(
    task: PlanTask, posture_choice: PostureSummary, request: PathRequest, free: FreeCoordinates, solution: Solution,
    settings: PostureSettings,
) -> Start | None:  # fmt: skip
    """Interpolate the free coordinates of a solution to every waypoint; None if a joint jumps or leaves its range."""
    arm, nominal = request.problem.arm, request.problem.nominal
    place, every, nq = task.origin[free.rows], np.arange(len(nominal)), task.robot.nq
    moved, room, path = solution.q - task.q_start[free.rows], free.room[:, :3], nominal
    if room.any():  # with a tube: offset of the loaded tip
        tip = task.to_part_frame_pose(attain_pose(task.chain, solution.q, task.wrench[free.rows], slope=False)).position
        local = (np.swapaxes(free.frame, 1, 2) @ (tip - task.position[free.rows])[..., None])[..., 0]
        moved = np.hstack([moved, np.clip(local, -room, room)])
    spread = CubicSpline(place, moved, bc_type="natural")(np.clip(every, place[0], place[-1]))
    axes, offset = path_axes(nominal), None
    if room.any():
        inside = interpolate(every, place, room)
        offset = (axes @ np.clip(spread[:, nq:], -inside, inside)[..., None])[..., 0]
        path = replace(nominal, position=nominal.position + offset)
    q = posture_choice.q + spread[:, :nq]
    turned = locate_frames(arm.chain, q).tcp_rotation
    most = np.sin([settings.lead, settings.lean])
    leans = np.clip((np.swapaxes(axes, 1, 2) @ -turned[:, :, 2, None])[:, :2, 0], -most, most)
    normal = np.sqrt(1.0 - (leans**2).sum(axis=1, keepdims=True))
    rotation = turn_about_axis(turned[:, :, 0], (axes @ np.hstack([leans, normal])[..., None])[..., 0])
    q, reached = reach_pose(arm, q, path.position, rotation)
    jumps = find_jumps_along(q, nominal, settings.most_step).any()
    if not reached.all() or jumps:
        LOG.debug("posture and speed: not followed (reached %d, torn %s)", reached.sum(), jumps)
        return None
    x, y, before = rotation[:, :, 0], rotation[:, :, 1], posture_choice.rotation[:, :, 0]
    spin = posture_choice.spin + np.unwrap(np.arctan2((before * y).sum(axis=1), (before * x).sum(axis=1)))
    angles = leans * np.arccos(normal) / np.maximum(np.sqrt(1.0 - normal**2), 1e-12)
    costs = summarise_costs(replace(request.problem, settings=settings), q)
    better = replace(
        posture_choice, q=q, rotation=rotation, costs=costs, spin=spin, lead=angles[:, 0], lean=angles[:, 1]
    )
    return replace(build_start(better, path, settings), offset=offset)


def _keeps_clear(scene: CollisionScene, q: Array, wanted: float) -> bool:
    """Return whether the arm keeps the clearance along a joint motion."""
    places = np.arange(0.0, len(q), max(len(q) // STATIONS, 1))
    return bool(sweep_margin(scene, q, wanted, places)[1].min() >= 0.0)


def _pick_rows(task: PlanTask, few: int) -> NDArray[np.int_]:
    """Pick waypoints of the runs of a cut: all if few, otherwise evenly in time and path curvature, with the ends."""
    time, chosen = np.r_[0.0, np.cumsum(task.step_time)], list[NDArray[np.int_]]()
    runs = [run for run in task.runs
            if run[1] - run[0] >= 2 and time[run[1]] > time[run[0]]]  # fmt: skip
    if not runs:
        return np.zeros(0, int)
    count, total = sum(last - first + 1 for first, last in runs), sum(time[last] - time[first] for first, last in runs)
    angle = find_corners(task.nominal)[1][:-1]
    density = np.r_[0.0, np.cumsum(task.step_time / total + angle / max(float(angle.sum()), 1e-9))]
    for first, last in runs:
        own = density[first : last + 1] - density[first]
        most = max(int(STATIONS * own[-1] / 2.0), 3)
        at = np.arange(last - first + 1) if count <= few else np.searchsorted(own, np.linspace(0.0, own[-1], most))
        found = np.unique(np.r_[first, first + np.clip(at, 0, last - first), last])
        chosen.append(found[np.r_[True, np.diff(time[found]) > 1e-6 * total]])
    return np.unique(np.concatenate(chosen))
