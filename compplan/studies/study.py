"""A study: strategies at work in many cells, and what all samples of it share, worked out once.

`compplan.studies.evaluation` lets every strategy cut its part in the cell of every point.

All strategies meet the same cells, so that their differences are paired.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects.attained import attain_with_effects
from compplan.errors import InputError
from compplan.job.noise import NoiseTable
from compplan.plan.correction_loop import Loop, Plant
from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.online import ONLINE, PLAIN, list_strategies, prepare_answers
from compplan.plan.strategies.path_map import load_gears
from compplan.plan.task import PlanTask
from compplan.robot import Array
from compplan.statics.encoders import actuator_selection, control_equilibrium
from compplan.studies.factors import list_factors
from compplan.studies.kernel import Kernel, build_kernel
from compplan.studies.posterior import settle_force, settle_robot
from compplan.studies.sampling import (
    Surroundings,
    differentiate_placements,
    survey_surroundings,
)
from compplan.studies.touch import Touch, prepare_touch
from compplan.toolpath.toolpath import select_waypoints
from compplan.uncertainty.sensitivities import ForceSpread

#: Waypoints that a study looks at; a longer path is thinned evenly, and its report says so.
MOST_WAYPOINTS = 2500
#: Length of path over which the mean softens the tracker's noise. [m]
SOFT_LENGTH = 0.003
#: Joints this far from the task's posture need placement errors of their own. [rad or m]
OTHER_POSTURE = 0.05
#: Stations along the path whose distances are kept.
STATIONS = 120


class Worker(NamedTuple):
    """An answer, components first, ready for many samples.

    Attributes:
        q: Shape (nq, 1, n). [rad or m]
        q_rest: Shape (nq, 1, n). [rad or m]
        gain: Shape (nq, k, n), or None.
        expected: Shape (k, 1, n), or None.
        spring_gain: Factor on what each gear yields. Shape (nq,).
        spring_factor: The same for every elastic coordinate. Shape (s,).
        theta: Elastic coordinates by the model. Shape (s, n). [rad or m]
        offset: Motion of the tip by the effects of the robot folder. Shape (3, n). [m]
        placements: Motion of the tip per placement error where the posture is another than the task's. Shape (k, 3, n).
        touch: How the strategy's robot finds the part, None where its frame is absolute.

    """

    q: Array
    q_rest: Array
    gain: Array | None
    expected: Array | None
    spring_gain: Array
    spring_factor: Array
    theta: Array
    offset: Array
    placements: Array | None = None
    touch: Touch | None = None


class TimeGrid(NamedTuple):
    """Between n waypoints and the periods of a loop: positions of the periods among the waypoints, and vice versa."""

    at_period: Array
    at_waypoint: Array


@dataclass(frozen=True)
class Study:
    """What all samples of a study share.

    Attributes:
        task: The task, thinned where it is long.
        waypoints_of_path: Number of waypoints of the whole path.
        answers: The strategies.
        workers: The same, ready for many samples.
        kernel: The kernel.
        surroundings: Noise and what it acts on.
        gear: Compliance, load per wrench and load of each gear: (nq,), (nq, 6, n), (nq, n).
        selection: Elastic coordinates between each joint's encoders. Shape (nq, s).
        nominal: Wanted tips. Shape (3, n). [m]
        cut: Waypoints that are judged. Shape (n,).
        grid: Time grid of the correction loops, or None.
        stations: Waypoints whose distances are kept. Shape (k,).
        softened: Waypoints whose mean softens the tracker's noise.

    """

    task: PlanTask
    waypoints_of_path: int
    answers: dict[str, Answer]
    workers: dict[str, Worker]
    kernel: Kernel
    surroundings: Surroundings
    gear: tuple[Array, Array, Array]
    selection: Array
    nominal: Array
    cut: NDArray[np.bool_]
    grid: TimeGrid | None
    stations: NDArray[np.int_]
    softened: int = 1

    @property
    def strategies(self) -> tuple[str, ...]:
        """Names of the strategies."""
        return tuple(self.answers)

    @property
    def noise(self) -> NoiseTable:
        """The standard deviations."""
        return self.surroundings.noise


def prepare_study(
    task: PlanTask,
    noise: NoiseTable | None = None,
    strategies: Sequence[str] | None = None,
    *,
    most_waypoints: int = MOST_WAYPOINTS,
    plain: PlanTask | None = None,
    force: ForceSpread | None = None,
    announce: Callable[[str], None] | None = None,
) -> Study:
    """Prepare a study.

    Args:
        task: The task.
        noise: The standard deviations; the defaults if left out.
        strategies: The strategies; all that the robot can carry out if left out.
        most_waypoints: A longer path is thinned evenly to this many waypoints.
        plain: The same task at a posture that was not chosen for accuracy, for `PLAIN`.
        force: What measured parts said of the force, which then goes with robots drawn from the posterior.
        announce: Called with what is done next.

    Raises:
        InputError: If a strategy does not suit the robot, or nothing of the path is cut.

    """
    noise = settle_force(settle_robot(task.robot, noise or NoiseTable()), force)
    if not task.compensated.any():
        raise InputError("nothing of the path is cut, there is nothing to compare")
    gears = bool(task.chain.actuator.any())
    chosen = tuple(strategies) if strategies else tuple(s for s in list_strategies() if gears or "encoder" not in s)
    if strategies and PLAIN in strategies and plain is None:
        raise InputError(f"strategy {PLAIN!r} needs a plain posture that reaches the whole path, leave it out")
    chosen = tuple(name for name in chosen if name != PLAIN or plain is not None)
    thin = thin_task(task, most_waypoints)
    if announce:
        announce(f"prepare {len(chosen)} strategies")
    blind = prepare_answers(task, [name for name in chosen if name not in ONLINE and name != PLAIN])
    if plain is not None and PLAIN in chosen:
        (there,) = prepare_answers(plain, ["nlp"]).values()
        blind[PLAIN] = replace(there, name=PLAIN, commands="as nlp, at a posture that was not chosen for accuracy")
    rows = thin_rows(len(task), most_waypoints)
    answers = {name: replace(answer, q=answer.q[rows]) for name, answer in blind.items()}
    answers |= prepare_answers(thin, [name for name in chosen if name in ONLINE])
    plant = Plant(noise.plant_lag_ms * 1e-3, noise.plant_delay_ms * 1e-3)
    answers = {
        name: answers[name] if (loop := answers[name].loop) is None
        else replace(answers[name], loop=replace(loop, plant=plant))
        for name in chosen
    }  # fmt: skip
    return assemble_study(thin, noise, answers, len(task), force)


def assemble_study(
    thin: PlanTask, noise: NoiseTable, answers: dict[str, Answer], waypoints: int, force: ForceSpread | None = None
) -> Study:
    """Put together what all samples share.

    Args:
        thin: The task, thinned where its path is long.
        noise: The standard deviations.
        answers: The strategies, prepared for the thinned task.
        waypoints: Number of waypoints of the whole path.
        force: What measured parts said of the force, or None.

    """
    selection = actuator_selection(thin.chain)
    encoders = next((c for c in answers.values() if c.sensor == "encoders"), None)
    columns, load = load_gears(thin, thin.q_start if encoders is None else encoders.q)
    loops = [c.loop for c in answers.values() if c.loop]
    cut = np.flatnonzero(thin.compensated)
    return Study(
        task=thin,
        waypoints_of_path=waypoints,
        answers=answers,
        workers={name: _make_worker(thin, c, selection, noise) for name, c in answers.items()},
        kernel=build_kernel(thin.chain),
        surroundings=survey_surroundings(thin, noise, list_factors(thin.robot, noise), force),
        gear=(
            np.abs(selection) @ np.diag(thin.chain.compliance),
            np.ascontiguousarray(np.moveaxis(columns, 0, -1)),
            np.ascontiguousarray(load.T),
        ),
        selection=selection,
        nominal=np.ascontiguousarray(thin.position.T),
        cut=thin.compensated,
        grid=_make_grid(thin, loops[0]) if loops else None,
        stations=cut[np.unique(np.linspace(0, len(cut) - 1, min(STATIONS, len(cut))).astype(int))],
        softened=_count_softened(thin),
    )


def thin_rows(n: int, most: int) -> NDArray[np.int_]:
    """Choose waypoints evenly, first and last included."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))


def thin_task(task: PlanTask, most: int) -> PlanTask:
    """Keep at most so many waypoints of a task."""
    rows = thin_rows(len(task), most)
    if len(rows) == len(task):
        return task
    time = np.concatenate([[0.0], np.cumsum(task.step_time)])
    return replace(
        task,
        nominal=select_waypoints(task.nominal, rows),
        rotation=task.rotation[rows],
        wrench=task.wrench[rows],
        compensated=task.compensated[rows],
        q_start=task.q_start[rows],
        missed=task.missed[rows],
        step_time=np.diff(time[rows]),
        start=None,
    )


def thin_study(study: Study, most: int) -> Study:
    """Thin a study further, its strategies prepared as they are."""
    rows = thin_rows(len(study.task), most)
    if len(rows) == len(study.task):
        return study
    answers = {
        name: replace(
            c,
            q=c.q[rows],
            gain=None if c.gain is None else c.gain[rows],
            expected=None if c.expected is None else c.expected[rows],
            q_rest=None if c.q_rest is None else c.q_rest[rows],
        )
        for name, c in study.answers.items()
    }
    posterior, thin = study.surroundings.posterior, thin_task(study.task, most)
    force = None if posterior is None else posterior.force
    return assemble_study(thin, study.noise, answers, study.waypoints_of_path, force)


def _make_grid(task: PlanTask, loop: Loop) -> TimeGrid:
    time = np.concatenate([[0.0], np.cumsum(task.step_time)])
    periods = np.arange(int(np.ceil(time[-1] / loop.period)) + 2) * loop.period
    return TimeGrid(np.interp(periods, time, np.arange(len(time))), time / loop.period)


def _count_softened(task: PlanTask) -> int:
    """Count the waypoints in the softened length, an odd number."""
    step = float(np.median(np.linalg.norm(np.diff(task.position, axis=0), axis=1)))
    return 2 * int(0.5 * SOFT_LENGTH / max(step, 1e-9)) + 1


def _make_worker(task: PlanTask, answer: Answer, selection: Array, noise: NoiseTable) -> Worker:
    beta = 0.0 if answer.beta is None else answer.beta
    state = control_equilibrium(task.chain, answer.q, task.wrench, feedback=answer.feedback, beta=beta)
    between = selection.any(axis=0)
    q_rest = answer.q if answer.q_rest is None else answer.q_rest
    offset = np.zeros((3, len(task)))
    if task.robot.effects:
        runs = [
            attain_with_effects(robot, answer.q, task.wrench, task.step_time)[0]
            for robot in (task.robot, replace(task.robot, effects=()))
        ]
        offset = (runs[0] - runs[1]).T
    elsewhere = np.abs(answer.q - task.q_start).max() > OTHER_POSTURE
    return Worker(
        q=np.ascontiguousarray(answer.q.T)[:, None, :],
        q_rest=np.ascontiguousarray(q_rest.T)[:, None, :],
        gain=None if answer.gain is None else np.ascontiguousarray(np.moveaxis(answer.gain, 0, -1)),
        expected=None if answer.expected is None else np.ascontiguousarray(answer.expected.T)[:, None, :],
        spring_gain=answer.spring_gain,
        spring_factor=np.where(between, answer.spring_gain @ np.abs(selection), 1.0),
        theta=np.ascontiguousarray(state.loaded.theta.T),
        offset=offset,
        placements=differentiate_placements(replace(task, q_start=answer.q), noise)[0] if elsewhere else None,
        touch=prepare_touch(task, noise, answer.touched),
    )
