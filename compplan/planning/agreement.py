"""Force, feed and motion made to agree, and the path divided until it is right between waypoints too.

The force depends on the feed that is driven, the feed on the joint motion, the joint motion on the correction, the
correction on the force: they are worked out in turn until the tip moves by no more than a small share of the tolerance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compplan.planning.between import Between, measure_between, wanted_pieces
from compplan.planning.deflection import follow_links, plan_loads
from compplan.planning.feed import FeedRequest, TorqueRules, time_run
from compplan.planning.run_timing import Timing, cutting_runs, find_slowdown, state_timing, time_between_cuts, time_ends
from compplan.planning.sampling import MOST_PIECES, Mending, divide_by, divide_task, grow_places, predict_loads
from compplan.planning.strategies import command_path, nlp
from compplan.planning.strategies.lost_motion import find_crossings, without_play
from compplan.planning.task import Command, PlanTask, attain_rows
from compplan.robot import Array
from compplan.simulation.vibration import build_dynamics, inertial_loads
from compplan.statics.inertia import build_moving_chain
from compplan.statics.sensitivity import attain_pose

#: Turns that force, feed and motion may take, and the shift of the tip that asks for no new correction. [m]
TURNS, EXACT = 12, 1e-10
#: Inertia and motion agree where a turn moves the tip by less than this share of the tolerance.
SETTLED = 1e-3
#: Divisions of the path at most, before a command is computed and afterwards.
DIVISIONS = 4
#: Moves this near to a waypoint that fails are not divided for it.
FAR = 8
#: Moves on both sides of one that crosses lost motion that are divided as finely.
EVEN = 4
#: Greatest change of the deflection over one move, in chords.
STEP_CHORDS = 4.0


@dataclass(frozen=True)
class Agreement:
    """A command with the time and the force that go with it.

    Attributes:
        task: The task as it was divided in the end, with the feed programmed and the wrench at the feed driven.
        command: The command.
        timing: Its run.
        between: Where the loaded tip goes between waypoints, by the planner's model.
        excess: Factor by which a limit of a joint's motion is still passed; 1 at most where all agree.
        turns: Turns taken.
        notes: Sentences for the user.
        change: Shift of the tip that the last turn still made. [m]
        slow: Factor by which the run is slower than limits ask for, so that it can follow its corrections. Shape (n,).

    """

    task: PlanTask
    command: Command
    timing: Timing
    between: Between
    excess: float
    turns: int
    notes: tuple[str, ...] = ()
    change: float = 0.0
    slow: Array = field(default_factory=lambda: np.ones(0))


def agree(
    task: PlanTask, strategy: str, wish: FeedRequest, progress: Callable[[str], None] = lambda text: None
) -> Agreement:
    """Let a strategy command a task, time the command, and repeat until force, feed and division fit.

    Args:
        task: The task.
        strategy: Name of the strategy.
        wish: What the process asks of the feed.
        progress: Told what is being done.

    """
    progress("sampling")
    if task.missed.any() or not task.chain.n_springs or not task.robot.bodies:
        # what does not move along the path has no inertia worth planning with, and what has no mass or spring none
        task = replace(task, inertia=False)
    found = _fit(task, strategy, wish, progress)
    if not task.inertia or not (doubt := _doubt_inertia(found)):
        return found
    progress("compensation without inertia")
    found = _fit(replace(task, inertia=False), strategy, wish, progress)
    note = f"The inertia of the motion is not compensated here: with it {doubt}. The 95 % band counts all of it."
    return replace(found, notes=(*found.notes, note))


def _doubt_inertia(found: Agreement) -> str:
    """Say what keeps a plan that compensates inertia from being one, "" where nothing does."""
    task = found.task
    if found.command.status != "solved":
        return "a limit is not held"
    if found.excess > 1.0:
        return f"joint limits are passed by a factor of {found.excess:.3g}"
    if found.change > SETTLED * task.tolerance:
        return f"motion and correction do not settle (last turn {1e3 * found.change:.2g} mm)"
    if ((driven := found.between.driven) > task.move_tolerance).any():
        return f"the tip strays by {1e3 * float(driven.max(initial=0.0)):.2g} mm between waypoints"
    return ""


def _fit(task: PlanTask, strategy: str, wish: FeedRequest, progress: Callable[[str], None]) -> Agreement:
    """Divide a path, command it and divide it again until it is right between waypoints too."""
    task = _divide_ahead(_resolve_starts(task, wish) if task.inertia else task, wish)
    mending, slow = Mending(), None
    for last in range(DIVISIONS + 1):
        progress(f"compensation of {len(task)} waypoints")
        found = _take_turns(task, strategy, wish, progress, slow)
        excess, pieces = _missing_pieces(found)
        pieces = mending.allow(task, pieces, excess)
        if last == DIVISIONS or not (pieces > 1).any() or task.missed.any():
            break
        before = task.origin
        task = divide_by(task if not task.follows_feed else replace(task, wrench=found.task.wrench), pieces)
        slow = np.interp(task.origin, before, found.slow) if task.inertia else None
        if task.follows_feed:
            task = _drive(task, task.q_start, wish)[0]
    if strategy != "nlp" or ("nlp" in found.command.facts and not (task.inertia or task.follows_feed)):
        return found
    progress("compensation: nonlinear program")
    return _solve_last(found)


def _solve_last(found: Agreement) -> Agreement:
    """Solve the program for the loads that force, feed and motion have come to."""
    task = found.task
    command = nlp.command_path(task, found.command)
    timing = state_timing(task, command.q, time_between_cuts(task, command.q, found.timing.time))
    return replace(found, command=command, timing=timing, between=measure_between(task, command.q, timing.time))


def _divide_ahead(task: PlanTask, wish: FeedRequest) -> PlanTask:
    """Divide by what the uncorrected motion shows, and start from the force at the feed that it can be driven with."""
    mending = Mending()
    for last in range(DIVISIONS + 1):
        time = None
        if task.follows_feed:
            task, timing = _drive(task, task.q_start, wish)
            time = timing.time
        bow = measure_between(task, task.q_start, time, bow=True)
        pieces = mending.allow(task, wanted_pieces(bow, task.move_chord), bow.most)
        if task.follows_feed:
            pieces = np.maximum(pieces, _force_pieces(task))
        pieces[task.missed[1:] | task.missed[:-1]] = 1
        if last == DIVISIONS or not (pieces > 1).any():
            break
        task = divide_by(task, pieces)
    return task


def _take_turns(
    task: PlanTask, strategy: str, wish: FeedRequest, progress: Callable[[str], None], slow: Array | None
) -> Agreement:
    """Command the path; where the force follows the feed, slow the run down until its own corrections can follow.

    Where inertia counts, it is that of the commanded motion: command and inertia are worked out in turn.

    The run is that of the uncorrected motion, so that it does not answer to the force; a turn only makes it slower.
    Rapid moves, and corrections that come in at rest, take the time of the commanded motion.
    """
    command = nlp.approach_path(task) if strategy == "nlp" else command_path(task, strategy)
    if not task.follows_feed and not task.inertia:
        driven, timing, notes = time_run(task, command.q, wish)
        between = measure_between(driven, command.q, timing.time)
        return Agreement(driven, command, timing, between, 0.0, 1, notes, slow=np.ones(len(task)))
    masses = build_moving_chain(task.robot) if task.inertia else None
    slow, excess, change = np.ones(len(task)) if slow is None else slow, np.inf, np.inf
    turns, run, timed = 0, None, slow
    while (excess > 1.0 or (task.inertia and change > SETTLED * task.tolerance)) and turns < TURNS:
        turns += 1
        progress(f"force and feed, turn {turns}")
        if run is None or wish.torque or not np.array_equal(slow, timed):
            run, timed = time_run(task, task.q_start, wish, slow), slow
        driven, timing, notes = run
        loads = predict_loads(task, _moving_feed(task, timing)) if task.follows_feed else task.wrench
        time = time_between_cuts(task, command.q, timing.time)
        changed = replace(task, wrench=loads, bias=None)
        if masses is not None:
            changed = replace(changed, links=follow_links(task, command.q))
            changed = replace(changed, bias=plan_loads(changed, time, masses))
        change, task = _shift(task, changed, command.q), changed
        if change > EXACT:
            command = nlp.correct_command(task, command) if strategy == "nlp" else command_path(task, strategy)
        rules = TorqueRules(task.robot, command.q, task.wrench) if wish.torque else None
        slower = find_slowdown(task, command.q, time, rules)
        excess = float(slower.max())
        slow = slow * np.minimum(slower, 3.0) * np.where(slower > 1.0, 1.02, 1.0)
    if excess > 1.0:
        notes = (*notes, f"Force and motion do not agree: joint limits are passed by a factor of {excess:.3g}.")
    timing = state_timing(driven, command.q, time_between_cuts(task, command.q, timing.time))
    driven = replace(driven, wrench=task.wrench, bias=task.bias)
    between = measure_between(driven, command.q, timing.time)
    return Agreement(driven, command, timing, between, excess, turns, notes, change if task.inertia else 0.0, slow)


def _drive(task: PlanTask, q: Array, wish: FeedRequest) -> tuple[PlanTask, Timing]:
    """Time joint positions and put the force at that feed into the task."""
    timing = time_run(task, q, wish)[1]
    return replace(task, wrench=predict_loads(task, _moving_feed(task, timing))), timing


def _moving_feed(task: PlanTask, timing: Timing) -> Array:
    """Return the feed at every waypoint: of two moves of a cut the means, each weighed by the other's time. [m/s].

    That of the move before it alone would step where moves of different lengths meet.
    """
    feed, step = timing.feed.copy(), np.diff(timing.time)
    feed[0] = feed[1]
    inner = ~task.nominal.rapid[1:-1] & ~task.nominal.rapid[2:] & (step[1:] + step[:-1] > 0.0)
    mean = (feed[1:-1] * step[1:] + feed[2:] * step[:-1]) / np.maximum(step[1:] + step[:-1], 1e-300)
    feed[1:-1] = np.where(inner, mean, feed[1:-1])
    return feed


def _shift(task: PlanTask, other: PlanTask, q: Array) -> float:
    """Return by how much the loads of another task would move the loaded tip at most. [m]."""
    rows = np.flatnonzero(task.compensated)
    biases = (None if each.bias is None else each.bias[rows] for each in (task, other))
    now, then = (
        attain_pose(
            task.chain, q[rows], each.wrench[rows], slope=False, torque_bias=bias, theta=task.theta[rows]
        ).position
        for each, bias in zip((task, other), biases, strict=True)
    )
    return float(np.linalg.norm(now - then, axis=1).max(initial=0.0))


def _force_pieces(task: PlanTask) -> NDArray[np.int_]:
    """Tell into how many pieces moves have to be divided so that the deflection changes little in each."""
    plain = replace(task, wrench=np.zeros_like(task.wrench))
    every = np.arange(len(task))
    bent = attain_rows(task, task.q_start, every, slope=False).position
    bent = bent - attain_rows(plain, task.q_start, every, slope=False).position
    change = np.linalg.norm(np.diff(bent, axis=0), axis=1)
    change[task.nominal.rapid[1:] | task.lead[1:] | (task.nominal.steps < 1e-6)] = 0.0
    return np.maximum(np.ceil(change / (STEP_CHORDS * task.chord)), 1.0).astype(int)


def _resolve_starts(task: PlanTask, wish: FeedRequest) -> PlanTask:
    """Divide first and last moves of runs, in steps that grow away from the rest, until their rows tell the motion.

    A run starts as s = j t^3 / 6. Its first row at t1 says that it accelerates by 2 s(t1) / t1^2 = j t1 / 3 where it
    still rests; that falls with the cube root of the first step, and may bend the arm by half a chord.
    """
    dynamics, runs = build_dynamics(task.robot), cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests)
    if not dynamics.known or not runs:
        return task
    time = time_run(task, task.q_start, wish)[1].time if wish.constant or wish.torque else time_ends(task, task.q_start)
    rests = np.array(runs).ravel()
    moves = rests - np.tile([0, 1], len(runs))
    step = np.maximum(np.diff(time)[moves], 1e-12)[:, None]
    push = 2.0 * (task.q_start[moves + 1] - task.q_start[moves]) / step**2 * np.tile([[1.0], [-1.0]], (len(runs), 1))
    loads, still = inertial_loads(dynamics, task.q_start[rests], np.zeros_like(push), push), task.wrench[rests]
    bent, plain = (
        attain_pose(task.chain, task.q_start[rests], still, slope=False, torque_bias=bias).position
        for bias in (loads, None)
    )
    excess = np.linalg.norm(bent - plain, axis=1) / (0.5 * task.chord)
    first = np.minimum(np.maximum(excess, 1.0), MOST_PIECES) ** -3.0
    places = [grow_places(move, share, move == rest) for move, share, rest in zip(moves, first, rests, strict=True)]
    return divide_task(task, np.unique(np.r_[np.arange(len(task)), *places]))


def _missing_pieces(found: Agreement) -> tuple[Array, NDArray[np.int_]]:
    """Tell by how much more than their ends moves stray [m], and into how many pieces that asks to divide them."""
    task, q, ways = found.task, found.command.q, found.between
    links = found.command.facts.get("links")
    if links is not None:  # division mends lost motion in the moves alone that cross it
        task, q = without_play(task), links
        ways = measure_between(task, q, found.timing.time)
    attained = attain_rows(task, q, np.arange(len(task)), slope=False).position
    off = np.linalg.norm(attained - task.position, axis=1)
    ends = np.maximum(off[:-1], off[1:])
    between = Between(*(np.maximum(way - ends, 0.0) for way in _ways(ways)))
    if links is not None:
        crosses = find_crossings(found.command.q, links)
        for way, whole in zip(_ways(between), (found.between.joint, found.between.cartesian), strict=False):
            way[crosses] = np.maximum(way, whole)[crosses]
    pieces = wanted_pieces(between, task.move_chord)
    pieces[task.nominal.steps < 1e-6] = 1
    pieces = _even_crossings(found, pieces)
    for waypoint in found.command.failures:
        pieces[max(waypoint - FAR, 0) : waypoint + FAR] = 1
    return between.most, pieces


def _even_crossings(found: Agreement, pieces: NDArray[np.int_]) -> NDArray[np.int_]:
    """Divide the neighbours of moves that cross lost motion as finely as these.

    A curve through rows of one step in time swings beside a jump by an eighth of it; a short step among long ones
    swings farther than the jump.
    """
    links = found.command.facts.get("links")
    if links is None:
        return pieces
    step = np.diff(found.timing.time) / pieces
    crossing = np.flatnonzero(find_crossings(found.command.q, links))
    more = np.ones_like(pieces)
    for move in crossing.tolist():
        near = np.arange(max(move - EVEN, 0), min(move + EVEN + 1, len(pieces)))
        finer = np.ceil(step[near] / max(step[move], 1e-9) - 0.5).astype(int)
        more[near] = np.maximum(more[near], np.maximum(finer, 1))
    return pieces * more


def _ways(between: Between) -> tuple[Array, Array, Array]:
    return between.joint, between.cartesian, between.spline
