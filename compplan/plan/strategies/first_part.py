"""Learning from measured parts: cut, measure the path with a tracker or probe, correct by what was measured, repeat.

No stiffness model: only the geometry of the arm turns a measured deviation into joints. What differs from part to part
(repeatability, the scatter of the force along the path) cannot be learned, and the instrument's noise is learned too,
softened by a mean over neighbouring waypoints.
"""

from __future__ import annotations

import numpy as np

from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.path_map import PathMaps
from compplan.plan.task import PlanTask
from compplan.statics.chain import joint_jacobian, locate_frames

words = "learned from a first part"

#: Parts that are cut and measured before the one that counts.
PARTS = 2


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Command the nominal path, corrected by what the parts before showed."""
    columns = joint_jacobian(task.chain, locate_frames(task.chain, task.q_start))
    inverse = np.asarray(np.linalg.pinv(columns), float)
    return Answer(
        name="first_part",
        knows="geometry",
        measures=f"deviation of {PARTS} parts along the path, with a tracker",
        commands="the nominal path less the measured deviation, part after part",
        q=task.q_start,
        sensor="tracker",
        gain=-inverse[:, :, :3] * task.compensated[:, None, None],
        expected=np.zeros((len(task), 3)),
        parts=PARTS,
    )
