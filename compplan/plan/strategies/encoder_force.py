"""Force from both encoders: the gears are the force sensor, the full stiffness model turns force into correction.

The deflection of each gear over its compliance is its load; the force at the tip that explains all loads best (weights:
equal noise of the encoders) goes through the model [Klimchik2018]. Where the job predicts no moment at the tip, none is
looked for: three unknowns from as many joints as have two encoders.
"""

from __future__ import annotations

import numpy as np

from compplan.errors import InputError
from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.path_map import PathMaps
from compplan.plan.task import PlanTask

words = "force from encoders"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the path that the estimated force asks for.

    Raises:
        InputError: If no joint has a spring between its encoders.

    """
    gear = maps.gear_compliance
    if not (gear > 0.0).any():
        raise InputError(f"robot {task.robot.name!r} has no spring between two encoders, leave out encoder_force")
    sought = 6 if np.abs(task.wrench[:, 3:]).any() else 3
    reading_per_wrench = gear[:, None] * maps.gear_columns[:, :, :sought]
    wrench_per_reading = np.linalg.pinv(reading_per_wrench, rcond=1e-4)
    return Answer(
        name="encoder_force",
        knows="the full stiffness model",
        measures="motor-side and link-side encoders",
        commands="the path corrected for the force that the gears' deflections show",
        q=maps.full.q,
        sensor="encoders",
        gain=maps.full.wrench_gain[:, :, :sought] @ wrench_per_reading,
        expected=gear * maps.gear_load,
        q_rest=task.q_start,
    )
