"""Strategies of a study: those of a plan, without sensors, and those that read sensors during the cut.

A new online strategy is one new file with `prepare(task) -> Answer` and one line in
`compplan.job.names`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.job import names
from compplan.planning.strategies import STRATEGIES, command_path
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.encoders import feedback_scale


class OnlineStrategy(Protocol):
    """Interface of the file of a strategy that reads sensors; `words` is its name on pages."""

    def prepare(self, task: PlanTask) -> Answer:
        """Prepare for a task, from its own model of the robot."""


#: Every strategy that reads sensors, by the name of its file.
ONLINE: Registry[OnlineStrategy] = names.ONLINE.held_by(str(__package__))


def list_strategies(robot: Robot | None = None) -> tuple[str, ...]:
    """List every strategy by name, those of a plan and those that read sensors; of a robot: that it can carry out."""
    gears = robot is None or any(spring.actuator for spring in robot.springs)
    return tuple(name for name in (*STRATEGIES, *ONLINE) if gears or "encoder" not in name)


def hold_robot(robot: Robot, spring_gain: Array) -> Robot:
    """Return the robot with the compliance that a feedback leaves of its springs (`Answer.spring_gain`)."""
    gains = dict(zip(robot.joint_names, spring_gain, strict=True))
    gain = np.array([gains.get(spring.joint, 1.0) if spring.actuator else 1.0 for spring in robot.springs])
    scale = feedback_scale(gain, np.array([spring.link_share for spring in robot.springs]))
    held = (replace(s, compliance=float(k) * s.compliance) for s, k in zip(robot.springs, scale, strict=True))
    return replace(robot, springs=tuple(held))


def prepare_answers(task: PlanTask, strategies: Sequence[str] | None = None) -> dict[str, Answer]:
    """Prepare strategies (all if left out) for a task.

    Raises:
        UnknownNameError: If there is no such strategy.
        InputError: If a strategy does not suit the robot.
    """
    answers = {}
    for name in list_strategies() if strategies is None else strategies:
        if name in ONLINE:
            answers[name] = ONLINE[name].prepare(task)
        elif name in STRATEGIES:
            answers[name] = Answer(name, command_path(task, name).q)
        else:
            raise UnknownNameError("strategy", name, list(list_strategies()))
    return answers


@dataclass(frozen=True)
class Answer:
    """The command of a strategy and its reaction to sensors; n waypoints, nq joints."""

    name: str  #: Name of the strategy.
    q: Array  #: Command at the expected reading. Shape (n, nq). [rad or m]
    #: Which reading the axes are held by: "motor", "link" or "combined" (`compplan.statics.encoders`).
    feedback: str = "motor"
    beta: Array | None = None  #: Share of combined feedback. Shape (nq,).
    #: Change of the command per measured wrench at the tip, base axes; None without a force sensor. Shape (n, nq, 6).
    #: [rad/N, rad/(N m)]
    gain: Array | None = None
    expected: Array | None = None  #: The wrench expected. Shape (n, 6). [N, N m]

    @property
    def spring_gain(self) -> Array:
        """Share of each gear's deflection that the feedback leaves: 1, 0 or -beta. Shape (nq,)."""
        nq = self.q.shape[1]
        if self.feedback == "motor":
            return np.ones(nq)
        if self.feedback == "link":
            return np.zeros(nq)
        return -np.broadcast_to(np.asarray(self.beta, float), (nq,))


def answer_reading(gain: Array, reading: Array) -> Array:
    """Return the change of the command (nq, b, n) [rad or m] for b samples: gain (nq, k, n) times reading (k, b, n)."""
    answer = np.zeros((len(gain), *reading.shape[1:]))
    for row, rates in zip(answer, gain, strict=True):
        for rate, part in zip(rates, reading, strict=True):
            row += rate * part
    return answer
