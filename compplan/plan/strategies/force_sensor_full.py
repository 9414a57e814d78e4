"""Force sensor: the measured wrench goes through the full stiffness model at every waypoint, without delay."""

from __future__ import annotations

from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.path_map import PathMaps, correct_by_wrench
from compplan.plan.task import PlanTask

words = "force sensor (all)"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the path that the measured wrench asks for by the full model."""
    return correct_by_wrench("force_sensor_full", "the full stiffness model", task, maps.full)
