"""Force sensor: correct for the measured wrench by the stiffness model at every waypoint, without delay."""

from __future__ import annotations

import numpy as np

from compplan.planning.strategies import iterated_mirror
from compplan.planning.task import Command, PlanTask
from compplan.statics.elastic import loaded_compliance
from compplan.statics.stiffness import attain_pose

words = "force sensor"


def command_path(task: PlanTask) -> Command:
    """Compute the exact command for the expected wrench and its derivative with respect to the wrench.

    The spin stays constant.
    """
    q = iterated_mirror.command_path(task).q
    inverse = np.asarray(np.linalg.pinv(attain_pose(task.chain, q, task.wrench).jacobian), float)
    gain = -(inverse @ loaded_compliance(task.chain, q, task.wrench)) * task.compensated[:, None, None]
    return Command(q, gain=gain, expected=task.wrench)
