"""What the program of time, posture and promise asks of postures: clearance, chatter, torque and work, the band."""

from __future__ import annotations

import numpy as np

from compplan.plan.feed import TorqueRules
from compplan.plan.freedom import TUBE, Freedom
from compplan.plan.one_program import Ground, JointProgram, Margin, Point, Prices, TorquesAlong
from compplan.plan.run_meter import RunMeter, lead_radius
from compplan.plan.swept import STATIONS, SweptClearance
from compplan.posture.chatter import ChatterPrice
from compplan.posture.start import PostureRequest
from compplan.robot import Array

#: Stations whose cut is judged for chatter.
CHATTER_STATIONS = 16
#: Factor on the depth of a cut by which its share of the limit of chatter is read, and the share that it may come to:
#: the zero-order solution is not exact, and stations stand apart (assumed); shares that differ by less are one.
DEEPER, DEEPEST, LEAST_SHARE = 5.0, 0.5, 1e-6


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
    quiet = None if request.chatter is None else keep_quiet(freedom, request.chatter)

    def torques(q: Array) -> TorquesAlong:
        return TorqueRules(task.robot, q, freedom.wrench).rows

    band = None
    if prices.counts_band:
        band = lead_radius(task.robot, meter.force, task.q_start[cut], task.wrench[cut], task.touched)
    return Ground(band, clear, quiet, request.settings.limit_margin, torques if meter.wish.torque else None,
                  torques if prices.energy > 0.0 else None)  # fmt: skip


def keep_quiet(freedom: Freedom, price: ChatterPrice) -> Margin | None:
    """State the distance to chatter: the depth that is kept below the limit less the cut's; None where nothing cuts.

    A cut may come to DEEPEST of its limit, or as near to it as it is at the start. Depths are shares of the limit.

    Args:
        freedom: What is free.
        price: Tells how far cuts are beyond the limit.

    """
    waypoint = np.rint(freedom.task.origin[freedom.rows]).astype(int)
    cut = np.flatnonzero(price.touches(waypoint))
    if not len(cut):
        return None
    at = cut[np.unique(np.linspace(0, len(cut) - 1, CHATTER_STATIONS).astype(int))]

    def share(q: Array) -> Array:
        """Return the depth as a share of the limit, 1 / DEEPER where it is less. Shape (j,)."""
        return (price.excess(q, waypoint[at], DEEPER) + 1.0) / DEEPER

    stood = freedom.pose(freedom.task.q_start[freedom.rows], freedom.start)[0]
    most = np.maximum(share(stood[at]), DEEPEST) + LEAST_SHARE
    return Margin(at, lambda q: most - share(q))


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
