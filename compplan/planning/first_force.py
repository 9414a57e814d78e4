"""How much of a force that nobody has measured yet an arm bears along a path: for the numbers of a new job."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.job.job import Job
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.task import attain_rows
from compplan.statics.chain import joint_jacobian, locate_frames

#: Shares of the joints' efforts and of the correction limit that a first force may take (assumed).
EFFORT, CORRECTION = 0.5, 0.4
#: Step of the rotation about the tool axis that is good enough here. [rad]
SPIN_STEP = float(np.radians(30.0))
#: Load that deflections are worked out under, as a share of the job's: springs are linear, the arm hardly moves.
LIGHT = 0.01


def bearable_share(job: Job) -> float:
    """Return the share of the job's wrench that the arm bears along its path, 1 at most.

    Its posture is chosen as for a plan, among fewer rotations about the tool axis.

    Raises:
        InputError, InfeasibleError: If its path cannot be followed.
    """
    robot, nominal, options = prepare_job(job)
    coarse = replace(options.posture, spin_step=SPIN_STEP)
    task = build_task(robot, nominal, replace(options, posture=coarse), file=job.file)
    rows = np.flatnonzero(task.cut)
    frames = locate_frames(task.chain, task.q_start[rows])
    torque = np.abs(np.einsum("kij,ki->kj", joint_jacobian(task.chain, frames), task.wrench[rows]))
    light = replace(task, wrench=LIGHT * task.wrench, touched=None)
    bent = attain_rows(light, task.q_start, rows, slope=False).position - frames.tcp_position
    deflection = float(np.linalg.norm(bent, axis=1).max()) / LIGHT
    most = float((torque / task.robot.effort_limits).max())
    return min(1.0, EFFORT / max(most, 1e-12), CORRECTION * task.max_correction / max(deflection, 1e-12))
