"""What bends the arm along a path, cause by cause: process, weight, the motion's own inertia; and how it rings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from compplan.cell.vibration import (
    Dynamics,
    build_dynamics,
    differentiate_run,
    inertial_loads,
    natural_frequencies,
)
from compplan.plan.task import PlanTask
from compplan.plan.timing import Timing, cutting_runs
from compplan.posture.start import PostureRequest
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.ik import middle_of_limits

#: Waypoints that are looked at where there are more: the half with the greatest accelerations, and even ones.
LOOKED_AT = 2000
#: Postures at which frequencies are computed.
POSTURES = 25
#: Shortest and longest time over which motion is smoothed. [s]
SHORTEST, LONGEST = 0.02, 0.3


@dataclass(frozen=True)
class Bending:
    """Greatest displacement of the tip over the cut by each cause, and the lowest natural frequencies along it.

    Attributes:
        process: By the wrench on the tool. [m]
        weight: By the weights that the model carries. [m]
        inertia: By the inertia of the timed motion; NaN without masses. [m]
        compensated: Whether the plan compensates that.
        frequencies: The two lowest natural frequencies, least along the path; NaN without masses. Shape (2,). [Hz]
        masses: Where the folder has its masses from.

    """

    process: float
    weight: float
    inertia: float
    compensated: bool
    frequencies: Array
    masses: str

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


def tell_bending(bending: Bending) -> str:
    """Say in a line what bends the arm, cause by cause; causes that bend nothing are left out."""
    word = "compensated" if bending.compensated else "not compensated"
    causes = {"weight": bending.weight, "process force": bending.process, f"inertia, {word}": bending.inertia}
    said = [f"{1e3 * size:.3g} mm ({name})" for name, size in causes.items() if np.isfinite(size) and size > 1e-8]
    return f"the arm bends by up to {', '.join(said)}" if said else "nothing bends the arm in this model"


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
        loads = find_bias(task, q, timing.time, dynamics, rows)[rows]
        moving = solve_equilibrium(task.chain, q[rows], task.wrench[rows], tolerance=1e-10, torque_bias=loads).position
        inertia = _greatest(moving - loaded)
        few = rows[np.linspace(0, len(rows) - 1, min(POSTURES, len(rows))).astype(int)]
        rings = natural_frequencies(dynamics, q[few]).min(axis=0)
    masses = str(task.robot.sources.get("masses", "the folder does not say"))
    return Bending(_greatest(loaded - free), _greatest(free - stiff), inertia, task.inertia, rings, masses)


def find_bias(
    task: PlanTask, q: Array, time: Array, dynamics: Dynamics, among: NDArray[np.int_] | None = None
) -> Array:
    """Return what the inertia of a timed motion puts on each elastic coordinate. Shape (n, s). [N m or N].

    Nothing acts in rapid moves, and where the tool rests.

    Args:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time at each waypoint. Shape (n,). [s]
        dynamics: The robot with its masses.
        among: Waypoints that are looked at, the others stay without; all if left out. Shape (k,).

    """
    bias = np.zeros((len(q), task.chain.n_springs))
    if dynamics.known:
        runs = cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests)
        velocity, acceleration = differentiate_run(q, time, runs)
        rows = np.flatnonzero(acceleration.any(axis=1))
        rows = rows if among is None else np.intersect1d(rows, among)
        bias[rows] = inertial_loads(dynamics, q[rows], velocity[rows], acceleration[rows])
    return bias


def add_starts(task: PlanTask, q: Array, time: Array, dynamics: Dynamics, bias: Array) -> Array:
    """Return loads of inertia with those at rests within a cut, of the move that begins there: q'' = 2 dq / dt^2.

    Args:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time at each waypoint. Shape (n,). [s]
        dynamics: The robot with its masses.
        bias: Loads that are nothing at rests. Shape (n, s). [N m or N]

    """
    moving = np.r_[~(task.nominal.rapid | task.lead)[1:], False]
    rests = np.zeros(len(q), bool) if task.rests is None else task.rests
    rows = np.flatnonzero(task.cut & moving & rests)
    if not dynamics.known or not len(rows):
        return bias
    step = np.maximum(time[rows + 1] - time[rows], 1e-12)[:, None]
    push = 2.0 * (q[rows + 1] - q[rows]) / step**2
    bias = bias.copy()
    bias[rows] = inertial_loads(dynamics, q[rows], 0.0 * push, push)
    return bias


def relax_bias(task: PlanTask, time: Array, old: Array, new: Array) -> Array:
    """Go from one load of inertia towards that of the command which it leads to, as far as converges.

    A correction d = C b of a load b has an inertia of its own: with D the second difference in time and w the lowest
    natural frequency, b = b0 + D b / w^2 along that mode. Steps (1 - D / w^2)^-1 (new - old) arrive there at once, and
    gradually in the stiffer ones; plain repetition grows at what is faster than w.

    Args:
        task: The task.
        time: Time at each waypoint. Shape (n,). [s]
        old: Load that the command was computed with. Shape (n, s). [N m or N]
        new: Load of that command's motion. Shape (n, s). [N m or N]

    """
    change, square = np.zeros_like(new), (2 * np.pi / task.smoothing) ** 2
    for first, last in cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests):
        if last - first < 2:
            continue
        step = np.maximum(np.diff(time[first : last + 1]), 1e-12)
        left, right = (2.0 / (side * (step[:-1] + step[1:])) / square for side in (step[:-1], step[1:]))
        bands = np.stack([np.r_[0.0, -right[:-1]], 1.0 + left + right, np.r_[-left[1:], 0.0]])
        inside = slice(first + 1, last)
        change[inside] = solve_banded((1, 1), bands, new[inside] - old[inside])
    return np.asarray(old + change)


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


def state_frequency(request: PostureRequest, robot: Robot) -> PostureRequest:
    """Price the inertia of joint motion by the arm's lowest natural frequency amid its joint limits, where known."""
    lowest = float(natural_frequencies(build_dynamics(robot), middle_of_limits(robot)[None], 1)[0, 0])
    if not np.isfinite(lowest):
        return request
    motion = request.settings.motion
    source = f"{motion.source}; natural frequency of the robot folder's masses and springs"
    return replace(
        request, settings=replace(request.settings, motion=motion._replace(frequency=lowest, source=source))
    )


def _greatest(shift: Array) -> float:
    return float(np.linalg.norm(shift, axis=1).max(initial=0.0))
