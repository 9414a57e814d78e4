"""Compensation by one nonlinear program over the whole path: exact where it can be, within all limits, and smooth.

Passes of Newton's method: the deflections are linearised where the last pass stood, and `compplan.nlp` solves for all
waypoints at once. A first pass knows the pose equations alone; rows of limits enter where a pass leaves a limit. There
the pose equations are released, at a high cost, until a pass shows that they can be kept; where they cannot, the
waypoint fails, and the command is the best compromise within the limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.chain import joint_jacobian, locate_frames
from compplan.nlp import Nlp, NlpSolution, PathProblem, Rows, build_nlp, solve_nlp
from compplan.robot import Array
from compplan.sensitivity import AttainedPose, chunk_rows
from compplan.strategies.limits import AT_CORRECTION, judge_limits, measure_correction, name_failures
from compplan.task import Command, PlanTask, attain

MOST_PASSES = 12
#: Passes in which rate rows are added; what still exceeds a rate then has its feed lowered.
RATE_PASSES = 2
#: Missed pose equations that count as kept. [m and rad]
KEPT = 1e-6
#: What Newton steps alone bring down to nothing. [m and rad]
NEARLY = 1e-4
#: What counts as nothing. [m and rad]
EXACT = 1e-10
#: A joint that starts this near to a limit, or a waypoint this near to one that leaves a limit, is watched.
NEAR_LIMIT, NEAR_WAYPOINTS = 0.02, 5


@dataclass(frozen=True)
class _State:
    """Where the passes stand."""

    q: Array
    rows: Rows
    nlp: Nlp | None = None
    solutions: tuple[NlpSolution, ...] = ()
    rate_passes: int = 0


def command_path(task: PlanTask) -> Command:
    """Solve for the joint positions whose loaded tool stands on the path.

    Waypoints that cannot be reached within the limits make the status "infeasible"; they are named, and the command
    misses the path there by as little as the limits allow.
    """
    problem = task.problem
    state = _State(task.q_start, _first_rows(task))
    for _ in range(MOST_PASSES):
        state = _solve_pass(task, problem, state)
        rows, rate_passes = _review(task, problem, state)
        settled = rows.same_program(state.rows) and np.array_equal(rows.bounded, state.rows.bounded)
        attained = attain(task, state.q)
        missed = _size(pose_equations(problem, state.q, attained))
        missed[rows.released] = 0.0
        state = replace(state, rows=rows, rate_passes=rate_passes)
        if settled and missed.max() < NEARLY:
            break
    q = _polish(task, problem, state, attained)
    missed = _size(pose_equations(problem, q, attain(task, q)))
    failures = name_failures(task, q, np.flatnonzero(missed > KEPT))
    left = judge_limits(replace(task, missed=np.zeros_like(task.missed)), q)
    failures |= left.failures
    facts = {"passes": len(state.solutions), "rate_rows": len(state.rows.velocity) + len(state.rows.acceleration)}
    spent = sum(solution.time for solution in state.solutions)
    return Command(q, "infeasible" if failures else "solved", failures, spent, state.solutions, facts)


def pose_equations(problem: PathProblem, q: Array, attained: AttainedPose) -> Array:
    """Tell by how much joint positions miss the pose equations: tip, tool axis (and spin); (n, 5 or 6) [m, rad]."""
    position, rotation = _reached(problem, q, attained)[:2]
    missed = [position - problem.position]
    x, y = problem.rotation[:, :, 0], problem.rotation[:, :, 1]
    pairs = [(x, rotation[:, :, 2]), (y, rotation[:, :, 2])] + ([] if problem.spin_free else [(y, rotation[:, :, 0])])
    missed += [np.einsum("ni,ni->n", a, b)[:, None] for a, b in pairs]
    return np.hstack(missed)


def _first_rows(task: PlanTask) -> Rows:
    """Watch joints that start near a limit; release waypoints that the arm does not reach."""
    near = np.minimum(task.q_start - task.robot.lower, task.robot.upper - task.q_start) < NEAR_LIMIT
    released = np.flatnonzero(task.missed)
    bounded = near | task.missed[:, None]
    return Rows(bounded, released=released)


def _solve_pass(task: PlanTask, problem: PathProblem, state: _State) -> _State:
    """Linearise, solve, and release everything where the solver finds no way."""
    attained = attain(task, state.q)
    nlp = (
        state.nlp
        if state.nlp is not None and state.rows.same_program(state.nlp.rows)
        else build_nlp(problem, state.rows)
    )
    solution = solve_nlp(nlp, state.q, attained, bounded=state.rows.bounded)
    solutions = (*state.solutions, solution)
    if solution.success or len(state.rows.released) == len(state.q):
        return replace(state, q=solution.q, nlp=nlp, solutions=solutions)
    rows = replace(state.rows, released=np.arange(len(state.q)), bounded=np.ones_like(state.rows.bounded))
    nlp = build_nlp(problem, rows)
    solution = solve_nlp(nlp, np.clip(state.q, problem.lower, problem.upper), attained, bounded=rows.bounded)
    return replace(state, q=solution.q, rows=rows, nlp=nlp, solutions=(*solutions, solution))


def _review(task: PlanTask, problem: PathProblem, state: _State) -> tuple[Rows, int]:
    """Decide the rows of the next pass: limits that were left come in, equations that were kept are binding again."""
    rows, q, last = state.rows, state.q, state.solutions[-1]
    outside = (q < problem.lower - 1e-9) | (q > problem.upper + 1e-9)
    too_far = problem.compensated & (measure_correction(task, q) > problem.max_correction + AT_CORRECTION)
    too_far[rows.limited] = False
    bounded = rows.bounded | _widen(outside)
    limited = np.union1d(rows.limited, np.flatnonzero(_widen(too_far) & problem.compensated)).astype(int)
    new = np.flatnonzero(_widen(np.asarray(outside.any(axis=1))) | _widen(too_far))
    kept = rows.released[_size(last.residual) <= KEPT] if len(rows.released) else rows.released
    released = np.setdiff1d(np.union1d(rows.released, new), kept).astype(int)
    rows = replace(rows, bounded=bounded, limited=limited, released=released)
    if not problem.redundant or state.rate_passes >= RATE_PASSES or len(new):
        return rows, state.rate_passes
    velocity, acceleration = find_fast_rows(problem, q)
    return (
        replace(rows, velocity=_join(rows.velocity, velocity), acceleration=_join(rows.acceleration, acceleration)),
        state.rate_passes + 1,
    )


def find_fast_rows(problem: PathProblem, q: Array) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Find pairs (waypoint, joint) beyond a velocity or acceleration limit at the programmed feed, and neighbours."""
    within = problem.compensated[1:] & problem.compensated[:-1] & (problem.step_time > 0)
    h = np.maximum(problem.step_time, 1e-9)
    velocity = np.diff(q, axis=0) / h[:, None]
    acceleration = np.diff(velocity, axis=0) / (0.5 * (h[1:] + h[:-1]))[:, None]
    fast = (np.abs(velocity) > problem.velocity_limits) & within[:, None]
    hard = (np.abs(acceleration) > problem.acceleration_limits) & (within[1:] & within[:-1])[:, None]
    fast = _widen(fast) & within[:, None]
    hard = _widen(hard) & (within[1:] & within[:-1])[:, None]
    return np.argwhere(fast), np.argwhere(hard) + np.array([1, 0])


def _polish(task: PlanTask, problem: PathProblem, state: _State, attained: AttainedPose) -> Array:
    """Bring the pose equations down to nothing by least-norm Newton steps of the joints that stand off their limits."""
    q, held = state.q, state.rows.released
    for _ in range(6):
        missed = pose_equations(problem, q, attained)
        size = _size(missed)
        size[held] = 0.0
        busy = np.flatnonzero(size > EXACT)
        if not len(busy):
            break
        columns = _equation_columns(problem, q, attained, busy)
        free = (q[busy] > problem.lower + 1e-7) & (q[busy] < problem.upper - 1e-7)
        columns = columns * free[:, None, :]
        normal = columns @ np.swapaxes(columns, 1, 2) + 1e-14 * np.eye(columns.shape[1])
        step = np.swapaxes(columns, 1, 2) @ np.linalg.solve(normal, missed[busy, :, None])
        trial = q.copy()
        trial[busy] = np.clip(q[busy] - step[..., 0], problem.lower, problem.upper)
        reached = attain(task, trial)
        worse = np.flatnonzero(_size(pose_equations(problem, trial, reached)) > np.maximum(size, EXACT))
        held = np.union1d(held, worse).astype(int)
        trial[worse] = q[worse]
        q, attained = trial, reached if not len(worse) else attain(task, trial)
    return q


def _equation_columns(problem: PathProblem, q: Array, attained: AttainedPose, chosen: NDArray[np.int_]) -> Array:
    """Differentiate the pose equations of some waypoints with respect to the joints. Shape (k, 5 or 6, nq)."""
    _, rotation, columns = _reached(problem, q, attained)
    rotation, columns = rotation[chosen], columns[chosen]
    x, y = problem.rotation[chosen, :, 0], problem.rotation[chosen, :, 1]
    pairs = [(x, rotation[:, :, 2]), (y, rotation[:, :, 2])] + ([] if problem.spin_free else [(y, rotation[:, :, 0])])
    turns = [np.einsum("ni,nij->nj", np.cross(b, a), columns[:, 3:])[:, None] for a, b in pairs]
    return np.concatenate([columns[:, :3], *turns], axis=1)


def _reached(problem: PathProblem, q: Array, attained: AttainedPose) -> AttainedPose:
    """Return the loaded pose at compensated waypoints, the unloaded one at the others."""
    rapid = np.flatnonzero(~problem.compensated)
    if not len(rapid):
        return attained
    position, rotation, columns = (np.array(part) for part in attained)
    for part in chunk_rows(len(rapid), problem.chain):
        rows = rapid[part]
        frames = locate_frames(problem.chain, q[rows])
        position[rows], rotation[rows] = frames.tcp_position, frames.tcp_rotation
        columns[rows] = joint_jacobian(problem.chain, frames)
    return AttainedPose(position, rotation, columns)


def _widen(marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the neighbours along the path too."""
    from scipy.ndimage import binary_dilation

    if not marked.any():
        return marked
    reach = np.ones(2 * NEAR_WAYPOINTS + 1, bool)
    return np.asarray(binary_dilation(marked, reach if marked.ndim == 1 else reach[:, None]))


def _join(old: NDArray[np.int_], new: NDArray[np.int_]) -> NDArray[np.int_]:
    return np.unique(np.vstack([old, new]), axis=0) if len(new) else old


def _size(rows: Array) -> Array:
    return np.asarray(np.abs(rows).max(axis=1)) if rows.size else np.zeros(len(rows))
