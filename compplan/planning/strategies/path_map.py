"""What online strategies work out beforehand from their model: the exact command along the path, and how it answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compplan.identification.reduce import reduce_model
from compplan.planning.strategies import iterated_mirror
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.elastic import loaded_compliance
from compplan.statics.encoders import gear_compliance
from compplan.statics.sensitivity import attain_pose

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
