"""Time and widest 95 % band of uncorrected runs with vibration, and runs slowed to vibrate less.

A run is slowed where the arm vibrates most, but takes no longer than a reference run. With f_i the slowdown factor at
waypoint i, the part of the band due to vibration falls about with f_i^2:

    f_i <- max(1, f_i sqrt(v_i / sqrt(B^2 - s_i^2))),    v the band due to vibration, s the band due to other causes.

B is the least band that the time of the run allows. This time increases from run to run up to that of the reference:
the runs are a front of time and band, from which `choose_run` takes one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.inertia import measure_motion
from compplan.planning.posture.summary import Slowdown, Start
from compplan.planning.redundancy import PathRequest, ReferenceRun
from compplan.planning.task import PlanTask
from compplan.planning.timing import INERTIA_WINDOWS, time_rapids
from compplan.robot import Array
from compplan.simulation.vibration import Dynamics, build_dynamics
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import band_radius, linearise_path, split_covariance
from compplan.uncertainty.motion import greatest_shift, spread_draws
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model, pick_rows

#: Shortest smoothing windows, as a share of the default ones.
SHORT = 0.7
#: Least gain for a change of posture, and relative difference below which two bands are equal.
LEAST_GAIN, SAME = 0.01, 1e-3
#: Rows of the cut at which the band of a run is computed.
BAND_ROWS = 120
#: Most slowed runs, and most waypoints times runs.
ROUNDS, WORK = 14, 40_000
#: Least spare time for slowed runs, as a share of the reference time.
SPARE = 1e-3
#: Share of the spare time that the first slowed run uses, and number of last runs that use all of it.
FIRST_USE, LAST_RUNS = 0.5, 4
#: Least share of a band reserved for vibration, and greatest band tried, as a multiple of that of a run.
LEAST_SHARE, WIDEST = 0.2, 4.0
#: Least and greatest change of a factor from run to run.
EASIER, SLOWER = 0.9, 1.4


class TimedStart(NamedTuple):
    """Uncorrected run of a start."""

    start: Start  #: Start with its slowdown.
    time: float  #: Total time. [s]
    bands: Array  #: 95 % band at rows of the cut. Shape (k,). [m]
    static_bands: Array  #: The same without vibration. Shape (k,). [m]
    deflection: float  #: Greatest quasi-static displacement of the tip by inertia along the cut. [m]
    spare: float  #: Time saved by the shortest smoothing windows. [s]
    static_covariance: Array  #: Covariance of the tip at rows of the cut, without vibration. Shape (k, 3, 3). [m^2]
    task: PlanTask  #: Task with the default windows.
    passing: Array  #: Time at each waypoint of the task. Shape (n,). [s]

    @property
    def band(self) -> float:
        """Widest 95 % band along the cut. [m]"""
        return float(self.bands.max(initial=0.0))

    @property
    def static_band(self) -> float:
        """Widest 95 % band without vibration. [m]"""
        return float(self.static_bands.max(initial=0.0))


def measure_runs(
    start: Start, request: PathRequest, *, window: float = 1.0, reference: TimedStart | None = None,
    known: TimedStart | None = None,
) -> list[TimedStart]:  # fmt: skip
    """Compute time and band of the fastest run of a start and, given a reference run, of slowed ones.

    Args:
        start: The start, without slowdown.
        request: Requirements on the path.
        window: Smoothing windows as a share of the default ones.
        reference: Reference run: slowed runs take no longer; or None.
        known: Known run of the same posture, or None.
    """
    found = list[TimedStart]()
    try:
        whole = resolve_starts(request.state(start)) if known is None else known.task
        task, spare = replace(whole, smoothing=window * whole.smoothing), (1.0 - SHORT) * smoothing_time(whole)
        slower, rows = np.ones(len(task)), pick_rows(task.cut, BAND_ROWS)
        dynamics, offset = build_dynamics(task.robot), task.position[rows] - task.programmed[rows]
        covariance = spread_tip(task, request.force) if known is None else known.static_covariance
        static_band = band_radius(covariance, mean=offset)
        late = predicted = 0.0  # time of a run beyond its prediction
        rounds = 1 if reference is None else max(min(ROUNDS, WORK // len(task)), 1)
        for count in range(rounds):
            eased = start if count == 0 and window == 1.0 else replace(
                start, slowdown=Slowdown(window, task.origin, slower))  # fmt: skip
            run = replace(task, start=eased)
            time = time_run(run, run.q_start)[1].time
            vibration, deflection = _spread_vibration(run, time, rows, dynamics)
            band = band_radius(covariance + vibration, mean=offset)
            found.append(TimedStart(eased, float(time[-1]), band, static_band, deflection, spare, covariance, whole,
                                    time))  # fmt: skip
            if reference is None or not vibration.any() or (not count and time[-1] > (1.0 - SPARE) * reference.time):
                break
            late += time[-1] - predicted if count else 0.0
            used = min(FIRST_USE + (1.0 - FIRST_USE) * count / max(rounds - LAST_RUNS, 1), 1.0)
            goal = (1.0 - used) * found[0].time + used * (1.0 - 0.5 * SPARE) * reference.time
            factor = _find_factors(found[-1], goal - late, np.maximum(1.0 / slower, EASIER), SLOWER)[0]
            predicted = time[-1] + np.gradient(time) @ (factor - 1.0) + late
            slower = slower * factor
    except ConvergenceError:
        pass
    return found


def spread_tip(task: PlanTask, force: ForceSpread) -> Array:
    """Compute the covariance of the tip at rows of the cut, before correction and vibration. Shape (k, 3, 3). [m^2]

    The rows are those of `pick_rows(task.cut, BAND_ROWS)`.
    """
    known, part = robot_uncertainty(task.robot), None
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    if task.touched is not None:
        part = task.touched.spread_part(task.position)
    slopes = linearise_path(scene, known, force, task.cut, part=part, touched=task.touched, most=BAND_ROWS)
    return np.asarray(sum(split_covariance(slopes, known).values()))


def _spread_vibration(task: PlanTask, time: Array, rows: NDArray[np.int_], dynamics: Dynamics) -> tuple[Array, float]:
    """Compute the covariance of the tip by vibration at some waypoints, and its greatest quasi-static displacement.

    Shape (k, 3, 3). [m^2, m]
    """
    motion = measure_motion(task, time, dynamics)
    if motion is None:
        return np.zeros((len(rows), 3, 3)), 0.0
    return spread_draws(motion.error[:, rows]), greatest_shift(motion.static[rows])


def _widen(use: Array, time: Array, reach: float) -> Array:
    """Return the greatest value within `reach` [s] on either side, with smoothed steps. Shape (n,)."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    span = time[-1] - time[0]
    if not (span > 0.0 and reach > 0.0):
        return use
    grid = np.linspace(time[0], time[-1], int(np.clip(8.0 * span / reach, 16, 20_000)))
    size = max(int(reach / (grid[1] - grid[0])), 1)
    wide = maximum_filter1d(np.interp(grid, time, use), 2 * size + 1, mode="nearest")
    smooth = uniform_filter1d(wide, size // 2 * 2 + 1, mode="nearest")  # a running sum: rounding may make it negative
    return np.interp(time, grid, np.clip(smooth, use.min(), use.max()))


def ease_run(preset: str, run: TimedStart, base: TimedStart, request: PathRequest) -> TimedStart:
    """Return the best of a run and slowed runs of its posture, compared with a base run."""
    reference, runs, windows = (None if preset == "fast" else base), [run], [SHORT]
    late = max(run.time - base.time, 0.0) / run.spare
    if reference is not None and late < 1.0:
        windows = [1.0 - (1.0 - SHORT) * late, SHORT]
    for window in windows:
        runs += measure_runs(run.start, request, window=window, reference=reference, known=run)
    return choose_run(preset, runs, base)


def choose_run(preset: str, runs: list[TimedStart], base: TimedStart) -> TimedStart:
    """Choose the run with the best figure of a preset; among runs within `LEAST_GAIN` of it, the shortest."""
    gains = [compute_gain(preset, run, base) for run in runs]
    alike = [run for run, gain in zip(runs, gains, strict=True) if gain <= min(gains) + LEAST_GAIN]
    return min(alike, key=lambda run: run.time)


def band_at_time(run: TimedStart, base: TimedStart) -> float:
    """Estimate the band of a run, retimed to take as long as the base; infinite if it needs longer. [m]"""
    if run.time - run.spare > base.time:
        return np.inf
    return _find_factors(run, base.time, min(base.time / run.time, 1.0))[1]


def _find_factors(run: TimedStart, time: float, least: Array | float, most: float = np.inf) -> tuple[Array, float]:
    """Return changes of the slowdown factors (n,) within bounds, and the least band [m] of a run of a time [s]."""
    rows, share = pick_rows(run.task.cut, BAND_ROWS), np.gradient(run.passing)
    vibration, every = np.maximum(run.bands**2 - run.static_bands**2, 0.0), np.arange(len(share))

    def slow(band: float) -> Array:
        allowed = np.maximum(band**2 - run.static_bands**2, (LEAST_SHARE * band) ** 2)
        use = np.interp(every, rows, (vibration / allowed) ** 0.25)
        return np.clip(_widen(use, run.passing, run.task.smoothing), least, most)

    low, high = run.static_band, WIDEST * run.band
    while high - low > 1e-3 * high:
        band = 0.5 * (low + high)
        low, high = (low, band) if run.time + share @ (slow(band) - 1.0) <= time else (band, high)
    return slow(high), high


def compute_gain(preset: str, run: TimedStart, base: TimedStart) -> float:
    """Compute the figure that a preset ("" for none) reduces, relative to the base; infinite if time or band grows."""
    time, band, static = run.time / base.time, run.band / base.band, run.static_band / base.static_band
    if preset == "fast":
        return time
    if time > 1.0 or band > 1.0 + SAME:
        return np.inf
    if preset == "error_band":
        return band
    return 0.5 * (band + static) if preset else 0.5 * (time + band)


def least_time(task: PlanTask) -> float:
    """Compute the lower bound of the time of a run: programmed feed, rapid moves and smoothing. [s]"""
    rapid = task.nominal.rapid[1:]
    moves = np.abs(np.diff(task.q_start, axis=0))[rapid]
    between = time_rapids(moves, task.velocity_limits, task.acceleration_limits).sum()
    return float(task.step_time[~rapid].sum() + between + smoothing_time(task))


def reference_run(base: TimedStart, origin: TimedStart, task: PlanTask) -> ReferenceRun:
    """Compute reference time and deflection of the program: of the base, as if its band were due to motion only.

    origin: run of the task from which the program starts.
    """
    motion = np.sqrt(max(base.band**2 - base.static_band**2, 0.0))
    deflection = base.deflection * base.band / motion if motion > 0.0 else 0.0
    passing = np.interp(task.origin, origin.task.origin, origin.passing)
    return ReferenceRun(base.time - smoothing_time(base.task), deflection, passing)


def smoothing_time(task: PlanTask) -> float:
    """Compute the time that smoothing adds to the runs of a path, each by its windows. [s]"""
    return len(task.runs) * task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
