"""Both encoders: a share beta of the measured gear deflection compensates the deflection beyond the encoder.

q_link + beta (q_link - q_motor) = q with one gain per joint [Klimchik2018], from two compliances of the model: gear,
and gear with links about the joint axis (`compplan.statics.encoders.combined_gain`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.identification.reduce import reduce_model
from compplan.planning.task import Command, PlanTask
from compplan.robot import Robot
from compplan.statics.encoders import combined_gain, gear_compliance

words = "both encoders"

#: Number of poses that the reduced model is fitted to, and their spread about the path. [rad or m]
REDUCTION_POSES, REDUCTION_SPREAD = 60, 0.5
#: Force where the task predicts none. [N]
TYPICAL_FORCE = 500.0


def command_path(task: PlanTask) -> Command:
    """Command the nominal path, controlled by a combination of both encoders."""
    total = np.zeros(task.robot.nq)
    for spring in reduce_near_path(task).springs:
        total[task.robot.joint_names.index(spring.joint)] = spring.compliance
    return Command(task.q_start, feedback="combined", beta=combined_gain(gear_compliance(task.chain), total))


def reduce_near_path(task: PlanTask) -> Robot:
    """Fit one spring per joint to the model, at random poses about the path under forces in all directions, seeded.

    Moments have a lever of 0.1 m. The spread avoids a fit that holds on the path only; a careful identification would
    yield a similar model.
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
