"""What bends the arm along a path, cause by cause: process, weight, the motion's own inertia; and how it rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.cell.vibration import build_dynamics, inertial_loads, natural_frequencies
from compplan.plan.task import PlanTask
from compplan.plan.timing import Timing, spread_factors, state_timing
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.elastic import solve_equilibrium

#: Waypoints that are looked at where there are more: the half with the greatest accelerations, and even ones.
LOOKED_AT = 2000
#: Postures at which frequencies are computed.
POSTURES = 25
#: Share of the tolerance that inertia may bend the arm by, where a job asks for it to be kept small.
INERTIA_SHARE = 0.3
#: Shortest and longest time over which motion is smoothed. [s]
SHORTEST, LONGEST = 0.02, 0.3


@dataclass(frozen=True)
class Bending:
    """Greatest displacement of the tip over the cut by each cause, and the lowest natural frequencies along it.

    Attributes:
        process: By the wrench on the tool. [m]
        weight: By the weights that the model carries. [m]
        inertia: By the inertia of the timed motion, which the plan does not compensate; NaN without masses. [m]
        frequencies: The two lowest natural frequencies, least along the path; NaN without masses. Shape (2,). [Hz]
        masses: Where the folder has its masses from.

    """

    process: float
    weight: float
    inertia: float
    frequencies: Array
    masses: str

    def describe(self) -> dict[str, object]:
        """Describe it for plan.json; what is not known is left out."""
        sizes = {"process": self.process, "weight": self.weight, "inertia_not_compensated": self.inertia}
        rings = [float(value) for value in self.frequencies if np.isfinite(value)]
        return {
            "bending_mm": {name: 1e3 * value for name, value in sizes.items() if np.isfinite(value)},
            "natural_frequencies_hz": rings,
            "masses": self.masses,
        }


def measure_bending(task: PlanTask, q: Array, timing: Timing) -> Bending:
    """Measure what bends the arm along a command.

    Args:
        task: The task; its wrench acts.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        timing: Its run.

    """
    rows = np.flatnonzero(task.compensated)
    if len(rows) > LOOKED_AT:
        push = np.abs(timing.acceleration[rows] / np.maximum(task.acceleration_limits, 1e-9)).max(axis=1)
        fast = rows[np.argsort(push)[-LOOKED_AT // 2 :]]
        rows = np.union1d(fast, rows[np.linspace(0, len(rows) - 1, LOOKED_AT // 2).astype(int)])
    dynamics, still = build_dynamics(task.robot), np.zeros((len(rows), 6))
    stiff = locate_frames(task.chain, q[rows]).tcp_position
    free = solve_equilibrium(task.chain, q[rows], still, tolerance=1e-10).position
    loaded = solve_equilibrium(task.chain, q[rows], task.wrench[rows], tolerance=1e-10).position
    inertia, rings = float("nan"), np.full(2, np.nan)
    if dynamics.known:
        loads = inertial_loads(dynamics, q[rows], timing.velocity[rows], timing.acceleration[rows])
        moving = solve_equilibrium(task.chain, q[rows], task.wrench[rows], tolerance=1e-10, torque_bias=loads).position
        inertia = _greatest(moving - loaded)
        few = rows[np.linspace(0, len(rows) - 1, min(POSTURES, len(rows))).astype(int)]
        rings = natural_frequencies(dynamics, q[few]).min(axis=0)
    masses = str(task.robot.sources.get("masses", "the folder does not say"))
    return Bending(_greatest(loaded - free), _greatest(free - stiff), inertia, rings, masses)


def slow_for_inertia(task: PlanTask, q: Array, timing: Timing) -> Array:
    """Tell by what factor the run is too fast for its inertia to bend the arm little: 1 where it is not. Shape (n,).

    The bending grows with the square of the speed; a share of the tolerance is left to it.
    """
    rows, slower = np.flatnonzero(task.compensated), np.ones(len(q))
    dynamics = build_dynamics(task.robot)
    if not dynamics.known or not len(rows):
        return slower
    moving = state_timing(task, q, timing.time)
    loads = inertial_loads(dynamics, q[rows], moving.velocity[rows], moving.acceleration[rows])
    tips = [
        solve_equilibrium(task.chain, q[rows], task.wrench[rows], tolerance=1e-10, torque_bias=bias).position
        for bias in (None, loads)
    ]
    bent = np.linalg.norm(tips[1] - tips[0], axis=1)
    slower[rows] = np.sqrt(np.maximum(bent / (INERTIA_SHARE * task.tolerance), 1.0))
    return spread_factors(slower, timing.time, task.smoothing)


def choose_smoothing(robot: Robot, q: Array, default: float) -> float:
    """Return the time over which motion is smoothed: a period of the lowest natural frequency, which it leaves at rest.

    Args:
        robot: The robot.
        q: Some postures along the path. Shape (k, nq). [rad or m]
        default: The time where no frequency is known. [s]

    """
    lowest = natural_frequencies(build_dynamics(robot), q, 1)
    if not np.isfinite(lowest).all():
        return default
    return float(np.clip(1.0 / lowest.min(), SHORTEST, LONGEST))


def _greatest(shift: Array) -> float:
    return float(np.linalg.norm(shift, axis=1).max(initial=0.0))
