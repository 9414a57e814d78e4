"""Solution of the program at every waypoint: redundancy from the stations, pose by batched Newton steps.

The program is solved at stations of the path. Between them the joints follow exactly from the loaded pose:

    q <- q - W^-1 A^T (A W^-1 A^T)^-1 F(q),    F the pose equations, A = dF/dq in the loaded equilibrium,

Newton steps of least joint motion, for all waypoints at once. Where the pose does not determine all joints, the
redundancy is interpolated between stations. A waypoint that exceeds a limit becomes a station and the program is solved
again. Where no solution keeps all limits, stations may miss their pose, by as little as possible.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from compplan.planning.costs import Departure, MissedPose
from compplan.planning.limits import CorrectionLimit, JointRange, PoseEquation
from compplan.planning.nlp import Solution, explain_conflict, solve_problem
from compplan.planning.problem import Cost, Limit, PlanningProblem
from compplan.planning.task import (
    AT_CORRECTION,
    PlanTask,
    attain_rows,
    differentiate_equations,
    measure_correction,
    pose_equations,
)
from compplan.robot import Array
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.corners import find_corners
from compplan.toolpath.toolpath import interpolate, select_even

LOG = logging.getLogger(__name__)

#: Most stations of a path without and with redundancy; at most `STATIONS` waypoints out of reach in addition.
STATIONS, REDUNDANT_STATIONS = 100, 150
#: Pose errors: accepted, at which Newton steps stop, and accepted slack of a station. [m and rad]
KEPT, EXACT, CAN_KEEP = 1e-6, 1e-10, 1e-8
#: Most Newton steps, and most solves of the program.
STEPS, SOLVES = 6, 6
#: Most waypoints that become stations because they violate a limit; evenly selected from more.
MOST_MORE = 1500
#: Joint position difference at the stations below which positions are equal. [rad or m]
EQUAL = 1e-9
#: The same for robots with effects that depend on the complete path. [rad or m]
EQUAL_MEMORY = 1e-7


@dataclass(frozen=True)
class PathSolution:
    """Solution of the program along a path."""

    q: Array  #: Joint positions at every waypoint. Shape (n, nq). [rad or m]
    missed: Array  #: Greatest pose error of every waypoint. Shape (n,). [m, rad]
    stations: Solution  #: Last solution of the program.
    solves: int  #: Number of solves.
    iterations: int  #: Total iterations of the solver.
    cpu: float  #: Total CPU time of the program. [s]
    conflict: str = ""  #: Conflicting limits and their waypoint, "" if none.

    def describe(self) -> dict[str, object]:
        """Describe the solution for plan.json."""
        found = self.stations
        active = {name: float(np.mean(rows)) for name, rows in found.active.items()}
        return {"solver": "ipopt", "status": found.status, "stations": len(found.problem),
                "iterations": self.iterations, "cpu_s": self.cpu, "solves": self.solves, "active": active,
                **({"conflict": self.conflict} if self.conflict else {})}  # fmt: skip


def solve_path(task: PlanTask, near: Array | None = None) -> PathSolution:
    """Solve the program of a path without lost motion, and refine its solution at every waypoint.

    The initial guess is joint positions `near` (n, nq), default those of the task.
    """
    most = REDUNDANT_STATIONS if task.redundant else STATIONS
    stations, released, lost = pick_stations(task, most), task.missed.copy(), np.flatnonzero(task.missed)
    q, missed = correct_pose(task, task.q_start if near is None else near, lost)
    leaving = _find_leaving(task, q, missed, lost)
    stations = np.union1d(np.setdiff1d(stations, lost), select_even(lost, STATIONS))
    solves, iterations, cpu, memory = 0, 0, 0.0, bool(task.robot.effects)
    while solves < SOLVES:
        stations = np.union1d(stations, leaving)
        q[leaving], missed[leaving] = np.clip(task.q_start[leaving], task.robot.lower, task.robot.upper), np.inf
        if released.any() or (len(leaving) and not task.redundant):  # Newton steps found the only solution
            released[stations] = True
        solution = solve_problem(state_problem(task, stations, q, released))
        solves, iterations, cpu = solves + 1, iterations + solution.iterations, cpu + solution.cpu
        if not solution.success and not released[stations].all():
            LOG.debug("%s: all stations are released", explain_conflict(solution))
            released[stations] = True
            continue
        q, missed = fill_waypoints(task, solution, q)
        leaving = _find_leaving(task, q, missed, np.union1d(stations, lost))
        settled = not memory or np.abs(q[stations] - solution.q).max(initial=0.0) < EQUAL_MEMORY
        if settled and not len(leaving):
            break
    return PathSolution(q, missed, solution, solves, iterations, cpu, explain_conflict(solution))


def state_problem(task: PlanTask, stations: NDArray[np.int_], q: Array, released: NDArray[np.bool_]) -> PlanningProblem:
    """Build the problem that corrects a path: loaded pose within all limits, near the chosen posture.

    Args:
        task: The task.
        stations: Waypoints that are stations. Shape (k,).
        q: Initial guess of the joint positions. Shape (n, nq). [rad or m]
        released: Waypoints whose pose may be missed. Shape (n,).
    """
    robot, k = task.robot, len(stations)
    attained = attain_rows(task, q, stations, slope=False)
    lower, upper = np.tile(robot.lower, (k, 1)), np.tile(robot.upper, (k, 1))
    held = task.fixed_joints & ~task.missed[stations, None]  # a rail moves where the arm alone does not reach
    lower, upper = (np.where(held, task.q_start[stations], side) for side in (lower, upper))
    limits: list[Limit] = [PoseEquation(), JointRange()]
    if np.isfinite(task.max_correction):
        limits.append(CorrectionLimit(task.max_correction))
    free, weights = released[stations], task.joint_weights
    costs: list[Cost] = [Departure(1e-3 * weights), MissedPose()] if free.any() else [Departure(weights)]
    shift, turn = None, None
    if robot.effects:
        bias = None if task.bias is None else task.bias[stations]
        plain = attain_pose(task.chain, q[stations], task.wrench[stations], slope=False, torque_bias=bias)
        loaded = task.compensated[stations]
        position, rotation = place_pose(task, stations, attained.position, attained.rotation)
        shift = np.where(loaded[:, None], position - plain.position, 0.0)
        back = np.swapaxes(plain.rotation, 1, 2) @ rotation
        turn = np.where(loaded[:, None, None], back, np.eye(3))
    length = np.r_[0.0, np.cumsum(task.step_time)]
    position, rotation = place_pose(task, stations, task.position[stations], task.rotation[stations])
    return PlanningProblem(
        chain=task.chain, joints=robot.joint_names, waypoint=stations, position=position, rotation=rotation,
        programmed=task.position[stations], wrench=task.wrench[stations], theta=task.theta[stations],
        bias=np.zeros((k, task.chain.n_springs)) if task.bias is None else task.bias[stations],
        loaded=task.compensated[stations], q_start=task.q_start[stations], guess=q[stations], lower=lower, upper=upper,
        spin_free=task.spin_free, limits=tuple(limits), along=length[stations],
        costs=tuple(costs), shift=shift, turn=turn, released=free if free.any() else None,
    )  # fmt: skip


def place_pose(task: PlanTask, rows: NDArray[np.int_], position: Array, rotation: Array) -> tuple[Array, Array]:
    """Transform poses relative to the measured part frame to those of the model: displaced where the tool is loaded.

    rows: waypoints (k,); position: tips (k, 3) [m]; rotation: orientations (k, 3, 3).
    """
    if task.touched is None:
        return position, rotation
    turn, loaded = task.touched.displacement[:3, :3], task.compensated[rows]
    moved = position @ turn.T + task.touched.displacement[:3, 3]
    return np.where(loaded[:, None], moved, position), np.where(loaded[:, None, None], turn @ rotation, rotation)


def pick_stations(task: PlanTask, most: int) -> NDArray[np.int_]:
    """Pick at most `most` waypoints of the cut as stations: evenly in path curvature and changes of the force."""
    rows = np.flatnonzero(task.compensated)
    if len(rows) <= most:
        return rows
    bends = np.r_[0.0, find_corners(task.nominal)[1][rows[1:-1]]]
    jumps = np.linalg.norm(np.diff(task.wrench[rows, :3], axis=0), axis=1)
    share = [each / total for each in (bends, jumps) if (total := each.sum()) > 1e-9]
    density = np.r_[0.0, np.cumsum(2.0 / (len(rows) - 1) + sum(share, np.zeros(len(rows) - 1)))]
    at = np.searchsorted(density, np.linspace(0.0, density[-1], most))
    return np.asarray(rows[np.unique(np.clip(at, 0, len(rows) - 1))])


def fill_waypoints(task: PlanTask, solution: Solution, near: Array) -> tuple[Array, Array]:
    """Solve the loaded pose at every waypoint from `near` (n, nq), with the redundancy of the program at its stations.

    At waypoints out of reach the joint positions are interpolated between stations. Returns as `correct_pose`.
    """
    rows, missing, lost = solution.problem.waypoint, np.abs(solution.slack).max(axis=1) > CAN_KEEP, task.missed
    if not solution.success:  # stations once reached remain so
        missing &= size_of(miss_pose(task, near, rows)) > KEPT
    held = np.union1d(rows[missing], np.flatnonzero(lost))
    q = np.array(near)
    q[lost] = interpolate(np.flatnonzero(lost), rows, solution.q)
    q[rows[missing]] = solution.q[missing]
    q, left = correct_pose(task, q, held)
    away = solution.q - q[rows]
    if not task.redundant or np.abs(away).max() < EQUAL:
        return q, left
    length = np.r_[0.0, np.cumsum(np.maximum(task.step_time, 1e-9))]
    moved = PchipInterpolator(length[rows], away)(np.clip(length, length[rows[0]], length[rows[-1]]))
    q = np.clip(q + np.where(task.compensated[:, None], moved, 0.0), task.robot.lower, task.robot.upper)
    q[rows] = solution.q
    return correct_pose(task, q, held)


def correct_pose(task: PlanTask, q: Array, held: NDArray[np.int_]) -> tuple[Array, Array]:
    """Solve the pose equations by least-norm Newton steps of the joints inside their limits.

    q: joint positions (n, nq) [rad or m]; held: waypoints with fixed joint positions. Returns joint positions, and the
    greatest pose error of every waypoint. Shapes (n, nq) and (n,). [rad or m; m, rad]
    """
    robot, busy, ease = task.robot, np.setdiff1d(np.arange(len(q)), held), 1.0 / task.joint_weights
    q, missed = np.array(q), miss_pose(task, q)
    for _ in range(STEPS):
        busy = busy[size_of(missed[busy]) > EXACT]
        if not len(busy):
            break
        attained = attain_rows(task, q, busy)
        free = (q[busy] > robot.lower + 1e-7) & (q[busy] < robot.upper - 1e-7) & ~task.fixed_joints
        columns = differentiate_equations(task, attained, busy) * free[:, None, :]
        eased = np.swapaxes(columns, 1, 2) * ease[:, None]
        normal = columns @ eased + 1e-14 * np.eye(columns.shape[1])
        step = eased @ np.linalg.solve(normal, missed[busy, :, None])
        trial = q.copy()
        trial[busy] = np.clip(q[busy] - step[..., 0], robot.lower, robot.upper)
        left = miss_pose(task, trial, busy)
        better = size_of(left) < size_of(missed[busy])
        busy = busy[better]
        q[busy], missed[busy] = trial[busy], left[better]
        if robot.effects:  # effects with a memory depend on the complete path
            missed = miss_pose(task, q)
    return q, size_of(missed)


def miss_pose(task: PlanTask, q: Array, rows: NDArray[np.int_] | None = None) -> Array:
    """Compute the residuals of the pose equations at joint positions. Shape (k, rows). [m, rad]"""
    rows = np.arange(len(q)) if rows is None else rows
    return pose_equations(task, attain_rows(task, q, rows, slope=False), rows)


def size_of(rows: Array) -> Array:
    """Return the greatest absolute entry of every row."""
    return np.asarray(np.abs(rows).max(axis=1))


def _find_leaving(task: PlanTask, q: Array, missed: Array, stations: NDArray[np.int_]) -> NDArray[np.int_]:
    """Find waypoints other than stations that miss their pose, by an error `missed` (n,), or violate a limit."""
    # lost motion at a reversal does not violate a limit; the evaluation includes it
    away = np.zeros(len(q), bool) if task.robot.effects else missed > KEPT
    far = task.compensated & (measure_correction(task, q) > task.max_correction + AT_CORRECTION)
    outside = ((q < task.robot.lower - 1e-9) | (q > task.robot.upper + 1e-9)).any(axis=1)
    return select_even(np.setdiff1d(np.flatnonzero(away | far | outside), stations), MOST_MORE)
