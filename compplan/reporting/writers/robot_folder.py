"""Write a robot folder and read it back; convert the calibration of a controller to a robot folder.

A robot folder is delivered only if it can be read and its equilibrium solved.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compplan.effects import apply_effects, build_model, command_campaign, robot_effects, solve_model_poses
from compplan.errors import ConvergenceError, InputError
from compplan.io.provenance import describe_origin
from compplan.io.tables import read_text, write_json
from compplan.io.transaction import replace_folder
from compplan.robot import Robot, read_robot_folder, write_robot_folder
from compplan.robot.calibration import read_calibration


def deliver_robot_folder(robot: Robot, folder: Path, before: Robot | None = None) -> Robot:
    """Write a robot folder, read it back and solve its equilibrium at zero joint positions, clipped to the limits.

    Returns the robot as read; `before`: the robot before the measurement, see `write_robot_folder`.
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


def write_calibrated(file: Path, nominal: Robot, folder: Path) -> dict[str, Any]:
    """Read the calibration of a controller, write DIR/robot and calibration.json; return the content of the JSON."""
    robot, form = read_calibration(read_text(file), file, nominal)
    robot = replace(robot, sources={**robot.sources, "geometry": f"calibration of the controller, {file.name}"})
    summary = {"schema": 1, "robot": nominal.name, "format": form, "made_by": describe_origin()}
    with replace_folder(folder, "calibration") as part:
        deliver_robot_folder(robot, part / "robot")
        write_json(part / "calibration.json", summary)
    return summary
