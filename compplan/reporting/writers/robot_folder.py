"""Write a robot folder and read it back: nothing is delivered that a command cannot read and solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.effects import apply_effects, build_model, command_campaign, robot_effects, solve_model_poses
from compplan.errors import ConvergenceError, InputError
from compplan.robot import Robot, read_robot_folder, write_robot_folder


def deliver_robot_folder(robot: Robot, folder: Path, before: Robot | None = None) -> Robot:
    """Write a robot folder, read it as every command does and solve its equilibrium in the middle of its joint ranges.

    Returns the robot as read; `before`: the robot before it was measured, as `write_robot_folder` takes it.

    Raises:
        InputError: If the folder cannot be read, or its robot finds no equilibrium.
    """
    write_robot_folder(robot, folder, before)
    read = read_robot_folder(folder)
    middle = np.clip(0.0, read.lower, read.upper)[None]
    try:
        attained = solve_model_poses(apply_effects(build_model(read, command_campaign(middle)), robot_effects(read)))
    except ConvergenceError as error:
        raise InputError(f"the identified robot has no static equilibrium: {error}", file=folder) from None
    if not np.isfinite(attained.position).all():
        raise InputError("the identified robot has no static equilibrium", file=folder)
    return read
