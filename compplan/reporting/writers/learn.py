"""What `compplan learn` writes: the updated robot folder, the corrected program and its plan, learn.json, the page."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json, write_table
from compplan.io.transaction import list_files, replace_folder
from compplan.learning.part import LearnedPart
from compplan.learning.residual import Residual, residual_file
from compplan.process.learned_force import FILE as PROCESS
from compplan.process.learned_force import write_learned_force
from compplan.reporting.learn_page import write_learn_page
from compplan.reporting.plan_page import write_plan_page
from compplan.reporting.writers.plan import choose_rows, summarise_plan, write_joints, write_programs
from compplan.reporting.writers.recording import write_deviation
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Robot


def write_learning(teaching: LearnedPart, folder: Path) -> dict[str, Any]:
    """Write what a part taught and return what learn.json holds.

    Args:
        teaching: The lesson with its plans.
        folder: The folder.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    with replace_folder(folder, "learn") as part:
        write_updated(teaching, part / "robot")
        write_programs(teaching.after, part)
        write_joints(teaching.after, part / "joints.csv", teaching.wanted)
        write_deviation(teaching.after, part / "deviation.csv", choose_rows(teaching.after))
        write_plan_page(teaching.after, part / "plan.html")
        write_json(part / "plan.json", summarise_plan(teaching.after), indent=2)
        write_learn_page(teaching, part / "report.html")
        summary = {**summarise_update(teaching), "files": [*map(str, list_files(part)), "learn.json"]}
        write_json(part / "learn.json", summary, indent=2)
    return summary


def write_updated(teaching: LearnedPart, folder: Path) -> None:
    """Write the robot folder as it is known now, with what every path has learned."""
    deliver_robot_folder(teaching.taught, folder, teaching.robot)
    source = teaching.robot.folder
    if source is not None:
        for file in (*source.glob("learned_*.csv"), *source.glob("registration.toml")):
            shutil.copyfile(file, folder / file.name)
    if teaching.force is not None:
        write_learned_force(teaching.force, teaching.job.process, folder, source)
    elif source is not None and (source / PROCESS).is_file():
        shutil.copyfile(source / PROCESS, folder / PROCESS)
    name = residual_file(teaching.robot, teaching.job)
    file_name = f"learned_{teaching.job.file.stem}.csv" if name is None else name.name
    if teaching.lesson.taken:
        write_residual(teaching.residual, teaching.robot, folder / file_name)


def write_residual(residual: Residual, robot: Robot, file: Path) -> None:
    """Write what a path has learned, with the posture in which it has."""
    columns: dict[str, object] = {"s_mm": residual.length * 1e3}
    columns |= {f"d{axis}_mm": residual.deviation[:, k] * 1e3 for k, axis in enumerate("xyz")}
    columns["sigma_mm"] = residual.spread * 1e3
    columns |= robot.joint_columns(residual.q)
    for number, own in enumerate(np.moveaxis(residual.open, 2, 0), 1):
        columns |= {f"u{number}{axis}_mm": own[:, k] * 1e3 for k, axis in enumerate("xyz")}
    write_table(file, columns, decimals=10)


def summarise_update(teaching: LearnedPart) -> dict[str, Any]:
    """Return the content of learn.json."""
    lesson = teaching.lesson
    return {
        "schema": 1,
        "name": teaching.job.name or teaching.job.file.stem,
        "robot": teaching.robot.name,
        "step_taken": lesson.taken,
        "reason": lesson.reason,
        "status": teaching.after.status,
        "verdict": teaching.after.verdict.describe(),
        "points": len(teaching.measured),
        "points_left_out": teaching.measured.left_out,
        "measured_rms_mm": lesson.rms * 1e3,
        "held_out_rms_mm": lesson.held_out * 1e3 if np.isfinite(lesson.held_out) else None,
        "expected_rms_mm": lesson.expected * 1e3 if lesson.taken else None,
        "physics_rms_mm": _rms(lesson.physics) * 1e3,
        "force_rms_mm": _rms(lesson.pushed) * 1e3,
        "residual_rms_mm": _rms(lesson.residual) * 1e3,
        "band_before_mm": _describe_band(lesson.band_before, lesson.band_seen[0]),
        "band_after_mm": _describe_band(lesson.band_after, lesson.band_seen[1]),
        "told_other_paths": {
            "force": teaching.travel.force and lesson.taken,
            "robot": teaching.travel.robot and lesson.taken,
            "left_mm": dict(
                zip(
                    ("nothing", "force", "force_and_robot"),
                    (1e3 * value if np.isfinite(value) else None for value in teaching.travel.left),
                    strict=True,
                )
            ),
            "force_level": None if teaching.force is None else teaching.force.level,
        },
        "learned": [
            {"unknown": one.name, "value_SI": one.value, "width_before_SI": one.width, "in_robot_folder": one.kept}
            for one in teaching.learned
        ],
        "notes": list(teaching.notes),
        "made_by": describe_origin(),
    }


def _describe_band(band: np.ndarray[Any, Any], seen: np.ndarray[Any, Any]) -> dict[str, float]:
    """Return the widest band in all directions, and in those that were measured. [mm]"""
    return {"p95_max": float(band.max()) * 1e3, "p95_max_in_measured_directions": float(seen.max()) * 1e3}


def _rms(vectors: np.ndarray[Any, Any]) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
