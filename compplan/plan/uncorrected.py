"""Finished walls of a job whose arm is not corrected."""

from __future__ import annotations

from compplan.errors import InputError
from compplan.job.force_prediction import ForcePrediction
from compplan.plan.evaluate import evaluate_model
from compplan.plan.finished_walls import judge_surface
from compplan.plan.plan import build_task, prepare_job
from compplan.process.walls import WallError


def predict_surface(found: ForcePrediction) -> tuple[tuple[WallError, ...] | None, str]:
    """Work out the errors of the walls that the uncorrected tool leaves; None and a sentence where that fails."""
    if found.job.surface is None:
        return None, ""
    try:
        robot, _, options = prepare_job(found.job)
        task = build_task(robot, found.nominal, options, file=found.job.file)
    except InputError as error:
        return None, f"Finished walls were not looked at: {error.message}."
    away = evaluate_model(task, task.q_start).deviation
    walls = judge_surface(found.job, found.law, task.nominal, away)
    return (walls, "" if walls is not None else "No finished walls: no side of a cutter cuts.")
