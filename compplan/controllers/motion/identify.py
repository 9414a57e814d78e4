"""Identification of a controller from logs: blends, speed law, lag and lost motion, with cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from compplan.controllers.motion.windows import (
    CYCLE,
    Window,
    WindowRun,
    find_residual,
    measure_left,
    run_window,
)
from compplan.controllers.writers.motion_table import LONGEST_LAG, ServoMotion
from compplan.robot import Array
from compplan.statics.ik import Arm

#: Greatest blend share, half width of its search interval with left-out rows, its resolution, greatest number of
#: trials, and number of windows above which only every second one is used in the search.
MOST_SHARE, AROUND, FINEST, MOST_TRIED, SEARCHED = 2.0, 0.2, 0.02, 9, 4
#: Weight of a speed error as a distance. [s]
SPEED_WEIGHT = 0.01
#: Prior standard deviations of joint parameters: lag [s], acceleration lag [s^2], lost motion [rad].
SPREAD = {"lag": 0.02, "acceleration": 5e-4, "lost": 5e-4}
#: Prior of the acceleration of the tip [m/s^2] and of the smoothing [s], and prior standard deviations of the logarithm
#: of the acceleration and of the smoothing [s].
USUAL, SPEED_SPREAD = (3.0, 0.04), (1.0, 0.2)
#: Distance below which a model counts as not worse than the programmed path. [m]
EQUAL = 1e-6
#: Noise of a row [m], outlier threshold in units of it, evaluations of a fit, and difference step in prior deviations.
NOISE, OUTLIER, STEPS, STEP = 2e-5, 8.0, 20, 0.02
#: Greatest number of cross-validation groups.
GROUPS = 3


@dataclass(frozen=True)
class Identified:
    """Identified motion model with its cross-validation."""

    motion: ServoMotion  #: The model fitted to all rows.
    helps: bool  #: Whether it improves on the folder's model and is not worse than the programmed path.
    left: Array  #: Distance of left-out rows across the executed path. Shape (n,). [m]
    left_before: Array  #: The same with the folder's model. Shape (n,). [m]
    without: Array  #: Distance across the programmed path. Shape (n,). [m]
    held_out: str  #: Kind of groups left out in turn: "log" or "time"; "" with too few rows.


def identify_motion(windows: Sequence[Window], folder: ServoMotion, arm: Arm) -> Identified:
    """Fit a model to all rows, and cross-validate it by fits without groups of rows."""
    logs = sorted({window.log for window in windows})
    by_log = len(logs) > 1
    count = min(GROUPS, len(logs) if by_log else len(windows))
    groups = [logs.index(w.log) % count if by_log else k * count // len(windows) for k, w in enumerate(windows)]
    without = np.concatenate([window.departure for window in windows])
    before = np.concatenate([measure_left(window, folder, arm) for window in windows])
    if count < 2:
        return Identified(folder, False, without, before, without, "")
    motion = fit_controller(windows, folder, arm)
    shares = (max(motion.blend_share - AROUND, 0.0), motion.blend_share + AROUND)
    left: list[Array] = [np.zeros(0)] * len(windows)
    for group in range(count):
        fitted = fit_controller([w for w, g in zip(windows, groups, strict=True) if g != group], motion, arm, shares)
        for k in np.flatnonzero(np.equal(groups, group)).tolist():
            left[k] = measure_left(windows[k], fitted, arm)
    every = np.concatenate(left)
    found, plain, old = (summarise_distance(values) for values in (every, without, before))
    helps = all(new < was and new < programmed + EQUAL for new, was, programmed in zip(found, old, plain, strict=True))
    return Identified(motion, helps, every, before, without, "log" if by_log else "time")


def summarise_distance(values: Array) -> tuple[float, float]:
    """Return median and 95th percentile."""
    return float(np.median(values)), float(np.percentile(values, 95))


def score(values: tuple[float, float]) -> float:
    """Return the ranking criterion of models: the geometric mean of median and 95th percentile."""
    return float(np.sqrt(max(values[0], 1e-9) * max(values[1], 1e-9)))


def fit_controller(
    windows: Sequence[Window], begin: ServoMotion, arm: Arm, shares: tuple[float, float] = (0.0, MOST_SHARE)
) -> ServoMotion:
    """Fit a model to windows, with its blend share between two bounds."""
    zero = np.zeros(len(begin.lag))
    motion = replace(begin, lag=np.full(len(zero), max(0.01, float(begin.lag.mean()))), acceleration_lag=zero,
                     lost_motion=zero)  # fmt: skip
    some = windows[::2] if len(windows) > SEARCHED else windows
    return fit_motion(windows, search_blend(some, motion, arm, shares), 2 + 3 * len(zero), arm)


def search_blend(windows: Sequence[Window], motion: ServoMotion, arm: Arm, shares: tuple[float, float]) -> ServoMotion:
    """Fit speed and lags at blend shares between two bounds, by a bounded scalar minimisation."""
    fitted = {}

    def left(share: float) -> float:
        fitted[share] = fit_motion(windows, replace(motion, blend_share=share), 2 + len(motion.lag), arm, steps=12)
        gaps = [find_residual(window, run_window(window, fitted[share], arm)) for window in windows]
        return float(np.mean(np.sqrt((np.concatenate(gaps) ** 2).sum(axis=1) + 1e-12)))

    found = minimize_scalar(left, bounds=shares, method="bounded", options={"xatol": FINEST, "maxiter": MOST_TRIED})
    return fitted[found.x]


def fit_motion(windows: Sequence[Window], motion: ServoMotion, free: int, arm: Arm, steps: int = STEPS) -> ServoMotion:
    """Fit a model by robust least squares with a prior; the blend share is fixed.

    `free` is the number of free parameters, in the order: logarithm of the acceleration, smoothing, then lag,
    acceleration lag and lost motion by joint.
    """
    nq = len(motion.lag)
    spread = np.r_[SPEED_SPREAD, np.repeat([*SPREAD.values()], nq)]
    directions = np.diag(spread)[:, :free]

    def left(change: Array) -> Array:
        trial = _apply(motion, directions @ change)
        gaps = [_stack_gap(window, run_window(window, trial, arm)) / NOISE for window in windows]
        return np.concatenate([*gaps, _prior_residuals(trial) / spread])

    step = np.where(directions[1] > 0.0, CYCLE / SPEED_SPREAD[1], STEP)  # the smoothing is a multiple of the cycle
    found = least_squares(left, np.zeros(len(step)), loss="cauchy", f_scale=OUTLIER, diff_step=step,
                          max_nfev=steps)  # fmt: skip
    return _apply(motion, directions @ found.x)


def _apply(motion: ServoMotion, change: Array) -> ServoMotion:
    lag, acceleration, lost = change[2:].reshape(3, -1)
    return replace(
        motion,
        acceleration=float(np.clip(motion.acceleration * np.exp(np.clip(change[0], -0.7, 0.7)), 0.05, 200.0)),
        smoothing=float(np.clip(motion.smoothing + np.clip(change[1], -0.03, 0.03), 0.0, 0.4)),
        lag=np.clip(motion.lag + lag, 0.0, LONGEST_LAG / 2),
        acceleration_lag=np.clip(motion.acceleration_lag + acceleration, -0.02, 0.02),
        lost_motion=np.clip(motion.lost_motion + lost, 0.0, 0.01),
    )


def _stack_gap(window: Window, run: WindowRun) -> Array:
    """Return gaps across the path and weighted speed errors, as lengths. Shape (n (nq + 1),). [m]"""
    across = find_residual(window, run)
    _, slope = run.here
    slope = slope * window.leverage / CYCLE
    size = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    speed = (window.rate * window.leverage * slope).sum(axis=1) / size - size
    return np.concatenate([across.ravel(), SPEED_WEIGHT * speed])


def _prior_residuals(motion: ServoMotion) -> Array:
    """Return the differences of the parameters from their prior means; of a lag, from the mean of all joints."""
    speed = np.log(USUAL[0] / motion.acceleration), USUAL[1] - motion.smoothing
    return np.r_[speed, motion.lag.mean() - motion.lag, -motion.acceleration_lag, -motion.lost_motion]
