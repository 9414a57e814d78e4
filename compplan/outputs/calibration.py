"""What `compplan calibration` writes: a folder with a controller's geometry, or a controller's file from a folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from compplan.cell.calibration_loss import POSES, judge_losses
from compplan.errors import InputError
from compplan.files.origin import describe_origin
from compplan.files.tables import read_text, write_json, write_text
from compplan.files.transaction import check_file, replace_folder
from compplan.robot import Robot
from compplan.robot.calibration import FORMATS, find_format
from compplan.robot.folder import write_robot_folder


def write_calibrated(file: Path, nominal: Robot, folder: Path) -> dict[str, Any]:
    """Read a controller's calibration; write DIR/robot and calibration.json, and return what that holds.

    Raises:
        InputError: If the file is none that is known, is faulty, or is of another robot; nothing is written then.
    """
    text = read_text(file)
    form = find_format(text, file)
    robot = form.read(text, file, nominal)
    robot = replace(robot, sources={**robot.sources, "geometry": f"calibration of the controller, {file.name}"})
    summary = {"schema": 1, "robot": nominal.name, "format": form.name, "made_by": describe_origin()}
    with replace_folder(folder, "calibration") as part:
        write_robot_folder(robot, part / "robot")
        write_json(part / "calibration.json", summary)
    return summary


def write_controller_file(robot: Robot, nominal: Robot, controller: str, file: Path) -> dict[str, Any]:
    """Write a controller's calibration from a measured robot folder; return what it loses.

    Raises:
        InputError: If the controller's format is not written, or the robots are of other kinds.
    """
    write = FORMATS[controller].write
    if write is None:
        written = [name for name, form in FORMATS.items() if form.write is not None]
        raise InputError(f"--controller {controller} is read only, choose from {written}")
    if robot.joint_names != nominal.joint_names:
        raise InputError(f"robot {robot.name!r} has other joints than {nominal.name!r}, expected a folder made from it")
    check_file(file)
    text, held = write(robot, nominal)
    losses, left = judge_losses(robot, held, nominal)
    rows = [{"what": loss.what, "rms_mm": float(f"{loss.rms * 1e3:.4g}")} for loss in losses]
    write_text(file, text)
    return {
        "schema": 1, "robot": robot.name, "format": controller, "poses": POSES, "lost": rows,
        "left_rms_mm": float(f"{left * 1e3:.4g}"), "made_by": describe_origin(),
    }  # fmt: skip
