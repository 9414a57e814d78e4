"""The fastest run along one cut, rest to rest, by TOPP-RA [Pham2018]: within joint limits, torques, programmed feed."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from compplan.errors import ConvergenceError
from compplan.robot import Array

#: Stands for an acceleration limit that the robot folder does not state. [rad/s^2 or m/s^2]
NO_LIMIT = 1e4
#: From joint motion per programmed time and its derivative to torques tau = a u + b x + c, and their limits.
TorqueParts = Callable[[Array, Array], tuple[Array, Array, Array, Array]]


def time_cut(
    along: Array,
    q: Array,
    velocity_limits: Array,
    acceleration_limits: Array,
    torques: TorqueParts | None = None,
    *,
    slow: Array | None = None,
    gentle: float = NO_LIMIT,
) -> tuple[Array, Array, Array, Array]:
    """Time one cut by TOPP-RA.

    Args:
        along: Time of each waypoint at the programmed feed, from 0. Shape (k,). [s]
        q: Joint positions. Shape (k, nq). [rad or m]
        velocity_limits: Shape (nq,). [rad/s or m/s]
        acceleration_limits: Shape (nq,), infinite where there is none. [rad/s^2 or m/s^2]
        torques: From joint motion per programmed time and its derivative to the rows of `TorqueRows`, or None; not for
            cuts of fewer than three waypoints.
        slow: Factor by which the run is to be slower than the limits ask for. Shape (k,).
        gentle: Greatest change of the share of the programmed feed. [1/s]

    Returns:
        Joint motion per programmed time, its derivative (k, nq), share of the programmed feed and its rate (k,).

    """
    if len(along) < 3:
        fine, q = _subdivide(along, q)
        rate, change, speed, push = time_cut(fine, q, velocity_limits, acceleration_limits, gentle=gentle)
        even = np.diff(fine).mean() * 2 / np.maximum(speed[1:] + speed[:-1], 1e-12)
        mean = 2 * (along[-1] - along[0]) / even.sum()
        return rate[[0, -1]], change[[0, -1]], np.r_[0.0, mean][: len(along)], push[[0, -1]]
    spline = CubicSpline(along, q, bc_type="natural")
    rate, change = spline(along, 1), spline(along, 2)
    limits = np.where(np.isfinite(acceleration_limits), acceleration_limits, NO_LIMIT)
    bounds = [] if torques is None else [_bound_torques(*torques(rate, change))]
    speed, push = _run_toppra(along, rate, change, velocity_limits, limits, bounds, slow, gentle)
    return rate, change, speed, push


def _bound_torques(a: Array, b: Array, c: Array, limits: Array) -> Any:
    """Make TOPP-RA's constraint |a u + b x + c| <= limits at the waypoints."""
    from toppra.constraint.linear_constraint import LinearConstraint

    class Torques(LinearConstraint):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.dof, self.identical = a.shape[1] + 1, True

        def compute_constraint_params(self, path: _Path, gridpoints: Array) -> tuple[Any, ...]:
            both = np.vstack([np.eye(a.shape[1]), -np.eye(a.shape[1])])
            return a, b, c, both, np.r_[limits, limits], None, None

    return Torques()


def _run_toppra(
    along: Array, rate: Array, change: Array, velocity: Array, acceleration: Array, bounds: list[Any],
    slow: Array | None, gentle: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the share of the programmed feed and its rate at every waypoint."""
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    slower = np.ones((len(along), 1)) if slow is None else slow[:, None]
    path = _Path(along, np.hstack([rate * slower**2, slower]), np.hstack([change * slower**2, 0 * slower]))
    wide = np.column_stack([-np.r_[velocity, 1.0], np.r_[velocity, 1.0]])
    push = np.column_stack([-np.r_[acceleration, gentle], np.r_[acceleration, gentle]])
    for scheme in (
        toppra.constraint.DiscretizationType.Interpolation,
        toppra.constraint.DiscretizationType.Collocation,
    ):
        rules = [
            constraint.JointVelocityConstraint(wide),
            constraint.JointAccelerationConstraint(push, discretization_scheme=scheme),
            *bounds,
        ]
        solver = algorithm.TOPPRA(
            rules, path, gridpoints=along, solver_wrapper="seidel", parametrizer="ParametrizeSpline"
        )
        push_along, speed, _ = solver.compute_parameterization(0.0, 0.0)
        if speed is not None and np.isfinite(speed).all():
            return np.asarray(speed).ravel(), np.r_[np.asarray(push_along).ravel(), 0.0]
    raise ConvergenceError("no run along the path keeps the joint rates from rest to rest", residual=np.nan)


class _Path:
    """A path as TOPP-RA reads it, known at its waypoints; the last coordinate is the programmed time itself."""

    def __init__(self, along: Array, rate: Array, change: Array) -> None:
        self.along = along
        self.values = {1: rate, 2: change}
        self.dof = rate.shape[1]
        self.path_interval = np.array([along[0], along[-1]])
        self.duration = float(along[-1] - along[0])

    def __call__(self, s: Array, order: int = 0) -> Array:
        if order == 0:
            return np.zeros((len(np.atleast_1d(s)), self.dof))
        rows = np.clip(np.searchsorted(self.along, s), 0, len(self.along) - 1)
        return np.asarray(self.values[order][rows])


def _subdivide(along: Array, q: Array) -> tuple[Array, Array]:
    grid = np.linspace(along[0], along[-1], 21)
    return grid, np.stack([np.interp(grid, along, column) for column in q.T], axis=1)
