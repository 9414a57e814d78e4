"""When the controller is where: the fastest speed along a path within feed, joint limits and tip acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.controllers.motion.geometry import Path
from compplan.controllers.writers.motion_table import ServoMotion
from compplan.robot import Array


@dataclass(frozen=True)
class Schedule:
    """Length along a path by time, smoothed as the controller's interpolator gives it out."""

    time: Array  #: Instants, a cycle apart. Shape (k,). [s]
    s: Array  #: Length along the path. Shape (k,). [m]


def limit_speed(path: Path, motion: ServoMotion) -> Array:
    """Return the speed along s at every point: at most the feed, joint velocities, and what corners allow. (m,) [m/s]

    A point's curvature q'' costs v^2 |q''| of each joint's acceleration and v^2 |p''| of the tip's; on the way between
    points v^2 grows by at most 2 a ds.
    """
    step = np.diff(path.s)
    slope, bend, tip_slope, tip_bend = path.bends
    tiny = 1e-12
    speed = np.r_[path.feed[:1], np.minimum(path.feed[:-1], path.feed[1:])]
    speed = np.minimum(speed, (motion.velocity_limits / np.maximum(slope, tiny)).min(axis=1))
    square = speed**2
    corner = np.minimum((motion.acceleration_limits / np.maximum(bend, tiny)).min(axis=1),
                        motion.acceleration / np.maximum(tip_bend, tiny))  # fmt: skip
    square = np.minimum(square, corner)
    square[path.stops] = 0.0
    gain = np.minimum((motion.acceleration_limits / np.maximum(slope, tiny)).min(axis=1),
                      motion.acceleration / np.maximum(tip_slope, 1e-3))  # fmt: skip
    grown = np.r_[0.0, np.cumsum(2.0 * np.minimum(gain[:-1], gain[1:]) * step)]
    square = np.minimum.accumulate(square - grown) + grown
    square = (np.minimum.accumulate((square + grown)[::-1])[::-1]) - grown
    return np.sqrt(np.maximum(square, 0.0))


def schedule_path(path: Path, motion: ServoMotion) -> Schedule:
    """Tell when the controller is where, at its cycle; it rests at exact stops until its smoothing has come to rest."""
    speed = limit_speed(path, motion)
    step = np.diff(path.s)
    duration = 2.0 * step / np.maximum(speed[:-1] + speed[1:], 1e-6)
    rest = np.zeros(len(path.s))
    rest[path.stops] = motion.smoothing
    arrive = np.r_[0.0, np.cumsum(duration + rest[:-1])]
    leave = arrive + rest
    total = leave[-1] + motion.smoothing
    time = np.arange(0.0, total + motion.cycle, motion.cycle)
    s = _move_evenly(path.s, speed, arrive, leave, time)
    return Schedule(time, _average(s, max(1, round(motion.smoothing / motion.cycle))))


def _move_evenly(s: Array, speed: Array, arrive: Array, leave: Array, time: Array) -> Array:
    """Return the length at instants; between two points the acceleration is even."""
    i = np.clip(np.searchsorted(arrive, time, "right") - 1, 0, len(s) - 2)
    begin, end = leave[i], arrive[i + 1]
    u = np.clip(time - begin, 0.0, end - begin)
    change = (speed[i + 1] - speed[i]) / np.maximum(end - begin, 1e-12)
    moved = s[i] + speed[i] * u + 0.5 * change * u**2
    return np.asarray(np.where(time >= arrive[-1], s[-1], np.minimum(moved, s[i + 1])))


def _average(s: Array, width: int) -> Array:
    """Average over the last `width` instants; before the first the controller rests."""
    total = np.cumsum(np.r_[np.full(width, s[0]), s] - s[0])
    averaged = (total[width:] - total[:-width]) / width + s[0]
    return np.asarray(np.maximum.accumulate(averaged))
