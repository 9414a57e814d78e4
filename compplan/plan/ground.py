"""What the program of time, posture and promise asks of postures: clearance, torque and work, the band."""

from __future__ import annotations

import numpy as np

from compplan.plan.feed import TorqueRules
from compplan.plan.freedom import TUBE, Freedom
from compplan.plan.one_program import Ground, JointProgram, Point, Prices, TorquesAlong
from compplan.plan.run_meter import RunMeter, lead_radius
from compplan.plan.swept import STATIONS, SweptClearance
from compplan.posture.initial_branches import PostureRequest
from compplan.robot import Array


def state_ground(freedom: Freedom, request: PostureRequest, meter: RunMeter, prices: Prices) -> Ground | None:
    """State what postures have to keep; None where nothing is cut.

    Args:
        freedom: What is free.
        request: What is asked of the posture.
        meter: How runs are measured.
        prices: What is weighed.

    """
    task, scene, clear = freedom.task, request.scene, None
    cut = freedom.rows[task.cut[freedom.rows]]
    if not len(cut):
        return None
    if scene is not None:
        at = np.unique(np.linspace(0, len(freedom.rows) - 1, STATIONS).astype(int)).astype(float)
        clear = SweptClearance(scene, request.wanted, at)

    def torques(q: Array) -> TorquesAlong:
        return TorqueRules(task.robot, q, freedom.wrench).rows

    band = None
    if prices.counts_band:
        band = lead_radius(task.robot, meter.force, task.q_start[cut], task.wrench[cut], task.touched)
    return Ground(band, clear, request.settings.limit_margin, torques if meter.wish.torque else None,
                  torques if prices.energy > 0.0 else None)  # fmt: skip


def drop_least(program: JointProgram, point: Point, least: float) -> Point:
    """Give up ways of the tip in its tube, and of axes that slide, below the least move of the controller.

    Args:
        program: The program.
        point: What it has come to.
        least: Steps below this move nothing. [m]

    """
    freedom, robot = program.freedom, program.freedom.task.robot
    slides = dict(zip(robot.joint_names, robot.prismatic, strict=True))
    lengths = np.array([name in TUBE or bool(slides.get(name, False)) for name in freedom.names])
    size = np.abs(freedom.basis @ point.change * freedom.units).max(axis=0)
    idle = lengths & (size > 0.0) & (size <= least)
    if not idle.any():
        return point
    kept = np.where(idle, 0.0, point.change)
    near = point.q + np.einsum("kjf,kf->kj", point.rate, freedom.values(kept) - point.values)
    assert program.first is not None
    return program.evaluate(kept, near) or program.first
