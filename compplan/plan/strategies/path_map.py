"""What online strategies work out beforehand from their model: the exact command along the path, and how it answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compplan.identification.reduce import reduce_model
from compplan.plan.strategies import iterated_mirror
from compplan.plan.strategies.answer import Answer
from compplan.plan.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain
from compplan.statics.elastic import loaded_compliance, solve_equilibrium
from compplan.statics.encoders import actuator_selection
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
    def reduced(self) -> PathMap:
        """The reduced model."""
        robot = self.reduced_robot
        return solve_path_map(replace(self.task, robot=robot, chain=build_chain(robot)))

    @cached_property
    def gear_compliance(self) -> Array:
        """Compliance between the encoders of each joint, 0 where there is none. Shape (nq,). [rad/(N m)]"""
        return np.abs(actuator_selection(self.task.chain)) @ np.diag(self.task.chain.compliance)

    @cached_property
    def gear_columns(self) -> Array:
        """Load on each gear per wrench, in the loaded state of the full model. Shape (n, nq, 6)."""
        return load_gears(self.task, self.full.q)[0]

    @cached_property
    def gear_load(self) -> Array:
        """Load on each gear under the predicted wrench, weights included. Shape (n, nq). [N m or N]"""
        return load_gears(self.task, self.full.q)[1]


def load_gears(task: PlanTask, q: Array) -> tuple[Array, Array]:
    """Compute the load on each gear: per wrench, shape (n, nq, 6), and as predicted, shape (n, nq)."""
    from compplan.statics.chain import jacobian

    loaded = solve_equilibrium(task.chain, q, task.wrench)
    columns = jacobian(task.chain, loaded.frames)[:, :, task.chain.spring_elements]
    selection = actuator_selection(task.chain)
    return np.einsum("js,nks->njk", selection, columns), loaded.torque @ selection.T


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


def correct_by_wrench(name: str, knows: str, task: PlanTask, model: PathMap) -> Answer:
    """Correct by a measured wrench and a model solved along the path."""
    return Answer(
        name=name,
        knows=knows,
        measures="wrench at the tip",
        commands="the path corrected for the measured wrench",
        q=model.q,
        sensor="force",
        gain=model.wrench_gain,
        expected=task.wrench,
        q_rest=task.q_start,
    )
