"""The solution of the program at every waypoint: redundancy from the stations, pose by batched Newton steps.

The program holds the path at its stations. Between them the joints follow from the loaded pose, exactly:

    q <- q - W^-1 A^T (A W^-1 A^T)^-1 F(q),    F the pose equations, A = dF/dq in the loaded equilibrium,

Newton steps that move the joints least, for all waypoints at once. Where the pose does not
fix all joints, the choice made at the stations is interpolated. A waypoint that exceeds a limit becomes a station and
the nonlinear program is solved again. Where no solution keeps all limits, stations may miss their pose, by as little
as possible.
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
from compplan.toolpath.toolpath import interpolate, select_even

LOG = logging.getLogger(__name__)

#: Stations of a path without and with redundancy. As many of the waypoints out of reach become stations too.
STATIONS, REDUNDANT_STATIONS = 100, 150
#: Missed pose that counts as none, that Newton steps stop at, and that a station may have. [m and rad]
KEPT, EXACT, CAN_KEEP = 1e-6, 1e-10, 1e-8
#: Newton steps and solves of the program at most.
STEPS, SOLVES = 6, 6
#: Waypoints that become stations because they leave a limit at most: even ones of more.
MOST_MORE = 1500
#: Difference of joint positions at the stations that counts as none. [rad or m]
ALIKE = 1e-9
#: The same where effects of the robot depend on the whole path. [rad or m]
ALIKE_MEMORY = 1e-7


@dataclass(frozen=True)
class PathSolution:
    """The program's solution along a path."""

    q: Array  #: Joint positions at every waypoint. Shape (n, nq). [rad or m]
    stations: Solution  #: The last solution of the program.
    solves: int  #: How often the program was solved.
    iterations: int  #: Iterations of the solver in all.
    cpu: float  #: CPU time of the program in all. [s]
    conflict: str = ""  #: Which limits conflict and where, "" where none do.

    def describe(self) -> dict[str, object]:
        """Return what plan.json holds."""
        found = self.stations
        active = {name: float(np.mean(rows)) for name, rows in found.active.items()}
        return {"solver": "ipopt", "status": found.status, "stations": len(found.problem),
                "iterations": self.iterations, "cpu_s": self.cpu, "solves": self.solves, "active": active,
                **({"conflict": self.conflict} if self.conflict else {})}  # fmt: skip


def solve_path(task: PlanTask, near: Array | None = None) -> PathSolution:
    """Solve the program of a path without lost motion and take its solution to every waypoint.

    It begins at joint positions `near` (n, nq), those of the task if left out.
    """
    most = REDUNDANT_STATIONS if task.redundant else STATIONS
    stations, released, lost = pick_stations(task, most), task.missed.copy(), np.flatnonzero(task.missed)
    q = correct_pose(task, task.q_start if near is None else near, lost)
    leaving = _find_leaving(task, q, lost)
    stations = np.union1d(np.setdiff1d(stations, lost), np.r_[leaving, select_even(lost, STATIONS)])
    q[leaving] = np.clip(task.q_start[leaving], task.robot.lower, task.robot.upper)
    if released.any() or (len(leaving) and not task.redundant):  # Newton steps found the only solution there is
        released[stations] = True
    solves, iterations, cpu, memory = 0, 0, 0.0, bool(task.robot.effects)
    for last in range(1, SOLVES + 1):
        solution = solve_problem(state_problem(task, stations, q, released))
        solves, iterations, cpu = solves + 1, iterations + solution.iterations, cpu + solution.cpu
        if not solution.success and not released[stations].all():
            LOG.debug("%s: all stations are released", explain_conflict(solution))
            released[stations] = True
            continue
        q = fill_waypoints(task, solution, q)
        if len(leaving := _find_leaving(task, q, np.union1d(stations, lost))) and last < SOLVES:
            stations = np.union1d(stations, leaving)
            q[leaving] = np.clip(task.q_start[leaving], task.robot.lower, task.robot.upper)
            released[stations] = not task.redundant or released.any()
        elif not memory or np.abs(q[stations] - solution.q).max(initial=0.0) < ALIKE_MEMORY:
            break
    return PathSolution(q, solution, solves, iterations, cpu, explain_conflict(solution))


def state_problem(task: PlanTask, stations: NDArray[np.int_], q: Array, released: NDArray[np.bool_]) -> PlanningProblem:
    """State the program that corrects a path: the loaded pose within all limits, near the posture that was chosen.

    Args:
        task: The task.
        stations: Waypoints that are stations. Shape (k,).
        q: Joint positions to begin at. Shape (n, nq). [rad or m]
        released: Waypoints whose pose may be missed. Shape (n,).
    """
    robot, k = task.robot, len(stations)
    attained = attain_rows(task, q, stations, slope=False)
    lower, upper = np.tile(robot.lower, (k, 1)), np.tile(robot.upper, (k, 1))
    held = task.stays & ~task.missed[stations, None]  # where the arm alone does not reach, a rail helps
    lower, upper = (np.where(held, task.q_start[stations], side) for side in (lower, upper))
    limits: list[Limit] = [PoseEquation(), JointRange()]
    if np.isfinite(task.max_correction):
        limits.append(CorrectionLimit(task.max_correction))
    free = released[stations]
    costs: list[Cost] = [Departure(1e-3 * task.worth), MissedPose()] if free.any() else [Departure(task.worth)]
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
        spin_free=task.spin_free, axis_free=task.axis_free, limits=tuple(limits), along=length[stations],
        costs=tuple(costs), shift=shift, turn=turn, released=free if free.any() else None,
    )  # fmt: skip


def place_pose(task: PlanTask, rows: NDArray[np.int_], position: Array, rotation: Array) -> tuple[Array, Array]:
    """Return poses relative to the found part frame where the model has them: displaced where the tool is loaded.

    rows: waypoints (k,); position: tips (k, 3) [m]; rotation: orientations (k, 3, 3).
    """
    if task.touched is None or task.touched.displacement is None:
        return position, rotation
    turn, loaded = task.touched.displacement[:3, :3], task.compensated[rows]
    moved = position @ turn.T + task.touched.displacement[:3, 3]
    return np.where(loaded[:, None], moved, position), np.where(loaded[:, None, None], turn @ rotation, rotation)


def pick_stations(task: PlanTask, most: int) -> NDArray[np.int_]:
    """Pick waypoints of the cut as stations: evenly in bends of the path and changes of the force, at most so many."""
    rows = np.flatnonzero(task.compensated)
    if len(rows) <= most:
        return rows
    travel = np.diff(task.position[rows], axis=0)
    ways = travel / np.maximum(np.linalg.norm(travel, axis=1), 1e-12)[:, None]
    bends = np.r_[0.0, np.arccos(np.clip((ways[1:] * ways[:-1]).sum(axis=1), -1.0, 1.0))]
    jumps = np.linalg.norm(np.diff(task.wrench[rows, :3], axis=0), axis=1)
    share = [each / total for each in (bends, jumps) if (total := each.sum()) > 1e-9]
    density = np.r_[0.0, np.cumsum(2.0 / (len(rows) - 1) + sum(share, np.zeros(len(rows) - 1)))]
    at = np.searchsorted(density, np.linspace(0.0, density[-1], most))
    return np.asarray(rows[np.unique(np.clip(at, 0, len(rows) - 1))])


def fill_waypoints(task: PlanTask, solution: Solution, near: Array) -> Array:
    """Solve the loaded pose at every waypoint from `near` (n, nq), with the choice of the program at its stations.

    Out of reach joint positions between stations are interpolated.
    """
    rows, missing, lost = solution.problem.waypoint, np.abs(solution.slack).max(axis=1) > CAN_KEEP, task.missed
    if not solution.success:  # stations that have been reached stay so
        missing &= size_of(miss_pose(task, near, rows)) > KEPT
    held = np.union1d(rows[missing], np.flatnonzero(lost))
    q = np.array(near)
    q[lost] = interpolate(np.flatnonzero(lost), rows, solution.q)
    q[rows[missing]] = solution.q[missing]
    q = correct_pose(task, q, held)
    away = solution.q - q[rows]
    if not task.redundant or np.abs(away).max() < ALIKE:
        return q
    length = np.r_[0.0, np.cumsum(np.maximum(task.step_time, 1e-9))]
    moved = PchipInterpolator(length[rows], away)(np.clip(length, length[rows[0]], length[rows[-1]]))
    q = np.clip(q + np.where(task.compensated[:, None], moved, 0.0), task.robot.lower, task.robot.upper)
    q[rows] = solution.q
    return correct_pose(task, q, held)


def correct_pose(task: PlanTask, q: Array, held: NDArray[np.int_]) -> Array:
    """Bring the pose equations to nothing by least-norm Newton steps of the joints that are off their limits.

    q: joint positions (n, nq) [rad or m]; held: waypoints that keep theirs.
    """
    robot, busy, ease = task.robot, np.setdiff1d(np.arange(len(q)), held), 1.0 / task.worth
    missed = miss_pose(task, q, busy)
    for _ in range(STEPS):
        busy = busy[size_of(missed) > EXACT]
        if not len(busy):
            break
        attained = attain_rows(task, q, busy)
        missed = pose_equations(task, attained, busy)
        free = (q[busy] > robot.lower + 1e-7) & (q[busy] < robot.upper - 1e-7) & ~task.stays
        columns = differentiate_equations(task, attained, busy) * free[:, None, :]
        eased = np.swapaxes(columns, 1, 2) * ease[:, None]
        normal = columns @ eased + 1e-14 * np.eye(columns.shape[1])
        step = eased @ np.linalg.solve(normal, missed[..., None])
        trial = q.copy()
        trial[busy] = np.clip(q[busy] - step[..., 0], robot.lower, robot.upper)
        left = miss_pose(task, trial, busy)
        worse = size_of(left) >= size_of(missed)
        trial[busy[worse]] = q[busy[worse]]
        q, busy, missed = trial, busy[~worse], left[~worse]
        if task.robot.effects and worse.any():  # effects with a memory see the whole path
            missed = miss_pose(task, q, busy)
    return q


def miss_pose(task: PlanTask, q: Array, rows: NDArray[np.int_] | None = None) -> Array:
    """Return by how much joint positions miss the pose equations. Shape (k, rows). [m, rad]"""
    rows = np.arange(len(q)) if rows is None else rows
    return pose_equations(task, attain_rows(task, q, rows, slope=False), rows)


def size_of(rows: Array) -> Array:
    """Return the greatest entry of every row."""
    return np.asarray(np.abs(rows).max(axis=1))


def _find_leaving(task: PlanTask, q: Array, stations: NDArray[np.int_]) -> NDArray[np.int_]:
    """Find waypoints beside the stations that miss their pose or leave a limit."""
    missed = size_of(miss_pose(task, q)) > KEPT
    if task.robot.effects:
        missed[:] = False  # lost motion at a reversal is no matter of limits: the evaluation sees the tip
    far = task.compensated & (measure_correction(task, q) > task.max_correction + AT_CORRECTION)
    outside = ((q < task.robot.lower - 1e-9) | (q > task.robot.upper + 1e-9)).any(axis=1)
    return select_even(np.setdiff1d(np.flatnonzero(missed | far | outside), stations), MOST_MORE)
