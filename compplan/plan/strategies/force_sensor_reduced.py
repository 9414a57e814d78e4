"""Force sensor: the measured wrench goes through a model with one spring a joint, without delay."""

from __future__ import annotations

from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.path_map import PathMaps, correct_by_wrench
from compplan.plan.task import PlanTask

words = "force sensor (joints)"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the path that the measured wrench asks for by a model with one spring a joint."""
    return correct_by_wrench("force_sensor_reduced", "one compliance a joint", task, maps.reduced)
