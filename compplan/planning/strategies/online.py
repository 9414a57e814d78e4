"""The strategies of a study: those of a plan, which command blindly, and those that read sensors while the part is cut.

A new online strategy is one new file with `prepare(task, maps) -> Answer` and one line in
`compplan.job.names`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from compplan.errors import UnknownNameError
from compplan.identification.reduce import reduce_model
from compplan.io.plugins import Registry
from compplan.job import names
from compplan.planning.strategies import STRATEGIES, command_path, iterated_mirror
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.elastic import loaded_compliance
from compplan.statics.encoders import feedback_scale, gear_compliance
from compplan.statics.sensitivity import attain_pose
from compplan.uncertainty.touch_off import TouchedPart


class OnlineStrategy(Protocol):
    """What the file of a strategy that reads sensors offers; `words` say in a few words what it is, on pages."""

    def prepare(self, task: PlanTask, maps: PathMaps) -> Answer:
        """Prepare for a task, from its own model of the robot."""
        ...


#: Every strategy that reads sensors, by the name of its file.
ONLINE: Registry[OnlineStrategy] = names.ONLINE.held_by(str(__package__))

_OFFLINE_KNOWLEDGE = {"none": "geometry"}


def list_strategies(robot: Robot | None = None) -> tuple[str, ...]:
    """List every strategy by name, those of a plan and those that read sensors; of a robot: that it can carry out."""
    gears = robot is None or any(spring.actuator for spring in robot.springs)
    return tuple(name for name in (*STRATEGIES, *ONLINE) if gears or "encoder" not in name)


def hold_robot(robot: Robot, spring_gain: Array) -> Robot:
    """Return the robot whose springs yield what a feedback leaves of them (`Answer.spring_gain`)."""
    gains = dict(zip(robot.joint_names, spring_gain, strict=True))
    gain = np.array([gains.get(spring.joint, 1.0) if spring.actuator else 1.0 for spring in robot.springs])
    scale = feedback_scale(gain, np.array([spring.link_share for spring in robot.springs]))
    held = (replace(s, compliance=float(k) * s.compliance) for s, k in zip(robot.springs, scale, strict=True))
    return replace(robot, springs=tuple(held))


def prepare_answers(task: PlanTask, strategies: Sequence[str] | None = None) -> dict[str, Answer]:
    """Let strategies (all if left out) prepare themselves for a task.

    Raises:
        UnknownNameError: If there is no such strategy.
        InputError: If a strategy does not suit the robot.
    """
    maps, answers = PathMaps(task), {}
    for name in list_strategies() if strategies is None else strategies:
        if name in ONLINE:
            answers[name] = ONLINE[name].prepare(task, maps)
        elif name in STRATEGIES:
            command = command_path(task, name)
            answers[name] = Answer(
                name=name,
                knows=_OFFLINE_KNOWLEDGE.get(name, "the full stiffness model and the predicted wrench"),
                measures="nothing",
                commands="a joint program made beforehand",
                q=command.q,
            )
        else:
            raise UnknownNameError("strategy", name, list(list_strategies()))
    return {name: replace(answer, touched=task.touched) for name, answer in answers.items()}


@dataclass(frozen=True)
class Answer:
    """A strategy at work; n waypoints, nq joints.

    Attributes:
        name: Name of the strategy.
        knows: What it knows, in words.
        measures: What it measures, in words.
        commands: What it commands, in words.
        q: Command at the expected reading. Shape (n, nq). [rad or m]
        feedback: Which reading the axes are held by: "motor", "link" or "combined" (`compplan.statics.encoders`).
        beta: Share of combined feedback. Shape (nq,).
        gain: Change of the command per measured wrench at the tip, base axes; None without a force sensor.
            Shape (n, nq, 6). [rad/N, rad/(N m)]
        expected: The wrench expected. Shape (n, 6). [N, N m]
        touched: The part as it was found by touching, at the posture of the strategy, or None.

    """

    name: str
    knows: str
    measures: str
    commands: str
    q: Array
    feedback: str = "motor"
    beta: Array | None = None
    gain: Array | None = None
    expected: Array | None = None
    touched: TouchedPart | None = None

    @property
    def spring_gain(self) -> Array:
        """What the feedback leaves of each gear's deflection: 1, 0 or -beta. Shape (nq,)."""
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


#: Poses and loads that a reduced model stands for: their number, and their spread about the path. [rad or m]
REDUCTION_POSES, REDUCTION_SPREAD = 60, 0.5
#: Level of force where the task predicts none. [N]
TYPICAL_FORCE = 500.0


@dataclass(frozen=True)
class PathMap:
    """A model solved along a path; n waypoints.

    Attributes:
        task: The task, its chain being the model that was solved.
        q: Command whose loaded tool stands on the path, rotation about the tool axis held. Shape (n, nq). [rad or m]
        wrench_gain: Change of the command per change of the wrench. Shape (n, nq, 6). [rad/N, rad/(N m)]

    """

    task: PlanTask
    q: Array
    wrench_gain: Array


def solve_path_map(task: PlanTask) -> PathMap:
    """Solve a task's model for the exact command, and differentiate it with respect to the wrench."""
    q = iterated_mirror.command_path(task).q
    attained = attain_pose(task.chain, q, task.wrench)
    inverse = np.asarray(np.linalg.pinv(attained.jacobian), float)
    compliance = loaded_compliance(task.chain, q, task.wrench)
    held = task.compensated[:, None, None]
    return PathMap(task, q, -(inverse @ compliance) * held)


@dataclass(frozen=True)
class PathMaps:
    """The models of a task, each solved once when it is first asked for."""

    task: PlanTask

    @cached_property
    def full(self) -> PathMap:
        """The model as it is."""
        return solve_path_map(self.task)

    @cached_property
    def reduced_robot(self) -> Robot:
        """The model with one spring a joint that stands for everything that bends, as identified near the path."""
        return reduce_near_path(self.task)

    @cached_property
    def gear_compliance(self) -> Array:
        """Compliance between the encoders of each joint, 0 where there is none. Shape (nq,). [rad/(N m)]"""
        return gear_compliance(self.task.chain)


def reduce_near_path(task: PlanTask) -> Robot:
    """Fit one spring a joint to the model, at poses spread about the path under forces in all directions, seeded.

    The spread keeps the fit from serving the path alone: this is what a careful identification would give.
    """
    robot = task.robot
    rng = np.random.default_rng(20180)
    rows = rng.integers(0, len(task), REDUCTION_POSES)
    q = task.q_start[rows] + rng.uniform(-REDUCTION_SPREAD, REDUCTION_SPREAD, (REDUCTION_POSES, robot.nq))
    q = np.clip(q, robot.lower, robot.upper)
    level = float(np.linalg.norm(task.wrench[:, :3], axis=1).max(initial=0.0)) or TYPICAL_FORCE
    return reduce_model(replace(robot, effects=()), q, spread_wrenches(len(q), level, rng)).robot


def spread_wrenches(count: int, level: float, rng: np.random.Generator) -> Array:
    """Draw forces of one level in all directions, with moments of a lever of 0.1 m. Shape (count, 6). [N, N m]"""
    directions = rng.normal(size=(2, count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return np.hstack([level * directions[0], 0.1 * level * directions[1]])
