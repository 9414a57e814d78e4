"""By what factor a run is too fast for velocity, acceleration and torque of its joints.

Velocity and acceleration count by differences of the joint positions, torque along a cubic spline over time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from compplan.robot import Array, Robot
from compplan.simulation.exact import build_exact_robot, hold_load
from compplan.statics.chain import build_chain, locate_frames

#: Steps of time below this are none. [s]
AT_ONCE = 1e-9
#: Torque left to move with where the static load alone is beyond a limit, as a share of the load.
STATIC_ROOM = 1.05
#: Joint velocity and acceleration (k, nq) to what inertia puts on the joints, what weight and force do, and the limits.
Torques = Callable[[Array, Array], tuple[Array, Array, Array, Array]]


def measure_torque_use(q: Array, time: Array, torques: Torques) -> Array:
    """Tell by what factor a run from rest to rest is too fast for joint torques: 1 at a limit. Shape (k,).

    Slower by a factor f, a run has 1/f^2 of what inertia puts on the joints: with the torque D of inertia and S of
    weight and force within L, the factor is (D / (L - S))^(1/2). It counts at the waypoints of a cubic spline over time
    through the run, at rest at both ends, as a controller may follow it. Positions (k, nq), times (k,) [s].
    """
    rows = np.flatnonzero(np.r_[True, np.diff(time) > AT_ONCE])
    if len(rows) < 2:
        return np.ones(len(q))
    curve = CubicSpline(time[rows], q[rows], bc_type="clamped")
    _, moving, held, most = torques(curve(time, 1), curve(time, 2))
    room = np.where(moving > 0.0, most - held, most + held)
    return np.asarray(np.sqrt((np.abs(moving) / np.maximum(room, 1e-12)).max(axis=1)))


def measure_use(q: Array, time: Array, velocity_limits: Array, acceleration_limits: Array) -> Array:
    """Return max(|v| / v_max, sqrt(|a| / a_max)) along a run from rest to rest, by differences. Shape (k,).

    Above 1 the run is too fast by that factor; q: shape (k, nq), time: shape (k,) [s], limits: shapes (nq,).
    """
    mean, change = difference_motion(q, time)
    by_speed = np.abs(mean / velocity_limits).max(axis=1)
    by_push = np.sqrt(np.abs(change / acceleration_limits).max(axis=1))
    return np.asarray(np.maximum(np.maximum(np.r_[by_speed, 0.0], np.r_[0.0, by_speed]), by_push))


def difference_motion(q: Array, time: Array) -> tuple[Array, Array]:
    """Return mean velocities of the moves, shape (k - 1, nq), and accelerations at the waypoints, shape (k, nq).

    The run starts and ends at rest.
    """
    step = np.maximum(np.diff(time), 1e-12)
    mean = np.diff(q, axis=0) / step[:, None]
    still = np.zeros((1, q.shape[1]))
    change = np.diff(np.vstack([still, mean, still]), axis=0)
    return mean, change / (0.5 * (np.r_[0.0, step] + np.r_[step, 0.0]))[:, None]


def spread_factors(use: Array, time: Array, reach: float) -> Array:
    """Widen factors above 1 to the waypoints within a reach of time."""
    wide = np.maximum(use, 1.0)
    found = np.flatnonzero(use > 1.0)
    if not len(found):
        return wide
    for group in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1):
        first = int(np.searchsorted(time, time[group[0]] - reach))
        last = int(np.searchsorted(time, time[group[-1]] + reach, side="right"))
        wide[first:last] = np.maximum(wide[first:last], use[group].max())
    return wide


class TorqueRules:
    """Joint torques of a cut: tau = a u + b x + c, x the square of the speed along it, u half its rate.

    Masses, weights and the wrench on the tool count; friction does not. Where the static load alone is beyond an effort
    limit, that limit is raised to it and a note says so.
    """

    def __init__(self, robot: Robot, q: Array, wrench: Array) -> None:
        weighed = replace(robot, springs=(), link_elasticities=(), gravity=np.array([0.0, 0.0, -9.81]))
        rigid = build_exact_robot(weighed, standing=True)
        if robot.ground:
            turn = np.swapaxes(locate_frames(build_chain(robot), q).ground, 1, 2)
            wrench = np.hstack([(turn @ part[..., None])[..., 0] for part in (wrench[:, :3], wrench[:, 3:])])
        self.model, self.commanded = rigid.model, rigid.commanded
        self.positions = q @ rigid.commanded.T + rigid.shift
        static = self.held = hold_load(rigid, q, wrench)
        efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1e9)
        greatest = np.abs(static).max(axis=0)
        self.limits = np.maximum(efforts, STATIC_ROOM * greatest)
        self.notes = [
            f"The static load of {robot.joint_names[j]} ({greatest[j]:.0f} N m) is beyond its effort limit "
            f"({efforts[j]:.0f} N m): the limit is left out."
            for j in np.flatnonzero(greatest > efforts)
        ]

    def rows(self, start: int, end: int, rate: Array, change: Array) -> tuple[Array, Array, Array, Array]:
        """Return a, b, c of the waypoints from `start` to `end`, shapes (k, nq), and the limits, shape (nq,). [N m]"""
        data, still = self.model.createData(), np.zeros(self.model.nv)
        place = self.positions[start : end + 1]
        speed, bend = rate @ self.commanded.T, change @ self.commanded.T
        a, b = np.empty((len(place), self.model.nv)), np.empty((len(place), self.model.nv))
        for i in range(len(place)):
            weight = pin.computeGeneralizedGravity(self.model, data, place[i])
            a[i] = pin.rnea(self.model, data, place[i], still, speed[i]) - weight
            b[i] = pin.rnea(self.model, data, place[i], speed[i], bend[i]) - weight
        return a @ self.commanded, b @ self.commanded, self.held[start : end + 1], self.limits
