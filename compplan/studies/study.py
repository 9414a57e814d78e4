"""A study: compensation strategies on many sampled robots; data common to all samples is computed once.

All strategies are evaluated on the same samples, so that their differences are paired. The result is the deviation of
the tool tip from the path.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects.attained import attain_with_effects
from compplan.errors import InputError
from compplan.job.noise import NoiseTable
from compplan.planning.strategies import ONLINE, command_path, list_strategies
from compplan.planning.task import Command, PlanTask
from compplan.robot import Array
from compplan.statics.encoders import actuator_selection, control_equilibrium, feedback_gain, feedback_scale
from compplan.studies.kernel import Kernel, Touch, build_kernel, move_part, prepare_touch, solve_tips
from compplan.studies.sampling import (
    SampleContext,
    SampledRobots,
    build_context,
    differentiate_placements,
    sample_robots,
    shift_tip,
)
from compplan.toolpath.toolpath import select_waypoints
from compplan.uncertainty.sensitivities import ForceSpread, state_force

#: Greatest number of waypoints; a longer path is thinned evenly, as its report states.
MOST_WAYPOINTS = 2500
#: Joint distance from the task's posture above which placement errors are computed anew. [rad or m]
OTHER_POSTURE = 0.05
#: Number of stations along the path whose distances are kept.
STATIONS = 120
#: Poses computed at once, samples times waypoints.
BATCH = 8192


class PreparedCommand(NamedTuple):
    """The command of a strategy, components first, prepared for many samples."""

    q: Array  #: Commanded joint positions. Shape (nq, 1, n). [rad or m]
    gain: Array | None  #: Change of the command per measured wrench. Shape (nq, 6, n), or None. [rad/N, rad/(N m)]
    expected: Array | None  #: Expected wrench. Shape (6, 1, n), or None. [N, N m]
    spring_gain: Array  #: Factor on the deflection of each gear. Shape (nq,).
    spring_factor: Array  #: The same for every elastic coordinate, 1 if no encoder measures it. Shape (s,).
    theta: Array  #: Elastic coordinates by the model. Shape (s, n). [rad or m]
    offset: Array  #: Motion of the tip due to the effects of the robot folder. Shape (3, n). [m]
    #: Motion of the tip per placement error if the posture differs from that of the task. Shape (k, 3, n).
    placements: Array | None = None


@dataclass(frozen=True)
class Study:
    """Data common to all samples of a study."""

    task: PlanTask  #: The task, thinned if it is long.
    waypoints_of_path: int  #: Number of waypoints of the complete path.
    answers: dict[str, Command]  #: Commands by strategy.
    commands: dict[str, PreparedCommand]  #: The same, prepared for many samples.
    kernel: Kernel  #: Compiled chain of the robot.
    touch: Touch | None  #: Touched points of the part, None if its frame is absolute.
    context: SampleContext  #: Noise and its effect on the tip.
    nominal: Array  #: Nominal tips. Shape (3, n). [m]
    cut: NDArray[np.bool_]  #: Waypoints that are evaluated. Shape (n,).
    stations: NDArray[np.int_]  #: Waypoints whose distances are kept. Shape (k,).

    @property
    def strategies(self) -> tuple[str, ...]:
        """Return the names of the strategies."""
        return tuple(self.answers)

    @property
    def noise(self) -> NoiseTable:
        """Return the standard deviations."""
        return self.context.noise


def prepare_study(
    task: PlanTask,
    noise: NoiseTable | None = None,
    strategies: Sequence[str] | None = None,
    *,
    most_waypoints: int = MOST_WAYPOINTS,
    force: ForceSpread | None = None,
    announce: Callable[[str], None] = lambda text: None,
) -> Study:
    """Prepare a study.

    strategies: by default all that the robot supports; most_waypoints: a longer path is thinned evenly to this number;
    force: uncertainty of the force, by default that of `noise`; if learned with the robot, it is correlated with it.

    Raises:
        InputError: If a strategy does not suit the robot, or the path has no cutting moves.
    """
    noise = noise or NoiseTable()
    if not task.compensated.any():
        raise InputError("the path has no cutting moves, nothing to compare")
    chosen = tuple(strategies) if strategies else list_strategies(task.robot)
    rows = thin_rows(len(task), most_waypoints)
    thin = thin_task(task, rows)
    announce(f"prepare {len(chosen)} strategies")
    answers = {
        name: command_path(thin, name) if name in ONLINE else _thin_answer(command_path(task, name), rows)
        for name in chosen
    }
    return assemble_study(thin, noise, answers, len(task), force or state_force(noise))


def assemble_study(
    thin: PlanTask, noise: NoiseTable, answers: dict[str, Command], count: int, force: ForceSpread
) -> Study:
    """Build a study from a thinned task and its prepared commands; count: waypoints of the complete path."""
    selection = actuator_selection(thin.chain)
    cut = np.flatnonzero(thin.compensated)
    return Study(
        task=thin,
        waypoints_of_path=count,
        answers=answers,
        commands={name: _prepare_command(thin, c, selection, noise) for name, c in answers.items()},
        kernel=build_kernel(thin.chain),
        touch=prepare_touch(thin.robot, thin.touched),
        context=build_context(thin, noise, force),
        nominal=np.ascontiguousarray(thin.position.T),
        cut=thin.compensated,
        stations=cut[np.unique(np.linspace(0, len(cut) - 1, min(STATIONS, len(cut))).astype(int))],
    )


def thin_rows(n: int, most: int) -> NDArray[np.int_]:
    """Select at most `most` evenly spaced of n waypoints, including the first and the last."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))


def thin_task(task: PlanTask, rows: NDArray[np.int_]) -> PlanTask:
    """Reduce a task to the given waypoints."""
    if len(rows) == len(task):
        return task
    time = np.concatenate([[0.0], np.cumsum(task.step_time)])
    parts = {name: getattr(task, name)[rows] for name in ("rotation", "wrench", "compensated", "q_start", "missed")}
    nominal = select_waypoints(task.nominal, rows)
    return replace(task, **parts, nominal=nominal, step_time=np.diff(time[rows]), start=None)


def thin_study(study: Study, most: int) -> Study:
    """Reduce a study to at most `most` waypoints, with the commands already prepared."""
    rows = thin_rows(len(study.task), most)
    if len(rows) == len(study.task):
        return study
    thin, answers = thin_task(study.task, rows), {k: _thin_answer(v, rows) for k, v in study.answers.items()}
    return assemble_study(thin, study.noise, answers, study.waypoints_of_path, study.context.force)


def _thin_answer(answer: Command, rows: NDArray[np.int_]) -> Command:
    gain, expected = (None if part is None else part[rows] for part in (answer.gain, answer.expected))
    return Command(answer.q[rows], feedback=answer.feedback, beta=answer.beta, gain=gain, expected=expected)


def _prepare_command(task: PlanTask, answer: Command, selection: Array, noise: NoiseTable) -> PreparedCommand:
    state = control_equilibrium(task.chain, answer.q, task.wrench, feedback=answer.feedback, beta=answer.beta)
    between, spring_gain = selection.any(axis=0), feedback_gain(answer.feedback, answer.beta, task.chain.nq)
    offset = np.zeros((3, len(task)))
    if task.robot.effects:
        runs = [
            attain_with_effects(robot, answer.q, task.wrench, task.step_time)[0]
            for robot in (task.robot, replace(task.robot, effects=()))
        ]
        offset = (runs[0] - runs[1]).T
    elsewhere = np.abs(answer.q - task.q_start).max() > OTHER_POSTURE
    return PreparedCommand(
        q=np.ascontiguousarray(answer.q.T)[:, None, :],
        gain=None if answer.gain is None else np.ascontiguousarray(np.moveaxis(answer.gain, 0, -1)),
        expected=None if answer.expected is None else np.ascontiguousarray(answer.expected.T)[:, None, :],
        spring_gain=spring_gain,
        spring_factor=np.where(between, spring_gain @ np.abs(selection), 1.0),
        theta=np.ascontiguousarray(state.loaded.theta.T),
        offset=offset,
        placements=differentiate_placements(replace(task, q_start=answer.q), noise) if elsewhere else None,
    )


class ChunkResult(NamedTuple):
    """Deviations of b samples and m strategies."""

    rms: Array  #: Root mean square distance from the path. Shape (b, m). [m]
    mean: Array  #: Mean distance. Shape (b, m). [m]
    max: Array  #: Greatest distance. Shape (b, m). [m]
    within: Array  #: Share of waypoints within tolerance. Shape (b, m).
    along: NDArray[np.float32]  #: Distance at the stations. Shape (b, m, k). [m]


#: Number and results of each finished chunk of a study.
Chunks = Generator[tuple[int, ChunkResult], None, None]


def evaluate_points(study: Study, points: Array) -> ChunkResult:
    """Evaluate every strategy on the samples at points of the unit cube. points: shape (b, size).

    Raises:
        ConvergenceError: If a sampled robot buckles under its load.
    """
    size = max(1, BATCH // len(study.task))
    batches = [_evaluate_batch(study, points[start : start + size]) for start in range(0, len(points), size)]
    return ChunkResult(*(np.concatenate(parts) for parts in zip(*batches, strict=True)))


def _evaluate_batch(study: Study, points: Array) -> ChunkResult:
    robots = sample_robots(study.context, points)
    distances = np.stack([np.linalg.norm(run_strategy(study, name, robots), axis=0) for name in study.strategies], 1)
    cut = distances[:, :, study.cut]
    return ChunkResult(
        rms=np.sqrt((cut**2).mean(axis=2)),
        mean=cut.mean(axis=2),
        max=cut.max(axis=2),
        within=(cut <= study.task.tolerance).mean(axis=2),
        along=distances[:, :, study.stations].astype(np.float32),
    )


def run_strategy(study: Study, name: str, robots: SampledRobots) -> Array:
    """Simulate a strategy on b sampled robots; return the deviation. Shape (3, b, n). [m]"""
    command = study.commands[name]
    q = np.broadcast_to(command.q, (len(command.q), *robots.shift.shape[1:]))
    if command.gain is not None and command.expected is not None:
        q = command.q + np.einsum("qkn,kbn->qbn", command.gain, robots.wrench + robots.force - command.expected)
    return _cut_part(study, command, robots, q)


def _cut_part(study: Study, command: PreparedCommand, robots: SampledRobots, q: Array) -> Array:
    """Simulate a command on b sampled robots; return the deviation. Shape (3, b, n). [m]"""
    gain = command.spring_gain[:, None, None]
    true = q + robots.zero[:, :, None] + gain * robots.drive - gain * robots.motor - (1 - gain) * robots.link
    b, n = true.shape[1:]
    scale = feedback_scale(command.spring_factor[:, None], robots.link_share)
    factor = np.repeat(robots.factor * scale, n, axis=1)
    theta = np.tile(command.theta, (1, b)) * np.repeat(robots.factor, n, axis=1)
    shift = robots.shift if command.placements is None else shift_tip(robots.causes, command.placements)
    found = study.nominal[:, None, :]
    if study.touch is not None:
        found = found + move_part(study.touch, study.kernel, robots, scale, command.spring_gain, study.nominal)
    moved = shift + robots.repeat[:, :, None] + command.offset[:, None, :] - found
    tips = solve_tips(study.kernel, true.reshape(len(true), -1), robots.wrench.reshape(6, -1), factor, theta)
    return np.asarray(tips.reshape(3, b, n) + moved)
