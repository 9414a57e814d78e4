"""Both encoders: a share beta of the gear's measured deflection stands for what bends beyond the encoder.

q_link + beta (q_link - q_motor) = q with one gain a joint [Klimchik2018], from two compliances of the model: of the
gear, and of gear and links together about the joint's axis (`compplan.statics.encoders.combined_gain`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.identification.reduce import reduce_model
from compplan.planning.strategies.online import Answer
from compplan.planning.task import PlanTask
from compplan.robot import Robot
from compplan.statics.encoders import combined_gain, gear_compliance

words = "encoders on both sides"

#: Poses and loads that a reduced model stands for: their number, and their spread about the path. [rad or m]
REDUCTION_POSES, REDUCTION_SPREAD = 60, 0.5
#: Level of force where the task predicts none. [N]
TYPICAL_FORCE = 500.0


def prepare(task: PlanTask) -> Answer:
    """Command the nominal path, held by a combination of both encoders."""
    total = np.zeros(task.robot.nq)
    for spring in reduce_near_path(task).springs:
        total[task.robot.joint_names.index(spring.joint)] = spring.compliance
    return Answer("both_encoders", task.q_start, "combined", combined_gain(gear_compliance(task.chain), total))


def reduce_near_path(task: PlanTask) -> Robot:
    """Fit one spring a joint to the model, at poses spread about the path under forces in all directions, seeded.

    Moments have a lever of 0.1 m. The spread keeps the fit from serving the path alone: this is what a careful
    identification would give.
    """
    robot = task.robot
    rng = np.random.default_rng(20180)
    rows = rng.integers(0, len(task), REDUCTION_POSES)
    q = task.q_start[rows] + rng.uniform(-REDUCTION_SPREAD, REDUCTION_SPREAD, (REDUCTION_POSES, robot.nq))
    q = np.clip(q, robot.lower, robot.upper)
    level = float(np.linalg.norm(task.wrench[:, :3], axis=1).max(initial=0.0)) or TYPICAL_FORCE
    directions = rng.normal(size=(2, len(q), 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    wrenches = np.hstack([level * directions[0], 0.1 * level * directions[1]])
    return reduce_model(replace(robot, effects=()), q, wrenches).robot
