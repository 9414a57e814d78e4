"""Mirror compensation: the predicted deviation is mirrored at the nominal path, once.

The commanded pose is the nominal one less the deviation that the model predicts for the uncorrected command. The
remaining deviation is quadratic in the force: the deflection is computed at the nominal pose, but acts at the
corrected one.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.planning.task import Command, PlanTask, attain_rows, check_limits
from compplan.robot import Array
from compplan.statics.ik import build_arm, refine_ik

words = "mirror"


def command_path(task: PlanTask) -> Command:
    """Compute the command that mirrors the predicted deviation."""
    return check_limits(task, mirror_deviation(task, task.q_start, task.position, task.rotation)[0])


def mirror_deviation(task: PlanTask, q: Array, position: Array, rotation: Array) -> tuple[Array, Array, Array, float]:
    """Shift a commanded pose (q, position and rotation) by the negative of its predicted deviation.

    Returns new joint positions, commanded positions and orientations, and the greatest mirrored deviation. [m]
    """
    attained = attain_rows(task, q, np.arange(len(q)), slope=False)
    moved = task.compensated[:, None]
    away = np.where(moved, attained.position - task.position, 0.0)
    turn = Rotation.from_matrix(attained.rotation @ np.swapaxes(task.rotation, 1, 2)).as_rotvec()
    back = Rotation.from_rotvec(np.where(moved, -turn, 0.0)).as_matrix()
    position, rotation = position - away, back @ rotation
    q = refine_ik(build_arm(task.robot), q, position, rotation)
    return q, position, rotation, float(np.linalg.norm(away, axis=1).max())
