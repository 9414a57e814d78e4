"""Fixed point of correction, timing, force and sampling.

The force depends on the actual feed, inertia on the motion, the motion on the correction, the correction on the force.
One loop iterates them until an iteration moves the loaded tip by at most `CONVERGED` of the tolerance and no joint
exceeds a limit:

    command <- loads,   run <- command,   loads <- run,   slower where a limit is exceeded.

If the tip deviates between waypoints after convergence, those moves are divided and the loop continues. The nonlinear
program is solved for the final loads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.effects.backlash import find_crossings
from compplan.job.output import OutputTable
from compplan.planning.executed import ExecutedPath, evaluate_executed
from compplan.planning.feed import time_run
from compplan.planning.inertia import follow_links, plan_loads
from compplan.planning.sampling import (
    MOST_PIECES,
    Between,
    divide_by,
    divide_task,
    grow_places,
    measure_between,
    predict_loads,
    required_pieces,
)
from compplan.planning.strategies import command_path, nlp
from compplan.planning.task import Command, PlanTask, attain_rows
from compplan.planning.timing import Timing, find_slowdown, state_timing, time_between_cuts, time_ends
from compplan.robot import Array
from compplan.simulation.exact import load_by_motion
from compplan.simulation.vibration import build_dynamics
from compplan.statics.chain import Chain
from compplan.statics.inertia import build_moving_chain
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.toolpath import interpolate

#: Convergence of force, feed and motion: shift of the tip per iteration as a share of the tolerance.
CONVERGED = 1e-3
#: Most iterations between two divisions, and most divisions of the path.
TURNS, DIVISIONS = 12, 5
#: Moves on both sides of a lost-motion crossing that are divided as finely: a slow crossing delays the run less.
NEIGHBOURS = 2
#: Shift of the tip below which the correction is not updated. [m]
EXACT = 1e-10


@dataclass(frozen=True)
class Compensation:
    """Command with its timing and loads."""

    task: PlanTask  #: Divided task with the programmed feed and the wrench at the actual feed.
    command: Command  #: Joint positions and status.
    timing: Timing  #: Timing of the command.
    between: Between  #: Deviation of the loaded tip between waypoints, by the planner's model.
    executed: ExecutedPath | None = None  #: Executed path of the controller, None if not simulated.
    excess: float = 0.0  #: Factor by which a joint motion limit is still exceeded; at most 1 after convergence.
    change: float = 0.0  #: Shift of the tip in the last iteration. [m]
    notes: tuple[str, ...] = ()  #: Notes for the user.


def compensate(
    task: PlanTask, strategy: str, output: OutputTable | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Compensation:  # fmt: skip
    """Compute the command of a strategy for a task, consistent with its timing and loads.

    If compensation of inertia makes a plan infeasible, inertia is covered by the error band only. `output`: requested
    programs, if known.

    Raises:
        UnknownNameError: If there is no such offline strategy.
    """
    progress("sampling")
    if task.missed.any() or not task.chain.n_springs or not task.robot.bodies:
        task = replace(task, inertia=False)
    found = _iterate_loads(task, strategy, output, progress)
    converged = found.excess <= 1.0 and found.change <= CONVERGED * task.tolerance
    kept = found.command.status == "solved" and found.between.max_deviation <= task.tolerance
    if found.task.inertia and not (converged and kept):
        found = _iterate_loads(replace(task, inertia=False), strategy, output, progress)
        reason = "a limit or the tolerance is not held" if converged else "motion and correction do not settle"
        note = f"The inertia of the motion is not compensated here: with it {reason}. The 95 % band counts all of it."
        found = replace(found, notes=(*found.notes, note))
    return found


def _iterate_loads(
    task: PlanTask, strategy: str, output: OutputTable | None, progress: Callable[[str], None]
) -> Compensation:
    """Iterate to the fixed point; arguments as of `compensate`.

    If the loads depend on the motion, the timing is that of the uncorrected motion, independent of the force; an
    iteration only slows it down. Rapid moves, and corrections added at rest, have the time of the command.
    """
    coupled = task.follows_feed or task.inertia
    masses = build_moving_chain(task.robot) if task.inertia else None
    task = resolve_starts(task)
    slow, run, command = np.ones(len(task)), None, None
    turn, divisions = 0, 0
    while True:
        turn += 1
        if run is None:
            progress(f"compensation of {len(task)} waypoints")
        if coupled:
            progress(f"force and feed, turn {turn}")
        if command is None:
            command = nlp.approach_path(task) if strategy == "nlp" else command_path(task, strategy, online=False)
        excess, change = 0.0, 0.0
        run = run or time_run(task, task.q_start if coupled else command.q, slow)
        driven, timing, notes = run
        if coupled:
            changed = _load(task, timing, command.q, masses)
            change, task = _shift(task, changed, command.q), changed
            if change > EXACT:
                command = nlp.correct_command(task, command) if strategy == "nlp" else command_path(task, strategy)
            time = time_between_cuts(task, command.q, timing.time)
            slower = find_slowdown(task, command.q, time)
            excess = float(slower.max())
            if excess > 1.0 or task.torque_limits:
                slow, run = slow * np.minimum(slower, 3.0) * np.where(slower > 1.0, 1.02, 1.0), None
            if (excess > 1.0 or change > CONVERGED * task.tolerance) and turn % TURNS:
                continue
            timing = state_timing(driven, command.q, time)
            driven = replace(driven, wrench=task.wrench, bias=task.bias)
        if excess > 1.0:
            notes = (*notes, f"Force and motion do not agree: joint limits are passed by a factor of {excess:.3g}.")
        between = measure_between(driven, command.q)
        found = Compensation(driven, command, timing, between, None, excess, change, notes)
        pieces = _missing_pieces(found)
        if (pieces > 1).any() and divisions < DIVISIONS and not command.failures:
            task, slow, command = _divide(task, pieces, slow, command, strategy)
            divisions, run, turn = divisions + 1, None, 0
            continue
        if strategy == "nlp" and (coupled or not command.nlp):
            progress("compensation: nonlinear program")  # for the loads at the fixed point
            command = nlp.command_path(driven, command)
            if masses is not None and task.redundant:  # the program may turn the tool about its axis
                driven = _load_by_motion(driven, timing.time, command.q, masses)
                command = nlp.correct_command(driven, command)
            timing = state_timing(driven, command.q, time_between_cuts(driven, command.q, timing.time))
            found = replace(found, command=command, timing=timing, between=measure_between(driven, command.q))
        return replace(found, executed=evaluate_executed(found.task, found.command.q, found.timing.time, output))


def _load(task: PlanTask, timing: Timing, q: Array, masses: Chain | None) -> PlanTask:
    """Return the task with the force at the actual feed and the inertia of the commanded motion."""
    loads = predict_loads(task, _moving_feed(task, timing)) if task.follows_feed else task.wrench
    changed = replace(task, wrench=loads, bias=None)
    return changed if masses is None else _load_by_motion(changed, timing.time, q, masses)


def _load_by_motion(task: PlanTask, time: Array, q: Array, masses: Chain) -> PlanTask:
    """Return the task with the inertia of a commanded motion q (n, nq) [rad or m] at times (n,) [s]."""
    changed = replace(task, links=follow_links(task, q))
    return replace(changed, bias=plan_loads(changed, time_between_cuts(task, q, time), masses))


def _divide(
    task: PlanTask, pieces: NDArray[np.int_], slow: Array, command: Command, strategy: str
) -> tuple[PlanTask, Array, Command | None]:
    """Divide moves; interpolate slowdown and correction linearly, and refine a command of `nlp` by Newton steps."""
    before = task.origin
    finer = divide_by(task, pieces)
    at = np.interp(finer.origin, before, np.arange(len(before)))
    finer = replace(finer, wrench=interpolate(at, np.arange(len(before)), task.wrench)) if task.follows_feed else finer
    slow = np.interp(at, np.arange(len(before)), slow)
    if strategy != "nlp":
        return finer, slow, None
    q = finer.q_start + interpolate(at, np.arange(len(before)), command.links - task.q_start)
    return finer, slow, nlp.correct_command(finer, Command(np.clip(q, task.robot.lower, task.robot.upper)))


def _moving_feed(task: PlanTask, timing: Timing) -> Array:
    """Compute the feed at every waypoint: mean of two moves of a cut, each weighted by the time of the other. [m/s]

    The feed of the previous move alone would have steps between moves of different lengths.
    """
    feed, step = timing.feed.copy(), np.diff(timing.time)
    feed[0] = feed[1]
    inner = ~task.nominal.rapid[1:-1] & ~task.nominal.rapid[2:] & (step[1:] + step[:-1] > 0.0)
    mean = (feed[1:-1] * step[1:] + feed[2:] * step[:-1]) / np.maximum(step[1:] + step[:-1], 1e-300)
    feed[1:-1] = np.where(inner, mean, feed[1:-1])
    return feed


def _shift(task: PlanTask, other: PlanTask, q: Array) -> float:
    """Compute the greatest shift of the loaded tip by the loads of another task. [m]"""
    rows = np.flatnonzero(task.compensated)
    biases = (None if each.bias is None else each.bias[rows] for each in (task, other))
    now, then = (
        attain_pose(task.chain, q[rows], each.wrench[rows], slope=False, torque_bias=bias, theta=task.theta[rows])[0]
        for each, bias in zip((task, other), biases, strict=True)
    )
    return float(np.linalg.norm(now - then, axis=1).max(initial=0.0))


def resolve_starts(task: PlanTask) -> PlanTask:
    """Divide first and last moves of runs, in steps that grow from the rest, until their rows resolve the motion.

    A run starts as s = j t^3 / 6. From its first row at t1, the difference formula yields an acceleration of
    2 s(t1) / t1^2 = j t1 / 3 at rest, falling with the cube root of the first step. Its deflection may be half a chord.
    """
    dynamics, runs = build_dynamics(task.robot), task.runs
    if not task.inertia or not dynamics.known or not runs:
        return task
    time = (
        time_run(task, task.q_start)[1].time
        if task.constant_feed or task.torque_limits
        else time_ends(task, task.q_start)
    )
    rests = np.array(runs).ravel()
    moves = rests - np.tile([0, 1], len(runs))
    step = np.maximum(np.diff(time)[moves], 1e-12)[:, None]
    a = 2.0 * (task.q_start[moves + 1] - task.q_start[moves]) / step**2 * np.tile([[1.0], [-1.0]], (len(runs), 1))
    loads, wrench = load_by_motion(dynamics.inertial, task.q_start[rests], np.zeros_like(a), a), task.wrench[rests]
    bent, plain = (
        attain_pose(task.chain, task.q_start[rests], wrench, slope=False, torque_bias=bias).position
        for bias in (loads, None)
    )
    excess = np.linalg.norm(bent - plain, axis=1) / (0.5 * task.chord)
    first = np.minimum(np.maximum(excess, 1.0), MOST_PIECES) ** -3.0
    places = [grow_places(move, share, move == rest) for move, share, rest in zip(moves, first, rests, strict=True)]
    return divide_task(task, np.unique(np.r_[np.arange(len(task)), *places]))


def _missing_pieces(found: Compensation) -> NDArray[np.int_]:
    """Return the number of pieces of moves that deviate by more than their ends. Shape (n - 1,)."""
    task, q, ways = found.task, found.command.links, found.between
    if np.ndim(found.command.lead):  # division reduces lost motion only in the moves that cross it
        task = nlp.without_lost_motion(task)
        ways = measure_between(task, q)
    attained = attain_rows(task, q, np.arange(len(task)), slope=False).position
    off = np.linalg.norm(attained - task.position, axis=1)
    ends = np.maximum(off[:-1], off[1:])
    deviation, crosses = np.maximum(ways.most - ends, 0.0), find_crossings(found.command.q, q)
    deviation[crosses] = np.maximum(deviation, found.between.most)[crosses]
    pieces = required_pieces(deviation, task.chord)
    crossing = np.pad(np.where(crosses, pieces, 1), NEIGHBOURS, constant_values=1)
    pieces = np.maximum(pieces, np.lib.stride_tricks.sliding_window_view(crossing, 2 * NEIGHBOURS + 1).max(axis=1))
    pieces[(task.nominal.steps < 1e-6) | task.nominal.rapid[1:] | task.lead[1:]] = 1
    return pieces
