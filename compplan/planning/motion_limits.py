"""Factors by which a run is too fast for the velocity, acceleration and torque limits of the joints.

Velocity and acceleration are differences of the joint positions; torque is evaluated along a cubic spline over time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from compplan.robot import Array

#: Time steps below this are ignored. [s]
AT_ONCE = 1e-9
#: Function of joint velocity and acceleration (k, nq): M q', torque of inertia, torque of weight and force, limits.
Torques = Callable[[Array, Array], tuple[Array, Array, Array, Array]]


def measure_torque_use(q: Array, time: Array, torques: Torques) -> Array:
    """Compute the factor by which a run from rest to rest is too fast for joint torques: 1 at a limit. Shape (k,).

    A slowdown by a factor f reduces the torque of inertia by f^2: with the torque D of inertia and S of weight and
    force and the limit L, the factor is (D / (L - S))^(1/2). The torques are those at the waypoints of a cubic spline
    over time, at rest at both ends, as a controller may interpolate. Positions (k, nq), times (k,) [s].
    """
    rows = np.flatnonzero(np.r_[True, np.diff(time) > AT_ONCE])
    if len(rows) < 2:
        return np.ones(len(q))
    curve = CubicSpline(time[rows], q[rows], bc_type="clamped")
    _, moving, held, most = torques(curve(time, 1), curve(time, 2))
    room = np.where(moving > 0.0, most - held, most + held)
    return np.asarray(np.sqrt((np.abs(moving) / np.maximum(room, 1e-12)).max(axis=1)))


def measure_use(q: Array, time: Array, velocity_limits: Array, acceleration_limits: Array) -> Array:
    """Compute max(|v| / v_max, sqrt(|a| / a_max)) along a run from rest to rest, by differences. Shape (k,).

    Above 1 the run is too fast by that factor; q: shape (k, nq), time: shape (k,) [s], limits: shapes (nq,).
    """
    mean, change = difference_motion(q, time)
    by_speed = np.abs(mean / velocity_limits).max(axis=1)
    by_push = np.sqrt(np.abs(change / acceleration_limits).max(axis=1))
    return np.asarray(np.maximum(np.maximum(np.r_[by_speed, 0.0], np.r_[0.0, by_speed]), by_push))


def difference_motion(q: Array, time: Array) -> tuple[Array, Array]:
    """Compute mean velocities of the moves, shape (k - 1, nq), and accelerations at the waypoints, shape (k, nq).

    The run starts and ends at rest.
    """
    step = np.maximum(np.diff(time), 1e-12)
    mean = np.diff(q, axis=0) / step[:, None]
    rest = np.zeros((1, q.shape[1]))
    change = np.diff(np.vstack([rest, mean, rest]), axis=0)
    return mean, change / (0.5 * (np.r_[0.0, step] + np.r_[step, 0.0]))[:, None]


def spread_factors(use: Array, time: Array, reach: float) -> Array:
    """Spread factors above 1 to the waypoints within `reach` [s] of them."""
    wide = np.maximum(use, 1.0)
    found = np.flatnonzero(use > 1.0)
    if not len(found):
        return wide
    for group in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1):
        first = int(np.searchsorted(time, time[group[0]] - reach))
        last = int(np.searchsorted(time, time[group[-1]] + reach, side="right"))
        wide[first:last] = np.maximum(wide[first:last], use[group].max())
    return wide
