"""The inertia of the motion: what it bends, what of it a plan compensates, and how long motion is smoothed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.simulation.vibration import Dynamics, build_dynamics, natural_frequencies
from compplan.statics.chain import Chain
from compplan.statics.elastic import locate_loaded
from compplan.statics.ik import build_arm, reach_tip_and_axis
from compplan.statics.inertia import build_moving_chain, load_motion, smooth_loads
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.motion import Motion, Push, know_masses, swing_arm

#: Share of critical damping of an arm's modes where a job states none (assumed).
DAMPING = 0.03
#: Window over which the load of inertia is averaged before it is compensated, in periods of the lowest mode.
FOLLOWED = 0.5
#: Shortest and longest time over which motion is smoothed. [s]
SHORTEST, LONGEST = 0.02, 0.3


def measure_motion(task: PlanTask, time: Array, dynamics: Dynamics) -> Motion | None:
    """Let the arm answer to the load of its motion, times (n,) [s], with its modes; None without masses on springs."""
    if not dynamics.known:
        return None
    loads = load_motion(build_moving_chain(task.robot), task.q_links, time, find_inside(task))
    held = np.zeros_like(loads) if not task.inertia or task.bias is None else task.bias

    def locate(bias: Array | None) -> Array:
        return locate_loaded(task.chain, task.q_links, task.wrench, tolerance=1e-10, torque_bias=bias,
                             theta=task.theta)[0]  # fmt: skip

    still, moving = locate(None), locate(loads)
    moved = locate(held) if held.any() else still
    width, masses = know_masses(task.robot, robot_uncertainty(task.robot))
    source = f"{masses}, damping of the modes {DAMPING:g} of critical (assumed)"
    return swing_arm(
        dynamics, task.q_links, time, Push(loads, moving - still), Push(held, moved - still), width=width,
        damping=DAMPING, source=source,
    )  # fmt: skip


def find_inside(task: PlanTask) -> NDArray[np.bool_]:
    """Tell which waypoints are in motion, within a run from rest to rest. Shape (n,)."""
    inside = np.zeros(len(task), bool)
    for first, last in task.runs:
        inside[first + 1 : last] = True
    return inside


def plan_loads(task: PlanTask, time: Array, masses: Chain) -> Array:
    """Return the load of inertia that a plan compensates: as far as the arm can follow it. Shape (n, s). [N m or N]

    It is that of an arm whose tool follows the path, turned as the command turns it; `time`: at each waypoint (n,) [s],
    `masses`: the chain with its masses.
    """
    loads = load_motion(masses, task.q_links, time, find_inside(task))
    return smooth_loads(loads, time, task.runs, FOLLOWED * task.smoothing)


def follow_links(task: PlanTask, q: Array) -> Array:
    """Return where the links of an arm go whose loaded tool follows the path. Shape (n, nq). [rad or m]

    They are those of a stiff arm with its tool on the path, turned about its axis as the command q (n, nq) turns it: a
    command may use the free rotation, and then that moves masses which q_start leaves where they are.
    """
    links, rows = task.q_start.copy(), np.flatnonzero(task.compensated & ~task.missed)
    if task.redundant and len(rows):
        links[rows] = reach_tip_and_axis(
            build_arm(task.robot), q[rows], task.position[rows], task.rotation[rows], spin_free=task.spin_free
        )[0]
    return links


def choose_smoothing(robot: Robot, q: Array, default: float) -> float:
    """Return the time over which motion is smoothed: a period of the lowest natural frequency, which it leaves at rest.

    q: some postures along the path, shape (k, nq); default: the time where no frequency is known. [s]
    """
    lowest = natural_frequencies(build_dynamics(robot), q, 1)
    if not np.isfinite(lowest).all():
        return default
    return float(np.clip(1.0 / lowest.min(), SHORTEST, LONGEST))
