"""Strategies of a study: offline strategies of a plan, and online strategies that read sensors during the cut.

A new online strategy is one new file with `prepare(task) -> OnlineCommand` and one line in `compplan.job.names`.
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
    """Interface of an online strategy's file; `words` is the displayed name."""

    def prepare(self, task: PlanTask) -> OnlineCommand:
        """Compute command and sensor gains for a task, from the robot model of the task."""


#: Every online strategy, by file name.
ONLINE: Registry[OnlineStrategy] = names.ONLINE.held_by(str(__package__))


def list_strategies(robot: Robot | None = None) -> tuple[str, ...]:
    """List the names of all offline and online strategies; with a robot, only those applicable to it."""
    gears = robot is None or any(spring.actuator for spring in robot.springs)
    return tuple(name for name in (*STRATEGIES, *ONLINE) if gears or "encoder" not in name)


def hold_robot(robot: Robot, spring_gain: Array) -> Robot:
    """Return the robot with the spring compliances that remain under feedback (`OnlineCommand.spring_gain`)."""
    gains = dict(zip(robot.joint_names, spring_gain, strict=True))
    gain = np.array([gains.get(spring.joint, 1.0) if spring.actuator else 1.0 for spring in robot.springs])
    scale = feedback_scale(gain, np.array([spring.link_share for spring in robot.springs]))
    held = (replace(s, compliance=float(k) * s.compliance) for s, k in zip(robot.springs, scale, strict=True))
    return replace(robot, springs=tuple(held))


def prepare_commands(task: PlanTask, strategies: Sequence[str] | None = None) -> dict[str, OnlineCommand]:
    """Compute command and sensor gains of strategies (default: all) for a task.

    Raises:
        UnknownNameError: If a strategy does not exist.
        InputError: If a strategy is not applicable to the robot.
    """
    commands = {}
    for name in list_strategies() if strategies is None else strategies:
        if name in ONLINE:
            commands[name] = ONLINE[name].prepare(task)
        elif name in STRATEGIES:
            commands[name] = OnlineCommand(name, command_path(task, name).q)
        else:
            raise UnknownNameError("strategy", name, list(list_strategies()))
    return commands


@dataclass(frozen=True)
class OnlineCommand:
    """Command of a strategy and its sensor feedback; n waypoints, nq joints."""

    name: str  #: Name of the strategy.
    q: Array  #: Command at the expected wrench. Shape (n, nq). [rad or m]
    #: Encoder that the axes are controlled by: "motor", "link" or "combined" (`compplan.statics.encoders`).
    feedback: str = "motor"
    beta: Array | None = None  #: Share of combined feedback. Shape (nq,).
    #: Change of the command per measured wrench at the tip, base axes; None without a force sensor.
    #: Shape (n, nq, 6). [rad/N, rad/(N m)]
    gain: Array | None = None
    expected: Array | None = None  #: Expected wrench at the tip, base axes. Shape (n, 6). [N, N m]

    @property
    def spring_gain(self) -> Array:
        """Share of each gear's deflection that remains under feedback: 1, 0 or -beta. Shape (nq,)."""
        nq = self.q.shape[1]
        if self.feedback == "motor":
            return np.ones(nq)
        if self.feedback == "link":
            return np.zeros(nq)
        return -np.broadcast_to(np.asarray(self.beta, float), (nq,))


def correct_online(gain: Array, reading: Array) -> Array:
    """Compute the command change (nq, b, n) [rad or m] for b samples: gain (nq, k, n) times reading (k, b, n)."""
    change = np.zeros((len(gain), *reading.shape[1:]))
    for row, rates in zip(change, gain, strict=True):
        for rate, part in zip(rates, reading, strict=True):
            row += rate * part
    return change
