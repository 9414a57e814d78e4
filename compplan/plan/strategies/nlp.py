"""Compensation by one nonlinear program over the whole path: exact where it can be, within all limits, and smooth.

Passes of Newton's method: the deflections are linearised where the last pass stood, and `compplan.plan.nlp` solves for
all waypoints at once. A first pass knows the pose equations alone, and `compplan.plan.banded` solves it. Waypoints at
which a pass leaves a limit are tried one by one: where the limits can be kept, they enter the program; where they
cannot, the waypoint fails, and stands in the next pass as near to the path as the limits allow.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.plan.banded import step_banded
from compplan.plan.nlp import Nlp, NlpSolution, build_nlp, solve_nlp
from compplan.plan.path_problem import ANCHOR_WEIGHT, PathProblem, ProgramRows, smoothness_matrix
from compplan.plan.strategies.compromise import find_compromise
from compplan.plan.strategies.equations import differentiate_equations, pose_equations
from compplan.plan.strategies.limits import (
    AT_CORRECTION,
    OUT_OF_REACH,
    check_limits,
    measure_correction,
    name_failures,
)
from compplan.plan.strategies.lost_motion import lead_play, list_plays, without_play
from compplan.plan.task import Command, PlanTask, attain_rows
from compplan.robot import Array
from compplan.statics.sensitivity import AttainedPose

words = "optimised (nlp)"

#: Passes at most; of a path that is out of reach in parts, which no pass can mend: the rest is polished all the same.
MOST_PASSES, LOST_PASSES = 10, 2
#: Passes in which rate rows are added; what still exceeds a rate then has its feed lowered.
RATE_PASSES = 2
#: Missed pose equations that count as kept. [m and rad]
KEPT = 1e-6
#: A waypoint that misses them by less when it is tried by itself can keep them, and goes back into the program.
CAN_KEEP = 1e-8
#: What Newton steps alone bring down to nothing. [m and rad]
NEARLY = 1e-4
#: What counts as nothing. [m and rad]
EXACT = 1e-10
#: A joint that starts this near to a limit is watched, and so are this many neighbours of a waypoint that leaves one.
NEAR_LIMIT, NEAR_WAYPOINTS = 0.02, 5
#: Greatest change of a joint in a banded step that counts as settled, and that is believed (assumed). [rad or m]
STILL, FARTHEST = 1e-6, 0.5
#: Hold on the start against the pull of smoothness, and the greatest correction that is reckoned with. [1, rad or m]
HOLD, MOST_STEP = 2.0, 0.1


@dataclass(frozen=True)
class _Iterate:
    """Where the passes stand: joint positions, rows of the next program, the last program, what was solved."""

    q: Array
    rows: ProgramRows
    attained: AttainedPose | None = None
    nlp: Nlp | None = None
    solutions: tuple[NlpSolution, ...] = ()
    rate_passes: int = 0
    settled: bool = False


def command_path(task: PlanTask) -> Command:
    """Solve for the joint positions whose loaded tool stands on the path.

    Waypoints that cannot be reached within the limits make the status "infeasible"; they are named, and the command
    misses the path there by as little as the limits allow.
    """
    real, task = task, without_play(task)
    if (plain := solve_plain(task)) is not None:
        return _finish(real, task.problem, plain.q, plain)
    attained = attain_rows(task, task.q_start, np.arange(len(task)))
    problem = hold_start(task, attained)
    near = np.minimum(task.q_start - problem.lower, problem.upper - task.q_start) < NEAR_LIMIT
    state = _Iterate(task.q_start, ProgramRows(near), attained)
    state = _try_waypoints(task, state, np.flatnonzero(task.missed))
    for _ in range(LOST_PASSES if task.missed.any() else MOST_PASSES):
        state = _solve_pass(task, problem, state)
        state = _review(task, problem, state)
        if state.settled and _size(_missed(task, problem, state.q), state.rows.released).max() < NEARLY:
            break
    q = _polish(task, problem, state.q, state.rows.released)
    facts = {"passes": len(state.solutions), "rate_rows": len(state.rows.velocity) + len(state.rows.acceleration)}
    spent = sum(solution.time for solution in state.solutions)
    return _finish(real, problem, q, Command(q, solve_time=spent, solutions=state.solutions, facts=facts))


def solve_plain(task: PlanTask) -> Command | None:
    """Command a path that leaves the joints no choice by mirroring alone; None where it does, or a limit is in the way.

    The pose equations of a waypoint then have one answer: mirroring what is missed through the exact derivative of the
    loaded equilibrium, again and again, comes to the answer of the program.
    """
    problem = task.problem
    if problem.redundant or task.missed.any():
        return None
    q = _polish(task, problem, task.q_start, np.zeros(0, int))
    far = problem.compensated & (measure_correction(task, q) > problem.max_correction)
    if far.any() or _size(_missed(task, problem, q)).max() > EXACT:
        return None
    return Command(q, facts={"passes": 0, "rate_rows": 0, "plain": True})


def correct_command(task: PlanTask, command: Command) -> Command:
    """Bring a command up to date after a small change of the wrench, by Newton steps that move the joints least.

    Args:
        task: The task with its new wrench.
        command: A command for another wrench; waypoints that fail in it are brought as near as the limits allow.

    """
    q, failing = np.array(command.facts.get("links", command.q)), np.array(sorted(command.failures), int)
    real, task = task, without_play(task)
    if len(failing):
        q[failing] = find_compromise(task, q, failing)
    return _finish(real, task.problem, _polish(task, task.problem, q, failing), command)


def _finish(task: PlanTask, problem: PathProblem, q: Array, command: Command) -> Command:
    """Lead lost motion, and name the waypoints that miss the pose equations or leave a limit; q: of the links."""
    missed = _size(_missed(without_play(task), problem, q))
    failures = name_failures(task, q, np.flatnonzero(missed > KEPT))
    if list_plays(task.robot).any():
        command = replace(command, facts={**command.facts, "links": q})
        q = q + lead_play(task, q)
    if task.robot.effects:
        # what no command can mend, such as lost motion at a reversal, is no matter of reach: the judge sees the tip
        failures = {k: name for k, name in failures.items() if name != OUT_OF_REACH or task.missed[k]}
    failures |= check_limits(replace(task, missed=np.zeros_like(task.missed)), q).failures
    return replace(command, q=q, status="infeasible" if failures else "solved", failures=failures)


def hold_start(task: PlanTask, attained: AttainedPose) -> PathProblem:
    """State the program, its hold on q_start firm enough for Gauss-Newton steps to converge.

    The Hessian leaves out the curvature of the pose equations. Along the free rotation it is worth as much as the pull
    of smoothness on the correction, so the hold is no weaker: where that is rough, the rotation moves less.
    """
    problem, every = task.problem, np.arange(len(task))
    columns = differentiate_equations(problem, attained, every) * ~problem.stays
    normal = columns @ np.swapaxes(columns, 1, 2) + 1e-6 * np.eye(columns.shape[1])
    step = np.swapaxes(columns, 1, 2) @ np.linalg.solve(normal, pose_equations(problem, attained, every)[..., None])
    correction = np.clip(-step[..., 0], -MOST_STEP, MOST_STEP)
    smooth = smoothness_matrix(problem)
    bent = correction if problem.keeps_shape else task.q_start + correction
    pull = np.abs(smooth.T @ (smooth @ bent)).max(axis=1)
    return replace(problem, hold=np.maximum(ANCHOR_WEIGHT, _spread_most(HOLD * pull, 2 * NEAR_WAYPOINTS)))


def find_fast_rows(problem: PathProblem, q: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Find pairs (waypoint, joint) beyond a velocity or acceleration limit at the programmed feed, and neighbours.

    Short steps do not count: they stand beside rests, where the feed drops anyway.
    """
    short = 0.5 * float(np.median(problem.step_time[problem.step_time > 0], axis=0)) if problem.step_time.any() else 0.0
    within = problem.compensated[1:] & problem.compensated[:-1] & (problem.step_time > short)
    h = np.maximum(problem.step_time, 1e-9)
    velocity = np.diff(q, axis=0) / h[:, None]
    acceleration = np.diff(velocity, axis=0) / (0.5 * (h[1:] + h[:-1]))[:, None]
    both = (within[1:] & within[:-1])[:, None]
    fast = _widen((np.abs(velocity) > problem.velocity_limits) & within[:, None]) & within[:, None]
    hard = _widen((np.abs(acceleration) > problem.acceleration_limits) & both) & both
    return np.argwhere(fast), np.argwhere(hard) + np.array([1, 0])


def _try_waypoints(task: PlanTask, state: _Iterate, suspects: NDArray[np.int_]) -> _Iterate:
    """Try suspects one by one: those that cannot keep the limits are released and stay where they do best."""
    if not len(suspects):
        return state
    q = state.q.copy()
    q[suspects] = find_compromise(task, q, suspects)
    missed = _size(pose_equations(task.problem, attain_rows(task, q, suspects, slope=False), suspects))
    failing = suspects[missed > CAN_KEEP]
    rows = state.rows
    bounded = rows.bounded | _widen(np.isin(np.arange(len(q)), suspects))[:, None]
    rows = replace(rows, bounded=bounded, released=np.union1d(rows.released, failing).astype(int))
    return replace(state, q=q, rows=rows, attained=None)


def _solve_pass(task: PlanTask, problem: PathProblem, state: _Iterate) -> _Iterate:
    """Linearise and solve; where the solver finds no way, drop the rate rows, then try every waypoint by itself."""
    if state.rows.free and problem.redundant and (free := _solve_free(task, problem, state)) is not None:
        return replace(state, q=free.q, attained=None, solutions=(*state.solutions, free))
    nlp = state.nlp
    if nlp is None or not state.rows.same_program(nlp.rows):
        nlp = build_nlp(problem, state.rows)
    attained = state.attained or attain_rows(task, state.q, np.arange(len(task)))
    solution = solve_nlp(nlp, state.q, attained, bounded=state.rows.bounded)
    state = replace(state, nlp=nlp, attained=None, solutions=(*state.solutions, solution))
    if solution.success:
        return replace(state, q=solution.q)
    if len(state.rows.velocity) + len(state.rows.acceleration):
        none = np.zeros((0, 2), int)
        rows = replace(state.rows, velocity=none, acceleration=none)
        return replace(state, rows=rows, rate_passes=RATE_PASSES)
    every = np.setdiff1d(np.arange(len(state.q)), state.rows.released)
    return _try_waypoints(task, state, every)


def _solve_free(task: PlanTask, problem: PathProblem, state: _Iterate) -> NlpSolution | None:
    """Solve the program without its limits, by banded steps; None where they do not settle or leave a joint's range."""
    q, attained, clock, every, none = state.q, state.attained, time.perf_counter(), np.arange(len(task)), np.zeros(0)
    for count in range(1, MOST_PASSES + 1):
        attained = attained or attain_rows(task, q, every)
        missed = pose_equations(problem, attained, every)
        found = step_banded(problem, q, missed, differentiate_equations(problem, attained, every))
        if found is None or (change := float(np.abs(found - q).max())) > FARTHEST:
            return None
        q, attained = found, None
        if change < STILL:
            outside = ((q < problem.lower) | (q > problem.upper)) & state.rows.bounded
            spent, left = time.perf_counter() - clock, float(_size(missed).max())
            return None if outside.any() else NlpSolution(q, True, "banded", count, spent, left, none, none)
    return None


def _review(task: PlanTask, problem: PathProblem, state: _Iterate) -> _Iterate:
    """Decide the rows of the next pass: limits that this one left, rates that it exceeds."""
    outside = ((state.q < problem.lower - 1e-9) | (state.q > problem.upper + 1e-9)).any(axis=1)
    too_far = problem.compensated & (measure_correction(task, state.q) > problem.max_correction + AT_CORRECTION)
    suspects = np.setdiff1d(np.flatnonzero(outside | too_far), state.rows.released)
    if len(suspects):
        tried = _try_waypoints(task, state, suspects)
        near = np.flatnonzero(_widen(too_far) & problem.compensated) if problem.redundant else np.zeros(0, int)
        limited = np.setdiff1d(np.union1d(tried.rows.limited, near), tried.rows.released).astype(int)
        return replace(tried, rows=replace(tried.rows, limited=limited), settled=False)
    if not state.solutions[-1].success:
        return replace(state, settled=False)
    if not problem.redundant or state.rate_passes >= RATE_PASSES:
        return replace(state, settled=True)
    velocity, acceleration = find_fast_rows(problem, state.q)
    velocity, acceleration = _join(state.rows.velocity, velocity), _join(state.rows.acceleration, acceleration)
    rows = replace(state.rows, velocity=velocity, acceleration=acceleration)
    return replace(state, rows=rows, rate_passes=state.rate_passes + 1, settled=rows.same_program(state.rows))


def _polish(task: PlanTask, problem: PathProblem, q: Array, held: NDArray[np.int_]) -> Array:
    """Bring the pose equations down to nothing by least-norm Newton steps of the joints that stand off their limits."""
    busy = np.setdiff1d(np.arange(len(q)), held)
    missed = _missed(task, problem, q, busy)
    for _ in range(6):
        busy = busy[_size(missed) > EXACT]
        if not len(busy):
            break
        attained = attain_rows(task, q, busy)
        missed = pose_equations(problem, attained, busy)
        free = (q[busy] > problem.lower + 1e-7) & (q[busy] < problem.upper - 1e-7) & ~problem.stays
        columns = differentiate_equations(problem, attained, busy) * free[:, None, :]
        normal = columns @ np.swapaxes(columns, 1, 2) + 1e-14 * np.eye(columns.shape[1])
        step = np.swapaxes(columns, 1, 2) @ np.linalg.solve(normal, missed[..., None])
        trial = q.copy()
        trial[busy] = np.clip(q[busy] - step[..., 0], problem.lower, problem.upper)
        left = _missed(task, problem, trial, busy)
        worse = _size(left) >= _size(missed)
        trial[busy[worse]] = q[busy[worse]]
        q, busy, missed = trial, busy[~worse], left[~worse]
        if task.robot.effects and worse.any():  # effects with a memory see the whole path
            missed = _missed(task, problem, q, busy)
    return q


def _missed(task: PlanTask, problem: PathProblem, q: Array, rows: NDArray[np.int_] | None = None) -> Array:
    rows = np.arange(len(q)) if rows is None else rows
    return pose_equations(problem, attain_rows(task, q, rows, slope=False), rows)


def _size(rows: Array, without: NDArray[np.int_] | None = None) -> Array:
    size = np.abs(rows).max(axis=1)
    if without is not None:
        size[without] = 0.0
    return np.asarray(size)


def _widen(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the neighbours along the path too."""
    return _spread_most(marked, NEAR_WAYPOINTS) if marked.any() else marked


def _spread_most(values: NDArray[Any], reach: int) -> NDArray[Any]:
    """Return the greatest of the values within a reach of rows."""
    most = values.copy()
    for away in range(1, min(reach, len(values) - 1) + 1):
        np.maximum(most[away:], values[:-away], out=most[away:])
        np.maximum(most[:-away], values[away:], out=most[:-away])
    return most


def _join(old: NDArray[np.int_], new: NDArray[np.int_]) -> NDArray[np.int_]:
    return np.unique(np.vstack([old, new]), axis=0) if len(new) else old
