"""Time and widest 95 % band of a run before correction; and runs that are slower where the arm would ring most.

At one posture the fastest run has its widest band where it accelerates most, often beside its rests. With f_i a factor
by which waypoint i is slower, what vibration adds to the band falls about with f_i^2; f follows a target B for the
band, round by round, B lower every other round:

    f_i <- max(1, f_i (v_i / sqrt(B^2 - s_i^2))^g),    v and s what vibration and all else have of the band,

the bracket taken as its greatest within the time that the arm rings on. Every run is timed and let ring as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from compplan.effects.forward_model import ForwardModel
from compplan.errors import ConvergenceError
from compplan.planning.deflection import measure_motion
from compplan.planning.feed import FeedRequest, TorqueRules, time_run
from compplan.planning.posture.initial_branches import Easing, Start
from compplan.planning.run_timing import Timing
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.robot.uncertainty import Uncertainty
from compplan.simulation.vibration import Dynamics, build_dynamics
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import Slopes, band_radius, split_covariance
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    build_path_model,
    measure_force_slopes,
    measure_slopes,
    pick_rows,
    unload_model,
)
from compplan.uncertainty.touch_off import TouchedPart, subtract_touch

#: Rows of the cut at which the band of a finished posture is measured.
BAND_ROWS = 120
#: Runs that are tried at most, and waypoints times runs.
ROUNDS, WORK = 20, 40_000
#: Target of the band from one pair of rounds to the next, least share of it that is left to vibration.
LOWER, LEAST_ROOM = 0.93, 0.2
#: Exponent g, and the least and greatest change of a factor in one round.
GAIN, EASIER, SLOWER = 0.6, 0.9, 1.4
#: A run that takes longer than another by more ends the search.
TOO_LONG = 1.02


class TimedStart(NamedTuple):
    """A run of a start, nothing corrected.

    Attributes:
        start: The start, with its pace.
        time: The whole run. [s]
        band: Widest 95 % band along the cut. [m]
        still: The same, vibration left out. [m]
        energy: Work of the motors, sum |tau dq|; 0 where it does not count. [J]
        quiet: Covariance of the tip at its rows of the cut, vibration left out. Shape (k, 3, 3). [m^2]

    """

    start: Start
    time: float
    band: float
    still: float
    energy: float
    quiet: Array


@dataclass(frozen=True)
class RunMeter:
    """How runs are measured.

    Attributes:
        wish: What the process asks of the feed.
        force: How surely the force is known.
        state: States the task that begins with a start.
        damping: Damping of the arm's vibrations, share of critical.
        energy: What the work of the motors weighs.

    """

    wish: FeedRequest
    force: ForceSpread
    state: Callable[[Start], PlanTask]
    damping: float
    energy: float = 0.0

    def time(self, task: PlanTask) -> float:
        """Time the fastest run; infinite where none keeps the limits. [s]."""
        try:
            return float(time_run(task, task.q_start, self.wish)[1].time[-1])
        except ConvergenceError:
            return np.inf

    def measure(
        self, start: Start, *, window: float = 1.0, beside: TimedStart | None = None, quiet: Array | None = None
    ) -> list[TimedStart]:
        """Measure the fastest run of a start; beside another run, slower ones too, each with a narrower band.

        Args:
            start: The start, without a pace.
            window: Windows of smoothing, share of those that plans have.
            beside: A run whose time is not to be passed, or None.
            quiet: Covariance of the tip without vibration, where it has been measured.

        Returns:
            The runs; none where no run keeps the limits.

        """
        plain = Easing(window, np.zeros(1), np.ones(1))
        task, found = self.state(start if window == 1.0 else replace(start, pace=plain)), []
        slower, target, rows = np.ones(len(task)), np.inf, pick_rows(task.cut, BAND_ROWS)
        dynamics = build_dynamics(task.robot)
        try:
            still = spread_tip(task, self.force, rows) if quiet is None else quiet
            aside = task.position[rows] - task.programmed[rows]
            calm = band_radius(still, mean=aside)
            for count in range(1 if beside is None else max(min(ROUNDS, WORK // len(task)), 1)):
                eased = start if count == 0 and window == 1.0 else replace(
                    start, pace=Easing(window, task.origin, slower))  # fmt: skip
                run = replace(task, start=eased)
                timing = time_run(run, run.q_start, self.wish)[1]
                time, energy = timing.time, measure_work(run, timing) if self.energy else 0.0
                rings = self.spread_vibration(run, time, rows, dynamics)
                band = band_radius(still + rings, mean=aside)
                widest, least = (float(each.max(initial=0.0)) for each in (band, calm))
                found.append(TimedStart(eased, float(time[-1]), widest, least, energy, still))
                if beside is None or time[-1] > TOO_LONG * beside.time or not rings.any():
                    break
                if count % 2 == 0:
                    target = LOWER * min(target, found[-1].band if count == 0 else np.inf, beside.band)
                room = np.sqrt(np.maximum(target**2 - calm**2, (LEAST_ROOM * target) ** 2))
                use = np.sqrt(np.maximum(band**2 - calm**2, 0.0)) / room
                wide = _widen(np.interp(np.arange(len(task)), rows, use), time, task.smoothing)
                slower = np.maximum(slower * np.clip(wide**GAIN, EASIER, SLOWER), 1.0)
        except ConvergenceError:
            pass
        return found

    def spread_vibration(self, task: PlanTask, time: Array, rows: NDArray[np.int_], dynamics: Dynamics) -> Array:
        """Return the covariance of the tip by its vibration at some waypoints of a run. Shape (k, 3, 3). [m^2]."""
        motion = measure_motion(task, time, dynamics, self.damping)
        if motion is None:
            return np.zeros((len(rows), 3, 3))
        away = motion.error[:, rows] - motion.error[:, rows].mean(axis=0)
        return np.asarray(np.einsum("dni,dnj->nij", away, away) / max(len(away) - 1, 1))


def measure_work(task: PlanTask, timing: Timing) -> float:
    """Return the work of the motors along a run, sum |tau dq|: masses, weight and wrench count, friction does not. [J].

    Args:
        task: The task.
        timing: Its run, of `q_start`.

    """
    last = len(task) - 1
    _, moving, held, _ = TorqueRules(task.robot, task.q_start, task.wrench).rows(
        0, last, timing.velocity, timing.acceleration)  # fmt: skip
    torque = 0.5 * (moving + held)
    return float(np.abs((torque[1:] + torque[:-1]) * np.diff(task.q_start, axis=0)).sum())


def _widen(use: Array, time: Array, reach: float) -> Array:
    """Return the greatest value within a reach of time [s] on either side, its steps smoothed. Shape (n,)."""
    span = time[-1] - time[0]
    if not (span > 0.0 and reach > 0.0):
        return use
    grid = np.linspace(time[0], time[-1], int(np.clip(8.0 * span / reach, 16, 20_000)))
    size = max(int(reach / (grid[1] - grid[0])), 1)
    wide = maximum_filter1d(np.interp(grid, time, use), 2 * size + 1, mode="nearest")
    smooth = uniform_filter1d(wide, size // 2 * 2 + 1, mode="nearest")  # a running sum: rounding may make it negative
    return np.interp(time, grid, np.clip(smooth, use.min(), use.max()))


def spread_tip(task: PlanTask, force: ForceSpread, rows: NDArray[np.int_]) -> Array:
    """Return the covariance of the tip at some waypoints, before correction and vibration. Shape (k, 3, 3). [m^2]."""
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    return _spread_scene(scene, robot_uncertainty(task.robot), force, rows, task.touched)


def _spread_scene(
    scene: ForwardModel, known: Uncertainty, force: ForceSpread, rows: NDArray[np.int_], touched: TouchedPart | None
) -> Array:
    rest = unload_model(scene, rows)
    shared, local = measure_force_slopes(scene, rows, force, rest)
    model = measure_slopes(scene, known.unknowns, rows, rest)
    model = subtract_touch(model, rest.position, touched, known.unknowns)
    if touched is not None:
        shared = np.concatenate([shared, touched.spread_part(rest.position)], axis=2)
    slopes = Slopes(rows, rest.position, model, shared, local, touched=touched)
    return np.asarray(sum(split_covariance(slopes, known).values()))
