"""Identify a controller from logs: blends, speed law, lag and lost motion, kept as far as they help rows left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from compplan.controllers.motion.run import hold_direction, lag_command
from compplan.controllers.motion.windows import (
    CYCLE,
    Window,
    WindowRun,
    drop_along,
    find_residual,
    measure_left,
    read_run,
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
#: Noise of a row [m], how many times it an outlier is, and steps of a fit.
NOISE, OUTLIER, STEPS = 2e-5, 8.0, 5
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
        fitted[share] = fit_motion(windows, replace(motion, blend_share=share), free, arm, steps=3)
        gaps = [find_residual(window, run_window(window, fitted[share], arm)) for window in windows]
        return float(np.mean(np.sqrt((np.concatenate(gaps) ** 2).sum(axis=1) + 1e-12)))

    found = minimize_scalar(left, bounds=shares, method="bounded", options={"xatol": FINEST, "maxiter": MOST_TRIED})
    return fitted[found.x]


def fit_motion(
    windows: Sequence[Window], motion: ServoMotion, free: tuple[str, ...], arm: Arm, steps: int = STEPS
) -> ServoMotion:
    """Fit a model by robust least squares against what is usual; blends stay.

    A joint's parameters change its own column alone, so that one run gives the slopes of all joints. `free` names what
    may change: speed, common or lag, acceleration, lost.
    """
    nq = len(motion.lag)
    directions, spread = _list_directions(free, nq), np.r_[SPEED_SPREAD, np.repeat([*SPREAD.values()], nq)]
    usual = -np.diag(1.0 / spread)
    usual[2 : 2 + nq, 2 : 2 + nq] += 1.0 / nq / SPREAD["lag"]

    @lru_cache(maxsize=2)
    def build(change: bytes) -> ServoMotion:
        return _apply(motion, directions @ np.frombuffer(change))

    def left(change: Array) -> Array:
        trial = build(change.tobytes())
        gaps = [_stack_gap(window, run_window(window, trial, arm)) / NOISE for window in windows]
        return np.concatenate([*gaps, _measure_oddness(trial) / spread])

    def slopes(change: Array) -> Array:
        trial = build(change.tobytes())
        columns = [_find_columns(window, run_window(window, trial, arm), trial, free, arm) for window in windows]
        return np.concatenate([*(-part / NOISE for part in columns), usual]) @ directions

    found = least_squares(
        left, np.zeros(directions.shape[1]), slopes, x_scale="jac", loss="cauchy", f_scale=OUTLIER, max_nfev=4 * steps
    )
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


def _find_columns(window: Window, run: WindowRun, motion: ServoMotion, free: tuple[str, ...], arm: Arm) -> Array:
    """Return the slopes of what a run explains in the numbers of a model; 0 of kinds that are not free.

    Shape (n (nq + 1), 2 + 3 nq).
    """
    nq, gap = window.q.shape[1], _stack_gap(window, run)
    columns, each = np.zeros((len(gap), 2 + 3 * nq)), np.eye(2 + 3 * nq)
    for k, step in enumerate((0.05, 0.004)):
        moved = _stack_gap(window, run_window(window, _apply(motion, step * each[k]), arm))
        columns[:, k] = (gap - moved) / step
    _, tangent = run.here
    for kind, name in enumerate(SPREAD):
        if name not in free and not (name == "lag" and "common" in free):
            continue
        slope = _joint_slopes(run, motion, name)
        here, _ = read_run(slope, run.at)
        rates = SPEED_WEIGHT * _speed_slopes(slope, run, window)
        for j in range(nq):
            part = drop_along(here * window.leverage * (np.arange(nq) == j), tangent * window.leverage)
            columns[:, 2 + kind * nq + j] = np.concatenate([part.ravel(), rates[:, j]])
    return columns


def _speed_slopes(slope: Array, run: WindowRun, window: Window) -> Array:
    """Return by how much each joint's parameter changes the speed along the run. Shape (n, nq)."""
    _, change = read_run(slope, run.at)
    _, tangent = run.here
    tangent = tangent * window.leverage
    size = np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    return np.asarray(change * window.leverage * tangent / size / CYCLE)


def _joint_slopes(run: WindowRun, motion: ServoMotion, name: str) -> Array:
    """Return the slopes of all joints of a run in one kind of parameter, each in its own joint's."""
    if name == "lost":
        return np.asarray(-0.5 * hold_direction(run.command, CYCLE))
    base = lag_command(run.command, motion.lag, motion.acceleration_lag, CYCLE)
    step = 1e-3 if name == "lag" else 1e-5
    lag, acceleration = motion.lag, motion.acceleration_lag
    moved = (lag + step, acceleration) if name == "lag" else (lag, acceleration + step)
    return (lag_command(run.command, *moved, CYCLE) - base) / step


def _measure_oddness(motion: ServoMotion) -> Array:
    """Return how far numbers are from what they usually are; a lag from the mean of all joints."""
    speed = np.log(USUAL[0] / motion.acceleration), USUAL[1] - motion.smoothing
    return np.r_[speed, motion.lag.mean() - motion.lag, -motion.acceleration_lag, -motion.lost_motion]
