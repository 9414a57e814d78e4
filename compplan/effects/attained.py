"""Loaded pose of the tool on a robot with effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.effects import (
    apply_effects,
    build_model,
    command_campaign,
    is_of_instrument,
    robot_effects,
    solve_model_poses,
)
from compplan.robot import Array, Robot

#: Effects that depend on the motion before or on the time: they count as zero at the touched points.
TRANSIENT = ("backlash", "thermal_drift", "tracking_lag")


def attain_with_effects(robot: Robot, q: Array, wrench: Array, step_time: Array) -> tuple[Array, Array]:
    """Predict the attained pose of a robot with the effects of its folder: position (n, 3) [m], orientation (n, 3, 3).

    The rows are passed in order at the programmed feed, in the state after the last shift.
    """
    campaign = command_campaign(q, wrench, time=np.r_[0.0, np.cumsum(step_time)])
    effects = [effect for effect in robot_effects(robot) if not is_of_instrument(effect.name)]
    attained = solve_model_poses(apply_effects(build_model(robot, campaign, later=True), effects))
    return attained.position, attained.rotation


def rest_robot(robot: Robot) -> Robot:
    """Return the robot without the effects that depend on the motion before or on the time."""
    kept = tuple(table for table in robot.effects if table.get("effect") not in TRANSIENT)
    return robot if len(kept) == len(robot.effects) else replace(robot, effects=kept)
