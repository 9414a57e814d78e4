"""Timing: the fastest run along a commanded path within programmed feed, joint rates and torques.

A cut is timed by TOPP-RA [Pham2018], from rest to rest. With s the programmed time and x = (ds/dt)^2,

    |q'| sqrt(x) <= v_max,  sqrt(x) <= 1 (the programmed feed),  |q' u + q'' x| <= a_max,  u = x' / 2,

and torques tau = a u + b x + c on request. The speed is averaged over a window of time,

    s_T(t) = (S(t) - S(t - T)) / T,    S the integral of s,

which starts at rest and ends at rest later by T. Its speed and acceleration do not exceed those of s nearby, and its
acceleration changes by at most 2 max|s''| / T per second. A window of one period of a natural frequency does not excite
that frequency. Where the differences of joint positions still exceed a limit, the run is slowed down. At a rounded
corner shorter than the distance to come to rest, a run ends in its middle and the next one begins there: both overlap.
Rapid moves go from rest to rest: every joint takes the time of the slowest one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly

from compplan.errors import ConvergenceError
from compplan.io.process_settings import put_off
from compplan.planning.motion_limits import (
    Torques,
    difference_motion,
    measure_torque_use,
    measure_use,
    spread_factors,
)
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.simulation.torque import TorqueRules
from compplan.statics.chain import locate_frames
from compplan.toolpath.corners import compute_parameters, find_roundings
from compplan.toolpath.toolpath import interpolate

#: Share of the programmed feed below which a feed is reduced.
LOWERED = 0.995
#: Usable share of the limits by finite differences, and most rounds of slowing down.
FULL_USE, SLOW_ROUNDS = 0.999, 8
#: End of a run: least rows, time, and smoothing times. [1, s, 1]
END_ROWS, END_TIME, END_SPANS = 100, 6.0, 20.0
#: Time to full speed of a joint without an acceleration limit, in rapid moves. [s]
FULL_SPEED_AFTER = 0.5
#: Replaces an acceleration limit that the robot folder does not have. [rad/s^2 or m/s^2]
NO_LIMIT = 1e4
#: Bisection steps to the initial guess of Newton's method for the time of a waypoint, and Newton steps.
HALVINGS, NEWTON_STEPS = 18, 3
#: Smoothing windows of a run with inertia, in smoothing times: its acceleration must be smooth for the correction.
INERTIA_WINDOWS = (1.0, 1.0, 0.5)
#: Share of the limits reserved for the solver tolerance of TOPP-RA.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Timing:
    """Timing of a command; n waypoints, nq joints."""

    time: Array  #: Time at each waypoint. Shape (n,). [s]
    velocity: Array  #: Joint velocities at each waypoint. Shape (n, nq). [rad/s or m/s]
    acceleration: Array  #: Joint accelerations at each waypoint. Shape (n, nq). [rad/s^2 or m/s^2]
    feed: Array  #: Feed of the move that ends at each waypoint. Shape (n,). [m/s]
    share: Array  #: Feed as a share of the programmed one; 1 in rapid moves. Shape (n,).
    limiting: NDArray[np.int_]  #: Joint nearest to its limit, -1 below 90 % of every limit. Shape (n,).
    by_velocity: NDArray[np.bool_]  #: Whether that is a velocity limit. Shape (n,).
    velocity_ratio: float  #: Greatest joint velocity as a share of its limit.
    acceleration_ratio: float  #: Greatest joint acceleration as a share of its limit; 0 without limits.

    @property
    def lowered(self) -> NDArray[np.bool_]:
        """Waypoints with a reduced feed. Shape (n,)."""
        return self.share < LOWERED


def time_command(
    task: PlanTask, q: Array, *, rules: TorqueRules | None = None, slow: Array | None = None, keep: bool = False
) -> Timing:
    """Compute the timing of a command (n, nq) within the limits of its task and, with `rules`, of the joint torques.

    The run is slower than these require by factors `slow` (n,); with `keep` it keeps its feed at rounded corners.

    Raises:
        ConvergenceError: If no run keeps the limits.
    """
    step, slow = np.zeros(len(q)), task.slowdown if slow is None else slow * task.slowdown
    for start, end in task.moving_runs:
        run = slice(start, end + 1)
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
    """Compute times (n,) [s] that are valid for the first and last moves of every run of a command (n, nq).

    A run ramps within END_TIME plus END_SPANS smoothing times of its ends; moves farther from both are not timed.
    """
    step, far, slow = np.zeros(len(q)), END_TIME + END_SPANS * task.smoothing, task.slowdown
    for start, end in task.moving_runs:
        along = np.r_[0.0, np.cumsum(parameter_steps(task, q, start, end))]
        count = len(along)
        last = max(int(np.searchsorted(along, far)) + 1, END_ROWS)
        first = min(int(np.searchsorted(along, along[-1] - far)), count - END_ROWS)
        parts = [slice(0, count)] if last >= first else [slice(0, last), slice(first, count)]
        for part in parts:
            own = along[part] - along[part.start]
            time = _time_run(task, own, q[start : end + 1][part], None, slow[start : end + 1][part])
            step[start + 1 + part.start : start + part.stop] = np.diff(time)
    return np.cumsum(step)


def time_between_cuts(task: PlanTask, q: Array, time: Array) -> Array:
    """Update times (n,) [s]: joint moves between cuts and at rest have the time required by a command (n, nq)."""
    step, rapid = np.r_[0.0, np.diff(time)], np.r_[False, task.nominal.rapid[1:]]
    for start, end in set(task.runs) - set(task.moving_runs):
        step[start + 1 : end + 1] = np.diff(_turn_in_place(task, q[start : end + 1], start))
    moves = np.flatnonzero(rapid)
    step[moves] = time_rapids(np.abs(q[moves] - q[moves - 1]), task.velocity_limits, task.acceleration_limits)
    return np.cumsum(step)


def state_timing(task: PlanTask, q: Array, time: Array) -> Timing:
    """Compute rates and feeds of a command (n, nq) at given times (n,) [s], by differences."""
    velocity, acceleration = np.zeros(q.shape), np.zeros(q.shape)
    rapid, step = np.r_[False, task.nominal.rapid[1:]], np.r_[0.0, np.diff(time)]
    for start, end in task.runs:
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


def _time_run(task: PlanTask, along: Array, q: Array, rows: Torques | None, slow: Array) -> Array:
    """Compute the smoothed timing of one run from rest to rest; slow it down where differences of q exceed a limit."""
    if len(along) < 3:
        fine = np.linspace(along[0], along[-1], 21)
        return _time_run(task, fine, interpolate(fine, along, q), None, np.interp(fine, along, slow))[[0, -1]]
    limits, window = (FULL_USE * task.velocity_limits, FULL_USE * task.acceleration_limits), task.smoothing
    gentle = 1.0 / window if window > 0 and task.follows_feed else NO_LIMIT
    for _ in range(SLOW_ROUNDS):
        speed = time_cut(along, q, *limits, rows, slow=slow, gentle=gentle)
        for share in INERTIA_WINDOWS if task.inertia else (1.0,):
            time, speed = smooth_profile(along, speed, share * window)
        use = _use_of(task, q, time, rows)
        if use.max() <= 1.0:
            return time
        slow = slow * np.minimum(spread_factors(use, time, window), 4.0) * 1.002
    return _stretch_time(task, q, time, use, rows)


def _use_of(task: PlanTask, q: Array, time: Array, rows: Torques | None) -> Array:
    """Compute the factor by which a run is too fast for joint velocity, acceleration and, with `rows`, torque."""
    use = measure_use(q, time, task.velocity_limits, task.acceleration_limits)
    return use if rows is None else np.maximum(use, measure_torque_use(q, time, rows))


def _stretch_time(task: PlanTask, q: Array, time: Array, use: Array, rows: Torques | None) -> Array:
    """Stretch the time of a run near places that are too fast, the remainder uniformly; return the shortest result."""
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


def find_slowdown(task: PlanTask, q: Array, time: Array) -> Array:
    """Compute the factor by which times (n,) are too short for joint positions (n, nq), spread nearby. Shape (n,).

    The factor is 1 elsewhere.
    """
    slower, rules = np.ones(len(q)), TorqueRules(task.robot, q, task.wrench) if task.torque_limits else None
    for start, end in task.moving_runs:
        run = slice(start, end + 1)
        use = _use_of(task, q[run], time[run], None if rules is None else partial(rules.rows, start, end))
        if use.max() > 1.0:
            slower[run] = np.maximum(slower[run], spread_factors(use, time[run], task.smoothing))
    return slower


def _turn_in_place(task: PlanTask, q: Array, start: int) -> Array:
    """Compute times of joint moves with a fixed required tip: smooth, with the commanded tip within the feed."""
    distance = np.abs(np.diff(q, axis=0)).sum(axis=0)
    duration = ease_duration(distance, FULL_USE * task.velocity_limits, FULL_USE * task.acceleration_limits)
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1))]
    feed = task.nominal.feed[start + 1]
    tip = locate_frames(task.chain, q[[0, -1]]).tcp_position
    length = float(np.linalg.norm(tip[1] - tip[0]))
    duration = max(1.1 * duration, 1.875 * length / feed if feed > 0 else 0.0, task.gentle_time)
    return ease_times(way / max(way[-1], 1e-300), duration)


def time_rapids(distance: Array, velocity_limits: Array, acceleration_limits: Array) -> Array:
    """Compute times of joint moves (k, nq) from rest to rest: trapezoidal speed, slowest joint. Shape (k,). [s]"""
    assumed = np.where(np.isfinite(velocity_limits), velocity_limits / FULL_SPEED_AFTER, NO_LIMIT)
    acceleration = np.where(np.isfinite(acceleration_limits), acceleration_limits, assumed)
    triangle = 2 * np.sqrt(distance / acceleration)
    with np.errstate(invalid="ignore"):
        trapezoid = distance / velocity_limits + velocity_limits / acceleration
    short = distance * acceleration < velocity_limits**2
    return np.asarray(np.where(short, triangle, trapezoid).max(axis=1, initial=0.0))


def parameter_steps(task: PlanTask, q: Array, start: int, end: int) -> Array:
    """Return programmed times of the moves of a cut; a move without length (a turn) has the time of its joints."""
    steps = task.step_time[start:end]
    need = (np.abs(np.diff(q[start : end + 1], axis=0)) / task.velocity_limits).max(axis=1)
    in_place = task.nominal.steps[start:end] <= 0
    return np.maximum(np.where(in_place, need, steps), 1e-7)


def find_narrow(task: PlanTask, along: Array, start: int, end: int) -> list[tuple[int, int, int]]:
    """List first, middle and last waypoint of roundings of a run that are shorter than the motion from feed to rest.

    Waypoint numbers start at the first of the run; `along` is the programmed time at each of them. [s]
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
    """Overlap runs that end and begin in the middles of roundings (`spans`: first, middle, last).

    A smoothed run comes to rest as the fourth power of time: at a distance r and a time d before rest its speed is
    4 r / d. With g = dt/du the rate of the rounding (u even in time) that speed is 4 a / g, thus g = a d / r. If the
    run is slower or slows down later, g = 4 a / v keeps the speed v of the move before or after the rounding. The time
    of the rounding is increased to keep the programmed feed (k,) [m/s]; positions (k, 3) [m], times (k,) [s].
    """
    step = np.diff(time)
    for first, middle, last in spans:
        u, share = compute_parameters(position[first : last + 1])
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


def time_cut(
    along: Array, q: Array, velocity_limits: Array, acceleration_limits: Array, torques: Torques | None = None, *,
    slow: Array | None = None, gentle: float = NO_LIMIT,
) -> Array:  # fmt: skip
    """Solve for the fastest run along one cut: share of the programmed feed at its waypoints. Shape (k,).

    Args:
        along: Time of each waypoint at the programmed feed, from 0; at least three. Shape (k,). [s]
        q: Joint positions. Shape (k, nq). [rad or m]
        velocity_limits: Shape (nq,). [rad/s or m/s]
        acceleration_limits: Shape (nq,), infinite without a limit. [rad/s^2 or m/s^2]
        torques: Function of joint rate q' and q'' to a, b, c and limits of the joint torques, or None.
        slow: Slowdown factor relative to the limits. Shape (k,).
        gentle: Greatest change of the share of the programmed feed. [1/s]

    Raises:
        ConvergenceError: If a limit is exceeded even at rest, or there is no run from rest to rest.
    """
    spline = CubicSpline(along, q, bc_type="natural")
    rate, change = spline(along, 1), spline(along, 2)
    limits = np.where(np.isfinite(acceleration_limits), acceleration_limits, NO_LIMIT)
    slower = np.ones((len(along), 1)) if slow is None else slow[:, None]
    wide, most = np.hstack([rate * slower**2, slower]), np.r_[velocity_limits, 1.0]
    fastest = ((most / np.maximum(np.abs(wide), 1e-12)).min(axis=1)) ** 2
    rows = [wide, np.hstack([change * slower**2, 0.0 * slower]), np.zeros_like(wide), np.r_[limits, gentle]]
    if torques is not None:
        more = torques(rate, change)
        rows = [np.hstack([row, part]) for row, part in zip(rows, more, strict=True)]
        if (np.abs(more[2]) >= more[3]).any():
            raise ConvergenceError("the joint torques exceed their limits even at rest", residual=np.nan)
    *rows, bound = rows
    grid, limit, algorithm = _toppra()
    rule = limit([row / bound for row in rows], np.column_stack([np.zeros(len(along)), fastest]))
    problem = algorithm([rule], grid(along, along[:, None]), gridpoints=along, solver_wrapper="seidel")
    found = problem.compute_parameterization(0.0, 0.0)
    if found is None or found[1] is None or not np.isfinite(found[1]).all():
        raise ConvergenceError("no timing of the path keeps the joint rate limits", residual=np.nan)
    speed = np.maximum(np.asarray(found[1], float), 0.0)
    speed[[0, -1]] = 0.0
    return speed


@cache
def _toppra() -> tuple[Any, Any, Any]:
    """Import toppra on first use: its spline, a constraint of given rows, its algorithm."""
    import logging

    put_off(("matplotlib", "matplotlib.pyplot"))  # toppra imports them only for plots
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType
    from toppra.constraint.linear_constraint import LinearConstraint, canlinear_colloc_to_interpolate

    logging.getLogger("toppra").setLevel(logging.ERROR)

    class RestToRest(TOPPRA):  # type: ignore[misc]
        """TOPP-RA of a run that may rest anywhere: the least controllable speed of every place is zero."""

        def _one_step(self, i: int, following: Array) -> Array:
            fastest = np.array([1e-9, -1.0])
            found = self.solver_wrapper.solve_stagewise_optim(i, None, fastest, np.nan, np.nan, *following)
            return np.array([0.0, found[1]])

    class RowLimit(LinearConstraint):  # type: ignore[misc]
        """Constraint |a u + b x + c| <= 1 at both ends of every move, and bounds of x."""

        def __init__(self, rows: list[Array], bounds: Array) -> None:
            super().__init__()
            self.rows, self.bounds, self.identical = rows, bounds, True
            self.set_discretization_type(DiscretizationType.Interpolation)

        def compute_constraint_params(self, path: Any, gridpoints: Array, *args: Any, **kwargs: Any) -> Any:
            count = self.rows[0].shape[1]
            sides = np.vstack([np.eye(count), -np.eye(count)])
            most = np.full(2 * count, 1.0 - ROUNDING)
            found = canlinear_colloc_to_interpolate(*self.rows, sides, most, None, None, gridpoints, identical=True)
            return (*found[:5], None, self.bounds)  # no bounds of u, those of x

    return toppra.SplineInterpolator, RowLimit, RestToRest


def smooth_profile(along: Array, speed: Array, window: float) -> tuple[Array, Array]:
    """Smooth the speed along a path over a window of time [s], 0 for none; return times [s] and speeds. Shapes (k,).

    Args:
        along: Programmed time at each waypoint, from 0. Shape (k,). [s]
        speed: Share of the programmed feed, its square linear between waypoints, 0 at both ends. Shape (k,).
        window: Length of the window. [s]
    """
    step = 2 * np.diff(along) / np.maximum(speed[1:] + speed[:-1], 1e-12)
    time = np.r_[0.0, np.cumsum(step)]
    rate = np.diff(speed) / step
    if window <= 0:
        return time, speed
    rest = np.zeros((2, 1))  # before and after the run
    law = PPoly(np.hstack([rest, [rate, speed[:-1]], rest]), np.r_[-window, time, time[-1] + window])
    place, area = law.antiderivative(), law.antiderivative(2)
    low, high = time, time + window  # the average is late by at most the window
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        short = (area(middle) - area(middle - window)) / window < along
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    when = 0.5 * (low + high)
    for _ in range(NEWTON_STEPS):
        missed = (area(when) - area(when - window)) / window - along
        slope = (place(when) - place(when - window)) / window
        when = np.clip(when - missed / np.maximum(slope, 1e-12), low, high)
    when[0], when[-1] = 0.0, time[-1] + window
    share = (place(when) - place(when - window)) / window
    share[[0, -1]] = 0.0
    return np.maximum.accumulate(when), np.maximum(share, 0.0)


def ease(u: Array) -> Array:
    """Compute the place of a smooth move at shares u of its time: 10 u^3 - 15 u^4 + 6 u^5."""
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


def ease_times(places: Array, duration: float) -> Array:
    """Compute the times at which a smooth move of a `duration` passes shares of its length (k,). [s]"""
    u = np.linspace(0.0, 1.0, 4001)
    return np.asarray(duration * np.interp(places, ease(u), u))


def ease_duration(distance: Array, velocity_limits: Array, acceleration_limits: Array) -> float:
    """Compute the time T of a smooth move: greatest speed 1.875 d / T, greatest acceleration 5.774 d / T^2. [s]"""
    with np.errstate(divide="ignore", invalid="ignore"):
        by_speed = np.nan_to_num(1.875 * distance / velocity_limits).max(initial=0.0)
        by_acceleration = np.sqrt(np.nan_to_num(5.774 * distance / acceleration_limits).max(initial=0.0))
    return float(max(by_speed, by_acceleration))
