"""Force sensor: the measured wrench goes through a stiffness model at every waypoint, without delay.

With the full model, or with a reduced one that has one spring a joint.
"""

from __future__ import annotations

from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.path_map import PathMap, PathMaps
from compplan.plan.task import PlanTask


def prepare_reduced(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the path that the measured wrench asks for by a model with one spring a joint."""
    return correct_by_wrench("force_sensor_reduced", "one compliance a joint", task, maps.reduced)


def prepare_full(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the path that the measured wrench asks for by the full model."""
    return correct_by_wrench("force_sensor_full", "the full stiffness model", task, maps.full)


def correct_by_wrench(name: str, knows: str, task: PlanTask, model: PathMap) -> Answer:
    """Correct by a measured wrench and a model solved along the path."""
    return Answer(
        name=name,
        knows=knows,
        measures="wrench at the tip",
        commands="the path corrected for the measured wrench",
        q=model.q,
        sensor="force",
        gain=model.wrench_gain,
        expected=task.wrench,
        q_rest=task.q_start,
    )
