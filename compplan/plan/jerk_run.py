"""The shortest run along a path within velocity, acceleration and jerk, by the squares x of its speed at the waypoints.

    minimise  T(x) = sum 2 ds_i / (sqrt x_i + sqrt x_{i+1}),    x <= x of the fastest run without a limit of the jerk

Rates are those of the cubic spline over time that counts where jerk has a limit, and of differences. By x, velocities
go as the root, accelerations are straight, and so is the jerk of a move times its duration h. As h is convex in x,

    -1 <= jerk h / h_0 <= h / h_0,    the right side by its tangent,

asks for a little more than the limit: a step that is solved so keeps it, however long it is. Sequential quadratic
programs; a waypoint moves the rates of its neighbours alone, so that waypoints SPREAD apart are differentiated at once.
After every step the run is slowed down or sped up as a whole until its first rate is at the limit: all runs that are
compared keep their limits and touch one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compplan.plan.motion_limits import CYCLE, difference_motion, spline_motion
from compplan.plan.quadratic import solve_conic
from compplan.robot import Array

#: Waypoints that are differentiated at once stand so far apart: what a cubic spline hands on falls to .27 a waypoint.
SPREAD = 10
#: Relative change of x that tells how rates answer; derivatives below the second are none.
PROBE, FADED = 1e-5, 1e-3
#: Shares of a limit from which on rates stand in a step; velocities are bounded by the fastest run.
NEAR = np.array([np.inf, np.inf, 0.05, 0.25, 0.05, 0.05])
#: Greatest relative change of x in the first step, at last, and in any; growth and shrinkage.
FIRST_STEP, LEAST_STEP, MOST_STEP, GROW, SHRINK = 1.0, 0.02, 4.0, 2.0, 0.4
#: Least of x that a step leaves, as a share.
LEFT = 0.1
#: Steps at most, and gain of time that ends the search.
STEPS, GAIN = 16, 2e-3
#: Least share of its limit that the jerk has at rest.
LEAST_RAMP = 0.01
#: Exponents by which rates fall where a run is slower; 2 for an acceleration at rest, which counts over one cycle.
ORDERS = np.array([1, 1, 2, 2, 2, 3])


#: Entries of a matrix: values, rows, columns.
Entries = tuple[Array, NDArray[np.int_], NDArray[np.int_]]


class RateLimits(NamedTuple):
    """Limits, infinite where there are none.

    Attributes:
        velocity: Shape (nq,). [rad/s or m/s]
        acceleration: Shape (nq,). [rad/s^2 or m/s^2]
        jerk: Shape (nq,). [rad/s^3 or m/s^3]
        ramp: Time from rest, or to it, in which the jerk comes to its limit. [s]

    """

    velocity: Array
    acceleration: Array
    jerk: Array
    ramp: float = 0.0


def shorten_run(q: Array, along: Array, speed: Array, fastest: Array, limits: RateLimits, slow: Array) -> Array:
    """Shorten a run from rest to rest within velocity, acceleration and jerk.

    Args:
        q: Joint positions. Shape (k, nq). [rad or m]
        along: Time of each waypoint at the programmed feed. Shape (k,). [s]
        speed: Share of the programmed feed to begin with, 0 at both ends alone. Shape (k,).
        fastest: The greatest share. Shape (k,).
        limits: The limits.
        slow: Factor by which the run is to be slower than the limits ask for. Shape (k,).

    Returns:
        Time of each waypoint; the run keeps its limits and touches one. Shape (k,). [s]

    """
    length, most, size = np.diff(along), fastest[1:-1] ** 2, FIRST_STEP

    def touch(x: Array) -> tuple[Array, float]:
        """Scale squares of the speed until the first rate, or the speed, is at its limit; also tell the time."""
        use = (np.abs(_list_rates(q, _take(length, x), limits, slow)) ** (1.0 / ORDERS[:, None, None])).max()
        x = x / max(use, float(np.sqrt((x / most).max()))) ** 2
        return x, float(_take(length, x).sum())

    x, time = touch(np.minimum(np.maximum(speed[1:-1] ** 2, 1e-12), most))
    for _ in range(STEPS):
        matrix, room = _list_rows(q, length, x, limits, slow)
        slope, hessian = _bend_time(length, x)
        while True:
            upper = np.clip(most / x - 1.0, 0.0, size)
            lower = np.full(len(x), -min(size, 1.0 - LEFT))
            change = solve_conic(hessian, slope, matrix, room, lower, upper)
            trial = touch(x * (1.0 + np.clip(change, lower, upper))) if np.isfinite(change).all() else (x, np.inf)
            if trial[1] < time or size < LEAST_STEP:
                break
            size *= SHRINK
        gain = 1.0 - trial[1] / time
        if gain > 0.0:
            x, time = trial
        if gain < GAIN:
            break
        size = min(size * (GROW if np.abs(change).max() > 0.8 * size else 1.0), MOST_STEP)
    return np.r_[0.0, np.cumsum(_take(length, x))]


def _take(length: Array, x: Array) -> Array:
    """Return the times of the moves. Shape (k - 1,). [s]."""
    r = np.sqrt(np.r_[0.0, x, 0.0])
    return 2.0 * length / (r[1:] + r[:-1])


def _bend_time(length: Array, x: Array) -> tuple[Array, sparse.csc_matrix]:
    """Return gradient and Hessian of the time by relative changes of x."""
    r = np.sqrt(np.r_[0.0, x, 0.0])
    both = r[1:] + r[:-1]
    before, after = length[:-1] / both[:-1] ** 2, length[1:] / both[1:] ** 2
    r = r[1:-1]
    slope = -(before + after) * r
    diagonal = 0.5 * r * (before + after) + r**2 * (before / both[:-1] + after / both[1:])
    beside = (length[1:-1] / both[1:-1] ** 3) * r[1:] * r[:-1]
    return slope, sparse.diags([beside, diagonal, beside], [-1, 0, 1]).tocsc()


def _list_rates(q: Array, step: Array, limits: RateLimits, slow: Array) -> Array:
    """List rates by their limits, at waypoints or moves that begin there. Shape (6, k, nq)."""
    velocity, acceleration, jerk, ramp = limits
    speed, push, change = spline_motion(q, step)
    mean, bend = difference_motion(q, np.r_[0.0, np.cumsum(step)])
    if ramp > 0.0:
        away = np.minimum(np.cumsum(step), np.cumsum(step[::-1])[::-1])
        change = change / np.clip(away / ramp, LEAST_RAMP, 1.0)[:, None]
    still, sudden, slow = np.zeros((1, q.shape[1])), np.zeros_like(q), slow[:, None]
    sudden[[0, -1]] = push[[0, -1]] / CYCLE
    return np.stack([
        slow * speed / velocity, slow * np.vstack([mean, still]) / velocity, slow**2 * push / acceleration,
        slow**2 * bend / acceleration, slow**2 * sudden / jerk, slow**3 * np.vstack([change, still]) / jerk,
    ])  # fmt: skip


def _list_rows(
    q: Array, length: Array, x: Array, limits: RateLimits, slow: Array
) -> tuple[sparse.csc_matrix, Array]:
    """Return rows A d <= b for the relative change d of x."""
    step = _take(length, x)
    value = _list_rates(q, step, limits, slow)
    kind, at, joint = np.nonzero(np.abs(value) > NEAR[:, None, None])
    value, order, count, own = value[kind, at, joint], ORDERS[kind], len(x), np.minimum(at, len(step) - 1)
    parts: list[Entries] = []
    rooms: list[Entries] = []
    for first in range(min(SPREAD, count)):
        moved, places = x.copy(), np.arange(first, count, SPREAD)
        moved[places] *= 1.0 + PROBE
        other = _take(length, moved)
        longer = np.where(order == 3, (other / step)[own], 1.0)
        found = _list_rates(q, other, limits, slow)[kind, at, joint]
        slope = (found * longer - value) / PROBE
        near = np.clip(np.rint((at - 1 + 0.5 * (order == 3) - first) / SPREAD), 0, len(places) - 1).astype(int)
        for side, into in ((slope, parts), ((longer - 1.0) / PROBE, rooms)):
            rows = np.flatnonzero(np.abs(side) > FADED)
            into.append((side[rows], rows, places[near][rows]))
    rate, room = (_gather(each, (len(value), count)) for each in (parts, rooms))
    return sparse.vstack([rate - room, -rate - room]).tocsc(), np.maximum(np.r_[1.0 - value, 1.0 + value], 0.0)


def _gather(parts: list[Entries], shape: tuple[int, int]) -> sparse.csr_matrix:
    values, rows, columns = (np.concatenate(each) for each in zip(*parts, strict=True))
    return sparse.csr_matrix((values, (rows, columns)), shape=shape)
