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
from compplan.planning.strategies.online import ONLINE, Answer, list_strategies, prepare_answers
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.encoders import actuator_selection, control_equilibrium
from compplan.studies.factors import list_factors
from compplan.studies.kernel import Kernel, build_kernel
from compplan.studies.posterior import settle_force
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
#: Joints this far from the task's posture need placement errors of their own. [rad or m]
OTHER_POSTURE = 0.05
#: Stations along the path whose distances are kept.
STATIONS = 120


class Worker(NamedTuple):
    """An answer, components first, ready for many samples."""

    q: Array  #: Shape (nq, 1, n). [rad or m]
    gain: Array | None  #: Shape (nq, k, n), or None.
    expected: Array | None  #: Shape (k, 1, n), or None.
    spring_gain: Array  #: Factor on what each gear yields. Shape (nq,).
    spring_factor: Array  #: The same for every elastic coordinate, 1 where no encoder measures it. Shape (s,).
    theta: Array  #: Elastic coordinates by the model. Shape (s, n). [rad or m]
    offset: Array  #: Motion of the tip by the effects of the robot folder. Shape (3, n). [m]
    #: Motion of the tip per placement error where the posture is another than the task's. Shape (k, 3, n).
    placements: Array | None = None
    touch: Touch | None = None  #: How the strategy's robot finds the part, None where its frame is absolute.


@dataclass(frozen=True)
class Study:
    """What all samples of a study share."""

    task: PlanTask  #: The task, thinned where it is long.
    waypoints_of_path: int  #: Number of waypoints of the whole path.
    answers: dict[str, Answer]  #: The strategies.
    workers: dict[str, Worker]  #: The same, ready for many samples.
    kernel: Kernel  #: The kernel.
    surroundings: Surroundings  #: Noise and what it acts on.
    nominal: Array  #: Wanted tips. Shape (3, n). [m]
    cut: NDArray[np.bool_]  #: Waypoints that count. Shape (n,).
    stations: NDArray[np.int_]  #: Waypoints whose distances are kept. Shape (k,).

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
    force: ForceSpread | None = None,
    announce: Callable[[str], None] | None = None,
) -> Study:
    """Prepare a study.

    Args:
        task: The task.
        noise: The standard deviations; the defaults if left out.
        strategies: The strategies; all that the robot can carry out if left out.
        most_waypoints: A longer path is thinned evenly to this many.
        force: What measured parts said of the force, which then goes with robots drawn from the posterior.
        announce: Called with what is done next.

    Raises:
        InputError: If a strategy does not suit the robot, or nothing of the path is cut.
    """
    noise = settle_force(noise or NoiseTable(), force)
    if not task.compensated.any():
        raise InputError("the path has no cutting moves, nothing to compare")
    chosen = tuple(strategies) if strategies else list_strategies(task.robot)
    thin = thin_task(task, most_waypoints)
    if announce:
        announce(f"prepare {len(chosen)} strategies")
    blind = prepare_answers(task, [name for name in chosen if name not in ONLINE])
    rows = thin_rows(len(task), most_waypoints)
    answers = {name: replace(answer, q=answer.q[rows]) for name, answer in blind.items()}
    answers |= prepare_answers(thin, [name for name in chosen if name in ONLINE])
    return assemble_study(thin, noise, {name: answers[name] for name in chosen}, len(task), force)


def assemble_study(
    thin: PlanTask, noise: NoiseTable, answers: dict[str, Answer], waypoints: int, force: ForceSpread | None = None
) -> Study:
    """Put together what all samples share, of a thinned task of a path of `waypoints` and answers prepared for it."""
    selection = actuator_selection(thin.chain)
    cut = np.flatnonzero(thin.compensated)
    return Study(
        task=thin,
        waypoints_of_path=waypoints,
        answers=answers,
        workers={name: _make_worker(thin, c, selection, noise) for name, c in answers.items()},
        kernel=build_kernel(thin.chain),
        surroundings=survey_surroundings(thin, noise, list_factors(thin.robot, noise), force),
        nominal=np.ascontiguousarray(thin.position.T),
        cut=thin.compensated,
        stations=cut[np.unique(np.linspace(0, len(cut) - 1, min(STATIONS, len(cut))).astype(int))],
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
        )
        for name, c in study.answers.items()
    }
    posterior, thin = study.surroundings.posterior, thin_task(study.task, most)
    force = posterior.force
    return assemble_study(thin, study.noise, answers, study.waypoints_of_path, force)


def _make_worker(task: PlanTask, answer: Answer, selection: Array, noise: NoiseTable) -> Worker:
    beta = 0.0 if answer.beta is None else answer.beta
    state = control_equilibrium(task.chain, answer.q, task.wrench, feedback=answer.feedback, beta=beta)
    between = selection.any(axis=0)
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
        gain=None if answer.gain is None else np.ascontiguousarray(np.moveaxis(answer.gain, 0, -1)),
        expected=None if answer.expected is None else np.ascontiguousarray(answer.expected.T)[:, None, :],
        spring_gain=answer.spring_gain,
        spring_factor=np.where(between, answer.spring_gain @ np.abs(selection), 1.0),
        theta=np.ascontiguousarray(state.loaded.theta.T),
        offset=offset,
        placements=differentiate_placements(replace(task, q_start=answer.q), noise)[0] if elsewhere else None,
        touch=prepare_touch(task, noise, answer.touched),
    )
