"""How drives follow a command: a first-order lag, a residue of the acceleration, motion lost where a joint turns back.

    q = F (q_cmd - T2 d^2 q_cmd / dt^2) - h/2 sign(last motion),   F: 1 / (1 + T1 s)

On a ramp of rate v the joint trails by T1 v, on a parabola of acceleration a by T2 a more. A pure delay, a second-order
drive and feed forward have the same form to second order.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dtbsv

from compplan.controllers.writers.motion_table import ServoMotion
from compplan.robot import Array

#: A joint that goes slower than this does not turn back. [rad/s or m/s]
STILL = 1e-6


def follow_command(q: Array, motion: ServoMotion) -> Array:
    """Return the joints that drives reach of a command at the controller's cycle; they rest before the first row.

    Shape (k, nq). [rad or m]
    """
    lagged = lag_command(q, motion.lag, motion.acceleration_lag, motion.cycle)
    if not motion.lost_motion.any():
        return lagged
    return lagged - 0.5 * motion.lost_motion * hold_direction(q, motion.cycle)


def lag_command(q: Array, lag: Array, acceleration_lag: Array, cycle: float) -> Array:
    """Return a command after lag T1 [s] and acceleration residue T2 [s^2] of every joint, exact for straight pieces.

    Rows of the command, shape (k, nq) [rad or m], are a cycle [s] apart.
    """
    out = np.empty_like(q)
    for j in range(q.shape[1]):
        command = q[:, j]
        if acceleration_lag[j]:
            padded = np.r_[command[0], command, command[-1]]
            command = command - acceleration_lag[j] * np.diff(padded, 2) / cycle**2
        out[:, j] = _lag(command, lag[j] / cycle)
    return out


def _lag(command: Array, cycles: float) -> Array:
    """Filter by 1 / (1 + T s), T in cycles, the input straight between rows: y_k = a y_k-1 + b_0 x_k + b_1 x_k-1."""
    if cycles < 1e-3 or len(command) < 2:
        return command
    a = np.exp(-1.0 / cycles)
    b0, b1 = 1.0 - cycles * (1.0 - a), cycles * (1.0 - a) - a
    rest = command[0]
    moved = command - rest
    driven = b0 * moved
    driven[1:] += b1 * moved[:-1]
    band = np.ones((2, len(moved)), order="F")
    band[1] = -a
    return np.asarray(dtbsv(1, band, driven, lower=1, diag=1, overwrite_x=1)) + rest


def hold_direction(q: Array, cycle: float) -> Array:
    """Return the sign of the last motion of every joint; 0 before it first moves. Shape (k, nq)."""
    rate = np.diff(q, axis=0, prepend=q[:1]) / cycle
    sign = np.where(np.abs(rate) > STILL, np.sign(rate), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q))[:, None], 0), axis=0)
    return np.asarray(np.take_along_axis(sign, last, axis=0))
