"""Identify a controller from logs: blends, speed law, lag and lost motion, kept as far as they help rows left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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

#: Models from the plainest to the richest: what each lets free.
RUNGS: dict[str, tuple[str, ...]] = {
    "blend": ("speed",),
    "one lag": ("speed", "common"),
    "lag": ("speed", "lag"),
    "lag and acceleration": ("speed", "lag", "acceleration"),
    "lag, acceleration and lost motion": ("speed", "lag", "acceleration", "lost"),
}
#: Greatest blend share, how far around the whole fit's it is searched with rows left out, how finely, and how many are
#: tried; with more windows than `SEARCHED` every second one searches.
MOST_SHARE, AROUND, FINEST, MOST_TRIED, SEARCHED = 2.0, 0.2, 0.02, 9, 4
#: Time in which a wrong speed counts as a distance. [s]
SPEED_WEIGHT = 0.01
#: What a joint is expected to differ by, a standard deviation: lag [s], acceleration lag [s^2], lost motion [rad].
SPREAD = {"lag": 0.02, "acceleration": 5e-4, "lost": 5e-4}
#: Acceleration of the tip [m/s^2] and smoothing [s] that are usual, and spreads of the logarithm of the one and of the
#: other.
USUAL, SPEED_SPREAD = (3.0, 0.04), (1.0, 0.2)
#: A richer model has to leave less than this share of a plainer one, on rows left out.
WORTH = 0.98
#: A model is no worse than the programmed path up to this distance. [m]
EQUAL = 1e-6
#: Noise of a row [m], how many times it an outlier is, trials of a fit, and step of its slopes in usual spreads.
NOISE, OUTLIER, STEPS, STEP = 2e-5, 8.0, 20, 0.02
#: Groups of rows that are left out in turn, at most.
GROUPS = 3


@dataclass(frozen=True)
class Identified:
    """What logs say of a controller."""

    motion: ServoMotion  #: The model fitted to all rows.
    rung: str  #: Its name in `RUNGS`, or "none" where no model helps rows left out.
    helps: bool  #: Whether it is to be written.
    left: Array  #: Distance of rows left out across the executed path. Shape (n,). [m]
    left_before: Array  #: The same by the folder's own values. Shape (n,). [m]
    without: Array  #: Distance across the programmed path. Shape (n,). [m]
    #: By rung the (median, p95) of rows left out. [m]
    ladder: dict[str, tuple[float, float]] = field(default_factory=dict)
    held_out: str = "log"  #: "log" or "time": what was left out in turn.


def identify_motion(windows: Sequence[Window], folder: ServoMotion, arm: Arm) -> Identified:
    """Fit every rung with groups of rows left out, keep the plainest that is nearly the best, and fit it to all."""
    logs = sorted({window.log for window in windows})
    by_log = len(logs) > 1
    count = min(GROUPS, len(logs) if by_log else len(windows))
    groups = [logs.index(w.log) % count if by_log else k * count // len(windows) for k, w in enumerate(windows)]
    without = np.concatenate([window.beside for window in windows])
    before = np.concatenate([measure_left(window, folder, arm) for window in windows])
    if count < 2:
        return Identified(folder, "none", False, without, before, without, {}, "time")
    everything = climb_ladder(windows, folder, arm)
    whole = everything["lag"]  # where the search for each group begins
    pieces: dict[str, dict[int, Array]] = {name: {} for name in RUNGS}
    for group in range(count):
        seen = [w for w, g in zip(windows, groups, strict=True) if g != group]
        fitted = climb_ladder(seen, whole, arm, (max(whole.blend_share - AROUND, 0.0), whole.blend_share + AROUND))
        for name, motion in fitted.items():
            for k, window in enumerate(windows):
                if groups[k] == group:
                    pieces[name][k] = measure_left(window, motion, arm)
    left = {name: np.concatenate([pieces[name][k] for k in range(len(windows))]) for name in RUNGS}
    ladder = {name: summarise_distance(values) for name, values in left.items()}
    best = min(score(values) for values in ladder.values())
    rung = next(name for name, values in ladder.items() if score(values) * WORTH <= best)
    motion = everything[rung]
    none, old = summarise_distance(without), summarise_distance(before)
    helps = all(new < was and new < plain + EQUAL for new, was, plain in zip(ladder[rung], old, none, strict=True))
    held = "log" if by_log else "time"
    return Identified(motion, rung, helps, left[rung], before, without, ladder, held)


def summarise_distance(values: Array) -> tuple[float, float]:
    """Return median and 95th percentile."""
    return float(np.median(values)), float(np.percentile(values, 95))


def score(values: tuple[float, float]) -> float:
    """Return the one number that models are ranked by: the geometric mean of median and 95th percentile."""
    return float(np.sqrt(max(values[0], 1e-9) * max(values[1], 1e-9)))


def climb_ladder(
    windows: Sequence[Window], begin: ServoMotion, arm: Arm, shares: tuple[float, float] = (0.0, MOST_SHARE)
) -> dict[str, ServoMotion]:
    """Fit every rung, each from the one before; the blend share lies between two."""
    zero = np.zeros(len(begin.lag))
    motion = replace(begin, lag=np.full(len(zero), max(0.01, float(begin.lag.mean()))), acceleration_lag=zero,
                     lost_motion=zero)  # fmt: skip
    some = windows[::2] if len(windows) > SEARCHED else windows
    motion = search_blend(some, motion, ("speed", "lag"), arm, shares)
    found: dict[str, ServoMotion] = {}
    for name, free in RUNGS.items():
        if name == "blend":
            plain = replace(motion, lag=zero, acceleration_lag=zero, lost_motion=zero)
            found[name] = fit_motion(windows, plain, free, arm)
        else:
            motion = fit_motion(windows, motion, free, arm)
            found[name] = motion
    return found


def search_blend(
    windows: Sequence[Window], motion: ServoMotion, free: tuple[str, ...], arm: Arm, shares: tuple[float, float]
) -> ServoMotion:
    """Fit the rest at blend shares between two, ever nearer to the best."""
    fitted = {}

    def left(share: float) -> float:
        fitted[share] = fit_motion(windows, replace(motion, blend_share=share), free, arm, steps=12)
        gaps = [find_residual(window, run_window(window, fitted[share], arm)) for window in windows]
        return float(np.mean(np.sqrt((np.concatenate(gaps) ** 2).sum(axis=1) + 1e-12)))

    found = minimize_scalar(left, bounds=shares, method="bounded", options={"xatol": FINEST, "maxiter": MOST_TRIED})
    return fitted[found.x]


def fit_motion(
    windows: Sequence[Window], motion: ServoMotion, free: tuple[str, ...], arm: Arm, steps: int = STEPS
) -> ServoMotion:
    """Fit a model by robust least squares against what is usual; blends stay.

    `free` names what may change: speed, common or lag, acceleration, lost.
    """
    nq = len(motion.lag)
    spread = np.r_[SPEED_SPREAD, np.repeat([*SPREAD.values()], nq)]
    directions = spread[:, None] * _list_directions(free, nq)

    def left(change: Array) -> Array:
        trial = _apply(motion, directions @ change)
        gaps = [_stack_gap(window, run_window(window, trial, arm)) / NOISE for window in windows]
        return np.concatenate([*gaps, _measure_oddness(trial) / spread])

    step = np.where(directions[1] > 0.0, CYCLE / SPEED_SPREAD[1], STEP)  # the smoothing has whole cycles
    found = least_squares(left, np.zeros(len(step)), loss="cauchy", f_scale=OUTLIER, diff_step=step,
                          max_nfev=steps)  # fmt: skip
    return _apply(motion, directions @ found.x)


def _list_directions(free: tuple[str, ...], nq: int) -> Array:
    """Return what each free number adds to the numbers of a model; shape (2 + 3 nq, k).

    Those are the logarithm of the acceleration, the smoothing, and lag, acceleration lag and lost motion by joint.
    """
    each = np.eye(2 + 3 * nq)
    ways = {"speed": each[:, :2], "common": each[:, 2 : 2 + nq].sum(axis=1, keepdims=True)}
    ways |= {kind: each[:, 2 + k * nq : 2 + (k + 1) * nq] for k, kind in enumerate(SPREAD)}
    return np.concatenate([ways[name] for name in free], axis=1)


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
    """Return gaps across the path and of speed, as lengths. Shape (n (nq + 1),). [m]."""
    across = find_residual(window, run)
    _, slope = run.here
    slope = slope * window.leverage / CYCLE
    size = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    speed = (window.rate * window.leverage * slope).sum(axis=1) / size - size
    return np.concatenate([across.ravel(), SPEED_WEIGHT * speed])


def _measure_oddness(motion: ServoMotion) -> Array:
    """Return how far numbers are from what they usually are; a lag from the mean of all joints."""
    speed = np.log(USUAL[0] / motion.acceleration), USUAL[1] - motion.smoothing
    return np.r_[speed, motion.lag.mean() - motion.lag, -motion.acceleration_lag, -motion.lost_motion]
