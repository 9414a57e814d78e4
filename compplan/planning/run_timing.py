"""When the robot is where: the fastest run along the commanded path within the programmed feed and the rate limits.

Cuts are timed by TOPP-RA [Pham2018]: joint velocity and acceleration limits, the programmed feed as the upper bound,
from rest to rest, then smoothed (`compplan.planning.timing`). Where smoothing or the division of
the path leaves a difference of joint positions beyond a limit, the run is slowed down there. At a corner that is
rounded within less than a run needs to come to rest, it comes to rest in its middle, and starts before that: both
overlap. Rapid moves are joint moves from rest to rest: every joint takes the time of the slowest one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compplan.planning.motion_limits import Torques, difference_motion, measure_smooth_use, measure_use, spread_factors
from compplan.planning.task import PlanTask
from compplan.planning.timing import (
    INERTIA_WINDOWS,
    NO_LIMIT,
    Profile,
    TorqueParts,
    ease_duration,
    ease_times,
    smooth_profile,
    subdivide,
    time_cut,
)
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.toolpath.corners import find_roundings, find_shares

#: A feed below this share of the programmed one counts as lowered.
LOWERED = 0.995
#: Share of the limits that a run may use by finite differences, and rounds that slow it down where it uses more.
FULL_USE, SLOW_ROUNDS = 0.999, 8
#: What of a run counts as its end: rows, time, and spans of smoothing. [1, s, 1]
END_ROWS, END_TIME, END_SPANS = 100, 6.0, 20.0
#: Windows of smoothing that are tried where a limit of the jerk slows a run down, in those of the task.
WINDOWS = (1.5, 2.0, 3.0, 4.5, 7.0, 10.0)
#: Acceleration of a joint whose folder states none, in rapid moves: full speed after this time. [s]
FULL_SPEED_AFTER = 0.5


class TorqueRows(Protocol):
    """Joint torques of a cut: tau = a u + b x + c, x the square of the speed, u half its rate."""

    def rows(self, start: int, end: int, rate: Array, change: Array) -> tuple[Array, Array, Array, Array]:
        """Return a, b, c of the waypoints from `start` to `end`, shapes (k, nq), and the limits, shape (nq,) [N m]."""


@dataclass(frozen=True)
class Timing:
    """The run of a command; n waypoints, nq joints.

    Attributes:
        time: Time at each waypoint. Shape (n,). [s]
        velocity: Joint velocities at each waypoint. Shape (n, nq). [rad/s or m/s]
        acceleration: Joint accelerations at each waypoint. Shape (n, nq). [rad/s^2 or m/s^2]
        feed: Feed of the move that ends at each waypoint. Shape (n,). [m/s]
        share: Feed as a share of the programmed one; 1 in rapid moves. Shape (n,).
        limiting: Joint whose limit is used the most, -1 where none is near. Shape (n,).
        by_velocity: Whether that limit is the velocity's. Shape (n,).
        velocity_ratio: Greatest joint velocity against its limit.
        acceleration_ratio: Greatest joint acceleration against its limit; 0 where no limit is known.

    """

    time: Array
    velocity: Array
    acceleration: Array
    feed: Array
    share: Array
    limiting: NDArray[np.int_]
    by_velocity: NDArray[np.bool_]
    velocity_ratio: float
    acceleration_ratio: float

    @property
    def lowered(self) -> NDArray[np.bool_]:
        """Waypoints whose feed had to be lowered. Shape (n,)."""
        return self.share < LOWERED


def time_command(
    task: PlanTask, q: Array, *, rules: TorqueRows | None = None, slow: Array | None = None, keep: bool = False
) -> Timing:
    """Time a command.

    Args:
        task: The task that it fulfils: programmed feed, limits, rapid moves.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        rules: Joint torques to keep within limits, or None.
        slow: Factor by which the run is to be slower than the limits ask for, or None. Shape (n,).
        keep: Whether the feed is to be kept at rounded corners.

    Raises:
        ConvergenceError: If no run keeps the limits.

    """
    step, slow = np.zeros(len(q)), task.pace if slow is None else slow * task.pace
    for start, end in cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests):
        run = slice(start, end + 1)
        if not task.nominal.steps[start:end].any():
            continue
        along = np.r_[0.0, np.cumsum(parameter_steps(task, q, start, end))]
        own = slow[run]
        spans = [] if keep else find_narrow(task, along, start, end)
        edges, time = [0, *(middle for _, middle, _ in spans), end - start], np.zeros(end + 1 - start)
        for first, last in pairwise(edges):
            leg, rows = slice(first, last + 1), None
            if rules is not None:
                rows = partial(rules.rows, start + first, start + last)
            time[leg] = time[first] + _time_run(task, along[leg] - along[first], q[run][leg], rows, own[leg])
        if spans:
            time = overlap_legs(time, task.position[run], task.nominal.feed[run], spans)
            torques = None if rules is None else partial(rules.rows, start, end)
            use = _use_of(task, q[run], time, torques)
            time = time if use.max() <= 1.0 else _stretch_time(task, q[run], time, use, torques)
        step[start + 1 : end + 1] = np.diff(time)
    return state_timing(task, q, time_between_cuts(task, q, np.cumsum(step)))


def time_ends(task: PlanTask, q: Array) -> Array:
    """Return times of which the first and the last moves of every run from rest to rest are right.

    A run speeds up and slows down within END_TIME and some spans of smoothing; what lies farther away is not timed.

    Args:
        task: The task: programmed feed, limits, rapid moves.
        q: Commanded joint positions. Shape (n, nq). [rad or m]

    Returns:
        Time at each waypoint. Shape (n,). [s]

    """
    step, far, pace = np.zeros(len(q)), END_TIME + END_SPANS * task.smoothing, task.pace
    for start, end in cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests):
        if not task.nominal.steps[start:end].any():
            continue
        along = np.r_[0.0, np.cumsum(parameter_steps(task, q, start, end))]
        count = len(along)
        last = max(int(np.searchsorted(along, far)) + 1, END_ROWS)
        first = min(int(np.searchsorted(along, along[-1] - far)), count - END_ROWS)
        parts = [slice(0, count)] if last >= first else [slice(0, last), slice(first, count)]
        for part in parts:
            own = along[part] - along[part.start]
            time = _time_run(task, own, q[start : end + 1][part], None, pace[start : end + 1][part])
            step[start + 1 + part.start : start + part.stop] = np.diff(time)
    return np.cumsum(step)


def time_between_cuts(task: PlanTask, q: Array, time: Array) -> Array:
    """Return times in which joint moves between cuts and at rest take as long as a command needs.

    Args:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time at each waypoint, of which those of the cuts count. Shape (n,). [s]

    """
    step, rapid = np.r_[0.0, np.diff(time)], np.r_[False, task.nominal.rapid[1:]]
    for start, end in cutting_runs(rapid, task.rests):
        if not task.nominal.steps[start:end].any():
            step[start + 1 : end + 1] = np.diff(_turn_in_place(task, q[start : end + 1], start))
    moves = np.flatnonzero(rapid)
    step[moves] = time_rapids(np.abs(q[moves] - q[moves - 1]), task.velocity_limits, task.acceleration_limits)
    return np.cumsum(step)


def state_timing(task: PlanTask, q: Array, time: Array) -> Timing:
    """Work out rates and feeds of a command at given times, by differences.

    Args:
        task: The task that it fulfils.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time at each waypoint. Shape (n,). [s]

    """
    velocity, acceleration = np.zeros(q.shape), np.zeros(q.shape)
    rapid, step = np.r_[False, task.nominal.rapid[1:]], np.r_[0.0, np.diff(time)]
    for start, end in cutting_runs(rapid, task.rests):
        run = slice(start, end + 1)
        mean, acceleration[run] = difference_motion(q[run], time[run])
        velocity[run] = 0.5 * (np.vstack([mean, mean[-1:]]) + np.vstack([mean[:1], mean]))
    length = np.r_[0.0, task.nominal.steps]
    with np.errstate(divide="ignore", invalid="ignore"):
        feed = np.where(step > 0, length / step, task.nominal.feed)
        share = np.where(rapid | (task.nominal.feed <= 0) | (length <= 0), 1.0, feed / task.nominal.feed)
    use_v = np.abs(velocity) / task.velocity_limits
    use_a = np.abs(acceleration) / task.acceleration_limits
    worst_v, worst_a = use_v.max(axis=1), use_a.max(axis=1)
    by_velocity = worst_v >= worst_a
    limiting = np.where(by_velocity, use_v.argmax(axis=1), use_a.argmax(axis=1))
    limiting = np.where(np.maximum(worst_v, worst_a) > 0.9, limiting, -1)
    share[0] = share[1] if len(q) > 1 and not rapid[1] else 1.0
    ratios = float(worst_v.max()), float(worst_a.max())
    return Timing(time, velocity, acceleration, feed, share, limiting, by_velocity, *ratios)


def _time_run(task: PlanTask, along: Array, q: Array, rows: TorqueParts | None, slow: Array) -> Array:
    """Time one run from rest to rest, smoothly, and slow it down where differences of q are beyond a limit."""
    time, rounds = _smooth_run(task, along, q, rows, slow, task.smoothing)
    if rounds == 1 or (task.jerk_limits is None and rounds <= SLOW_ROUNDS):
        return time
    for factor in WINDOWS:  # a longer ramp may cost less than a slower run
        other = _smooth_run(task, along, q, rows, slow, factor * task.smoothing)[0]
        if other[-1] > 1.1 * time[-1]:
            break
        time = min(time, other, key=lambda each: float(each[-1]))
    return time


def _most_push(task: PlanTask, window: float) -> float:
    """Return the greatest change of the share of the programmed feed. [1/s]."""
    return 1.0 / window if window > 0 and task.follows_feed else NO_LIMIT


def _smooth(task: PlanTask, along: Array, speed: Array, window: float) -> Profile:
    """Return a run whose speed along the path is smoothed over a window, thrice where inertia counts."""
    for share in INERTIA_WINDOWS if task.inertia else (1.0,):
        profile = smooth_profile(along, speed, share * window)
        speed = profile.speed
    return profile


def _smooth_run(
    task: PlanTask, along: Array, q: Array, rows: TorqueParts | None, slow: Array, window: float
) -> tuple[Array, int]:
    """Time one run with a window of smoothing; also tell after how many rounds it keeps its limits."""
    if len(along) < 3:
        fine, between = subdivide(along, q)
        time, rounds = _smooth_run(task, fine, between, None, np.interp(fine, along, slow), window)
        return time[[0, -1]], rounds
    limits = FULL_USE * task.velocity_limits, FULL_USE * task.acceleration_limits
    for count in range(SLOW_ROUNDS):
        speed = time_cut(along, q, *limits, rows, slow=slow, gentle=_most_push(task, window))[2]
        time = _smooth(task, along, speed, window).time
        use = _use_of(task, q, time, rows)
        if use.max() <= 1.0:
            return time, count + 1
        slow = slow * np.minimum(spread_factors(use, time, window), 4.0) * 1.002
    return _stretch_time(task, q, time, use, rows), SLOW_ROUNDS + 1


def _use_of(task: PlanTask, q: Array, time: Array, rows: Torques | None) -> Array:
    """Tell by what factor a run is too fast: by its differences, and as a spline where jerk or torque has a limit."""
    use = measure_use(q, time, task.velocity_limits, task.acceleration_limits)
    if task.jerk_limits is None and rows is None:
        return use
    limits = task.velocity_limits, task.acceleration_limits, task.jerk_limits
    return np.maximum(use, measure_smooth_use(q, time, *limits, rows))


def _stretch_time(task: PlanTask, q: Array, time: Array, use: Array, rows: Torques | None) -> Array:
    """Stretch the time of a run near the places that are still too fast; all of it, of the shortest, where none do."""
    reach, best = max(task.smoothing, 1e-3), time * float(use.max()) * 1.001
    for _ in range(SLOW_ROUNDS):
        factor = spread_factors(use, time, 1.5 * reach) * 1.002
        total = np.r_[0.0, np.cumsum(0.5 * (factor[1:] + factor[:-1]) * np.diff(time))]
        low, high = (np.clip(time + side * reach, time[0], time[-1]) for side in (-0.5, 0.5))
        mean = (np.interp(high, time, total) - np.interp(low, time, total)) / (high - low)
        time = np.r_[0.0, np.cumsum(np.diff(time) * 0.5 * (mean[1:] + mean[:-1]))]
        use = _use_of(task, q, time, rows)
        best = min(best, time * max(1.001 * float(use.max()), 1.0), key=lambda each: float(each[-1]))
        if use.max() <= 1.0:
            break
    return best


def find_slowdown(task: PlanTask, q: Array, time: Array, rules: TorqueRows | None = None) -> Array:
    """Tell by what factor times are too short for joint positions, nearby waypoints included: 1 where they are not.

    Args:
        task: The task.
        q: Joint positions. Shape (n, nq). [rad or m]
        time: Time at each waypoint. Shape (n,). [s]
        rules: Joint torques to keep within limits, or None.

    Returns:
        Shape (n,).

    """
    slower, rapid = np.ones(len(q)), np.r_[False, task.nominal.rapid[1:]]
    for start, end in cutting_runs(rapid, task.rests):
        run = slice(start, end + 1)
        use = _use_of(task, q[run], time[run], None if rules is None else partial(rules.rows, start, end))
        if use.max() > 1.0 and task.nominal.steps[start:end].any():
            slower[run] = np.maximum(slower[run], spread_factors(use, time[run], task.smoothing))
    return slower


def _turn_in_place(task: PlanTask, q: Array, start: int) -> Array:
    """Time joint moves during which the wanted tip stays: gently, and the commanded tip no faster than the feed."""
    distance = np.abs(np.diff(q, axis=0)).sum(axis=0)
    duration = ease_duration(distance, FULL_USE * task.velocity_limits, FULL_USE * task.acceleration_limits)
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))]
    feed = task.nominal.feed[start + 1]
    tip = locate_frames(task.chain, q[[0, -1]]).tcp_position
    length = float(np.linalg.norm(tip[1] - tip[0]))
    if task.jerk_limits is not None:  # its greatest jerk is 60 d / T^3, at its ends
        duration = max(duration, float(np.cbrt(60.0 * distance / (FULL_USE * task.jerk_limits)).max()))
    duration = max(1.1 * duration, 1.875 * length / feed if feed > 0 else 0.0, task.gentle_time)
    return ease_times(way / max(way[-1], 1e-300), duration)


def time_rapids(distance: Array, velocity_limits: Array, acceleration_limits: Array) -> Array:
    """Time joint moves from rest to rest with trapezoidal speed; the slowest joint counts.

    Args:
        distance: Distance of each joint. Shape (k, nq). [rad or m]
        velocity_limits: Shape (nq,). [rad/s or m/s]
        acceleration_limits: Shape (nq,). [rad/s^2 or m/s^2]

    Returns:
        Time of each move. Shape (k,). [s]

    """
    assumed = np.where(np.isfinite(velocity_limits), velocity_limits / FULL_SPEED_AFTER, NO_LIMIT)
    push = np.where(np.isfinite(acceleration_limits), acceleration_limits, assumed)
    triangle = 2 * np.sqrt(distance / push)
    with np.errstate(invalid="ignore"):
        trapezoid = distance / velocity_limits + velocity_limits / push
    short = distance * push < velocity_limits**2
    return np.asarray(np.where(short, triangle, trapezoid).max(axis=1, initial=0.0))


def cutting_runs(rapid: NDArray[np.bool_], rests: NDArray[np.bool_] | None = None) -> list[tuple[int, int]]:
    """List first and last waypoint of every run from rest to rest; the first is where it is reached.

    Args:
        rapid: Whether the move that ends at a waypoint is rapid. Shape (n,).
        rests: Waypoints within a cut at which the tool comes to rest, or None. Shape (n,).

    """
    moves = np.flatnonzero(~rapid[1:]) + 1
    if not len(moves):
        return []
    new = np.diff(moves) > 1
    if rests is not None:
        new |= rests[moves[:-1]]
    breaks = np.flatnonzero(new)
    firsts, lasts = np.r_[moves[0], moves[breaks + 1]], np.r_[moves[breaks], moves[-1]]
    return [(int(first) - 1, int(last)) for first, last in zip(firsts, lasts, strict=True)]


def parameter_steps(task: PlanTask, q: Array, start: int, end: int) -> Array:
    """Return programmed times of the moves of a cut; a move without length (a turn) takes what its joints need."""
    steps = task.step_time[start:end]
    need = (np.abs(np.diff(q[start : end + 1], axis=0)) / task.velocity_limits).max(axis=1)
    still = task.nominal.steps[start:end] <= 0
    return np.maximum(np.where(still, need, steps), 1e-7)


def find_narrow(task: PlanTask, along: Array, start: int, end: int) -> list[tuple[int, int, int]]:
    """List first, middle and last waypoint of the roundings of a run that are shorter than its way from feed to rest.

    Waypoints count from the run's first.

    Args:
        task: The task.
        along: Programmed time at each waypoint of the run. Shape (k,). [s]
        start: First waypoint of the run.
        end: Its last waypoint.

    """
    window = task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
    found = []
    for first, last in find_roundings(task.nominal):
        first, last = first - start, last - start
        if first > 0 and last < end - start and last - first > 1 and along[last] - along[first] < window:
            middle = int(np.searchsorted(along, 0.5 * (along[first] + along[last])))
            found.append((first, min(max(middle, first + 1), last - 1), last))
    return found


def overlap_legs(time: Array, position: Array, feed: Array, spans: list[tuple[int, int, int]]) -> Array:
    """Let runs that end and begin in the middles of roundings overlap, u of the rounding even in time.

    A run that is smoothed comes to rest as the fourth power of time: one that is r before it rests d later, and goes
    on at 4 r / d, which is 4 a / g with g the rate dt/du of the rounding: g = a d / r. Where the run is slower or slows
    down later than that, g = 4 a / v keeps the speed v of the move that leads to the rounding, or away from it. The
    rounding takes longer by what keeps the programmed feed.

    Args:
        time: Time at each waypoint with rests in the middles. Shape (k,). [s]
        position: Shape (k, 3). [m]
        feed: Programmed feed to each waypoint. Shape (k,). [m/s]
        spans: First, middle and last waypoint of each rounding.

    """
    step = np.diff(time)
    for first, middle, last in spans:
        u, share = find_shares(position[first : last + 1])
        steps = np.linalg.norm(np.diff(position[first : last + 1], axis=0), axis=1)
        reach, before = share * steps.sum(), steps[: middle - first].sum()
        ways = np.linalg.norm(position[[first, last + 1]] - position[[first - 1, last]], axis=1)
        slowness = 4.0 * (time[[first, last + 1]] - time[[first - 1, last]]) / np.maximum(ways, 1e-9)
        rests = (time[middle] - time[first]) / before, (time[last] - time[middle]) / (steps.sum() - before)
        rate, end = (reach * np.maximum(rests, slowness)).tolist()
        change = end - rate
        taken = np.diff(rate * u + 0.5 * change * u**2)
        wanted = feed[first + 1 : last + 1]
        least = np.divide(steps, wanted, out=np.zeros(len(steps)), where=wanted > 0.0)
        step[first:last] = taken * max(float((least / taken).max()), 1.0)
    return np.r_[0.0, np.cumsum(step)]
