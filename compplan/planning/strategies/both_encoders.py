"""Both encoders: a share beta of the gear's measured deflection stands for what bends beyond the encoder.

q_link + beta (q_link - q_motor) = q with one gain a joint [Klimchik2018], from two compliances of the model: of the
gear, and of gear and links together about the joint's axis (`compplan.statics.encoders.combined_gain`).
"""

from __future__ import annotations

import numpy as np

from compplan.planning.strategies.online import Answer, PathMaps
from compplan.planning.task import PlanTask
from compplan.statics.encoders import combined_gain

words = "encoders on both sides"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the nominal path, held by a combination of both encoders."""
    total = np.zeros(task.robot.nq)
    for spring in maps.reduced_robot.springs:
        total[task.robot.joint_names.index(spring.joint)] = spring.compliance
    return Answer(
        name="both_encoders",
        knows="geometry, compliance of each gear and of gear and links about each axis",
        measures="motor-side and link-side encoders",
        commands="the nominal path, held by link side plus a share of the gear's deflection",
        q=task.q_start,
        feedback="combined",
        beta=combined_gain(maps.gear_compliance, total),
    )
