"""What bends the arm along a path, cause by cause: process, weight, the motion's own inertia; and how it rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.follow import reach_tip_and_axis
from compplan.planning.task import PlanTask, pick_worst
from compplan.planning.timing import Timing
from compplan.robot import Array, Robot
from compplan.simulation.vibration import Dynamics, build_dynamics, natural_frequencies
from compplan.statics.chain import Chain, locate_frames
from compplan.statics.elastic import locate_loaded, solve_equilibrium
from compplan.statics.ik import build_arm
from compplan.statics.inertia import build_moving_chain, load_motion, smooth_loads
from compplan.toolpath.toolpath import pick_even
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.motion import Motion, Push, know_masses, swing_arm

#: Waypoints that are looked at where there are more: the half with the greatest accelerations, and even ones.
LOOKED_AT = 2000
#: Postures at which frequencies are computed.
POSTURES = 25
#: Share of critical damping of an arm's modes where a job states none (assumed).
DAMPING = 0.03
#: Window over which the load of inertia is averaged before it is compensated, in periods of the lowest mode.
FOLLOWED = 0.5
#: Shortest and longest time over which motion is smoothed. [s]
SHORTEST, LONGEST = 0.02, 0.3


@dataclass(frozen=True)
class Bending:
    """Greatest displacement of the tip over the cut by each cause, and the lowest natural frequencies along it."""

    process: float  #: By the wrench on the tool. [m]
    weight: float  #: By the weights that the model carries. [m]
    inertia: float  #: By the inertia of the timed motion, answered by the modes of the arm; NaN without masses. [m]
    compensated: bool  #: Whether the plan compensates that.
    #: The two lowest natural frequencies, least along the path; NaN without masses. Shape (2,). [Hz]
    frequencies: Array
    masses: str  #: Where the folder has its masses from.
    motion: Motion | None = None  #: What the motion adds to the band, or None.
    #: Greatest displacement by inertia if the springs gave at once; NaN without masses. [m]
    at_once: float = float("nan")

    def describe(self) -> dict[str, object]:
        """Describe it for plan.json; what is not known is left out."""
        name = "inertia" if self.compensated else "inertia_not_compensated"
        sizes = {"process": self.process, "weight": self.weight, name: self.inertia}
        rings = [float(value) for value in self.frequencies if np.isfinite(value)]
        return {
            "bending_mm": {name: 1e3 * value for name, value in sizes.items() if np.isfinite(value)},
            "natural_frequencies_hz": rings,
            "masses": self.masses,
        }


def measure_bending(task: PlanTask, q: Array, timing: Timing) -> Bending:
    """Measure what bends the arm along a command (n, nq)."""
    rows = np.flatnonzero(task.compensated)
    push = np.abs(timing.acceleration[rows] / np.maximum(task.acceleration_limits, 1e-9)).max(axis=1)
    rows = pick_worst(rows, push, LOOKED_AT)
    dynamics, still = build_dynamics(task.robot), np.zeros((len(rows), 6))
    stiff = locate_frames(task.chain, q[rows]).tcp_position
    free = solve_equilibrium(task.chain, q[rows], still, tolerance=1e-10).position
    loaded = solve_equilibrium(task.chain, q[rows], task.wrench[rows], tolerance=1e-10).position
    motion = measure_motion(task, timing.time, dynamics)
    inertia, at_once, rings = float("nan"), float("nan"), np.full(2, np.nan)
    if motion is not None:
        inertia, at_once = _greatest(motion.answer[task.cut]), _greatest(motion.static)
        few = pick_even(rows, POSTURES)
        rings = natural_frequencies(dynamics, q[few]).min(axis=0)
    masses = str(task.robot.sources.get("masses", "not stated in the folder"))
    return Bending(_greatest(loaded - free), _greatest(free - stiff), inertia, task.inertia, rings, masses, motion,
                   at_once)  # fmt: skip


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


def _greatest(shift: Array) -> float:
    return float(np.linalg.norm(shift, axis=1).max(initial=0.0))
