"""Force sensor: the measured wrench goes through the stiffness model at every waypoint, without delay."""

from __future__ import annotations

from compplan.planning.strategies.online import Answer, PathMaps
from compplan.planning.task import PlanTask

words = "force sensor"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Correct the path for the measured wrench."""
    return Answer(
        name="force_sensor",
        knows="the full stiffness model",
        measures="wrench at the tip",
        commands="the path corrected for the measured wrench",
        q=maps.full.q,
        gain=maps.full.wrench_gain,
        expected=task.wrench,
    )
