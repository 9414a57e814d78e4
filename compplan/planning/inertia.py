"""Inertia of the motion: deflection, the part that a plan compensates, and smoothing time of the motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import SMOOTHING, PlanTask
from compplan.robot import Array, Robot
from compplan.simulation.vibration import Dynamics, build_dynamics, natural_frequencies
from compplan.statics.chain import Chain
from compplan.statics.elastic import locate_loaded
from compplan.statics.ik import build_arm, reach_tip_and_axis
from compplan.statics.inertia import build_moving_chain, load_motion, smooth_loads
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.motion import Motion, Push, mass_uncertainty, simulate_motion

#: Damping ratio of an arm's modes (assumed).
DAMPING = 0.03
#: Averaging window of the compensated load of inertia, as a share of the smoothing time.
FOLLOWED = 0.5
#: Shortest and longest smoothing time. [s]
SHORTEST, LONGEST = 0.02, 0.3


def measure_motion(task: PlanTask, time: Array, dynamics: Dynamics) -> Motion | None:
    """Compute the modal response of the arm to the load of its motion at times (n,) [s]; None without masses."""
    if not dynamics.known:
        return None
    loads = load_motion(build_moving_chain(task.robot), task.q_links, time, find_inside(task))
    held = np.zeros_like(loads) if not task.inertia or task.bias is None else task.bias

    def locate(bias: Array | None) -> Array:
        return locate_loaded(task.chain, task.q_links, task.wrench, tolerance=1e-10, torque_bias=bias,
                             theta=task.theta)[0]  # fmt: skip

    static, moving = locate(None), locate(loads)
    moved = locate(held) if held.any() else static
    width, masses = mass_uncertainty(task.robot, robot_uncertainty(task.robot))
    source = f"{masses}, damping of the modes {DAMPING:g} of critical (assumed)"
    return simulate_motion(
        dynamics, task.q_links, time, Push(loads, moving - static), Push(held, moved - static), width=width,
        damping=DAMPING, source=source,
    )  # fmt: skip


def find_inside(task: PlanTask) -> NDArray[np.bool_]:
    """Return which waypoints are in motion, inside a run from rest to rest. Shape (n,)."""
    inside = np.zeros(len(task), bool)
    for first, last in task.runs:
        inside[first + 1 : last] = True
    return inside


def plan_loads(task: PlanTask, time: Array, masses: Chain) -> Array:
    """Compute the load of inertia that a plan compensates: averaged as the arm can follow it. Shape (n, s). [N m or N]

    The load is that of an arm with its tool on the path and the spin of the command; `time`: at each waypoint (n,) [s],
    `masses`: the chain with its masses.
    """
    loads = load_motion(masses, task.q_links, time, find_inside(task))
    return smooth_loads(loads, time, task.runs, FOLLOWED * task.smoothing)


def follow_links(task: PlanTask, q: Array) -> Array:
    """Compute the link-side joint positions of an arm with its loaded tool on the path. Shape (n, nq). [rad or m]

    They are those of a rigid arm with its tool on the path and the spin of the command q (n, nq): a command may use the
    free spin, which moves masses that are at rest with q_start.
    """
    links, rows = task.q_start.copy(), np.flatnonzero(task.compensated & ~task.missed)
    if task.redundant and len(rows):
        links[rows] = reach_tip_and_axis(
            build_arm(task.robot), q[rows], task.position[rows], task.rotation[rows], spin_free=task.spin_free
        )[0]
    return links


def choose_smoothing(robot: Robot, q: Array) -> float:
    """Return the smoothing time of the motion: a period of the lowest natural frequency, which is then not excited.

    q: some postures along the path, shape (k, nq). Without a known frequency it is `SMOOTHING`. [s]
    """
    lowest = natural_frequencies(build_dynamics(robot), q, 1)
    if not np.isfinite(lowest).all():
        return SMOOTHING
    return float(np.clip(1.0 / lowest.min(), SHORTEST, LONGEST))
