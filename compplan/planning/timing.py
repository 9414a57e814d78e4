"""Speed along a path: TOPP-RA within joint limits, torques and the programmed feed, and one filter that smooths it.

TOPP-RA [Pham2018] finds the fastest run from rest to rest. With s the programmed time and x = (ds/dt)^2,

    |q'| sqrt(x) <= v_max,  sqrt(x) <= 1 (the programmed feed),  |q' u + q'' x| <= a_max,  u = x' / 2,

and torques tau = a u + b x + c where they count. The filter averages the speed over a window of time,

    s_T(t) = (S(t) - S(t - T)) / T,    S the integral of s,

which starts and ends at rest later by T, has no more speed and acceleration than s has nearby, and changes its
acceleration by no more than 2 max|s''| / T a second. A window of one period of a natural frequency leaves that
frequency unexcited.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from compplan.errors import ConvergenceError
from compplan.io.lazy_imports import put_off
from compplan.robot import Array
from compplan.toolpath.toolpath import interpolate

#: Stands for an acceleration limit that the robot folder does not state. [rad/s^2 or m/s^2]
NO_LIMIT = 1e4
#: From joint motion per programmed time and its derivative to torques tau = a u + b x + c, and their limits.
TorqueParts = Callable[[Array, Array], tuple[Array, Array, Array, Array]]
#: Halvings that bring the time of a waypoint near enough for Newton's steps, and those steps.
HALVINGS, NEWTON_STEPS = 18, 3
#: Times of smoothing of a run whose inertia counts: the correction follows its acceleration, which has to be smooth.
INERTIA_WINDOWS = (1.0, 1.0, 0.5)
#: Share of the limits by which TOPP-RA's answer may pass them, its solver's tolerance; what it leaves of a limit.
ROUNDING = 1e-6


def time_cut(
    along: Array, q: Array, velocity_limits: Array, acceleration_limits: Array, torques: TorqueParts | None = None, *,
    slow: Array | None = None, gentle: float = NO_LIMIT,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Find the fastest run along one cut.

    Args:
        along: Time of each waypoint at the programmed feed, from 0; three at least. Shape (k,). [s]
        q: Joint positions. Shape (k, nq). [rad or m]
        velocity_limits: Shape (nq,). [rad/s or m/s]
        acceleration_limits: Shape (nq,), infinite where there is none. [rad/s^2 or m/s^2]
        torques: From joint motion per programmed time and its derivative to torques and their limits, or None.
        slow: Factor by which the run is to be slower than the limits ask for. Shape (k,).
        gentle: Greatest change of the share of the programmed feed. [1/s]

    Returns:
        Joint motion per programmed time, its derivative (k, nq), share of the programmed feed and its rate (k,).

    Raises:
        ConvergenceError: If a limit leaves no room even at rest.

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
            raise ConvergenceError("no run along the path keeps the joint torques even at rest", residual=np.nan)
    square = fastest_squares(along, fastest, *rows)
    return rate, change, np.sqrt(square), np.r_[0.5 * np.diff(square) / np.diff(along), 0.0]


def fastest_squares(along: Array, fastest: Array, a: Array, b: Array, c: Array, most: Array) -> Array:
    """Return the greatest squares of the speed from rest to rest by TOPP-RA: |a u + b x + c| <= most, x <= fastest.

    Args:
        along: Grid. Shape (k,). [s]
        fastest: Greatest square at each point of it. Shape (k,).
        a: Factor of u. Shape (k, r).
        b: Factor of x. Shape (k, r).
        c: Constant. Shape (k, r).
        most: Limits. Shape (r,).

    Raises:
        ConvergenceError: If there is no run from rest to rest.

    """
    path, limit, algorithm = _toppra()
    rows = a / most, b / most, c / most
    rule = limit(rows, np.column_stack([np.zeros(len(along)), fastest]))
    found = algorithm([rule], path(along), gridpoints=along, solver_wrapper="seidel").compute_parameterization(0.0, 0.0)
    if found is None or found[1] is None or not np.isfinite(found[1]).all():
        raise ConvergenceError("no run along the path keeps the joint rates from rest to rest", residual=np.nan)
    square = np.maximum(np.asarray(found[1], float), 0.0) ** 2
    square[[0, -1]] = 0.0
    return square


@cache
def _toppra() -> tuple[Any, Any, Any]:
    """Load toppra where it is used: its path, a limit of given rows, its algorithm."""
    import logging

    put_off(("matplotlib", "matplotlib.pyplot"))  # toppra imports them for its plots alone
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType
    from toppra.constraint.linear_constraint import LinearConstraint, canlinear_colloc_to_interpolate

    logging.getLogger("toppra").setLevel(logging.ERROR)

    class PathGrid(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        """The grid itself: rows hold what is needed of the path."""

        def __init__(self, along: Array) -> None:
            self.along = along

        def __call__(self, path_positions: Array, order: int = 0) -> Array:
            return np.asarray(path_positions if order == 0 else np.full_like(path_positions, order == 1))[..., None]

        @property
        def dof(self) -> int:
            return 1

        @property
        def path_interval(self) -> Array:
            return np.array([self.along[0], self.along[-1]])

        @property
        def waypoints(self) -> tuple[Array, Array]:
            return self.along, self.along[:, None]

    class RowLimit(LinearConstraint):  # type: ignore[misc]
        """|a u + b x + c| <= 1 at both ends of every move, and bounds of x."""

        def __init__(self, rows: tuple[Array, Array, Array], bounds: Array) -> None:
            super().__init__()
            self.rows, self.bounds, self.identical = rows, bounds, True
            self.set_discretization_type(DiscretizationType.Interpolation)

        def compute_constraint_params(self, path: Any, gridpoints: Array, *args: Any, **kwargs: Any) -> Any:
            count = self.rows[0].shape[1]
            sides = np.vstack([np.eye(count), -np.eye(count)])
            most = np.full(2 * count, 1.0 - ROUNDING)
            found = canlinear_colloc_to_interpolate(*self.rows, sides, most, None, None, gridpoints, identical=True)
            return (*found[:5], None, self.bounds)  # no bounds of u, those of x

    return PathGrid, RowLimit, TOPPRA


@dataclass(frozen=True)
class Profile:
    """How a run goes along its path; k waypoints.

    Attributes:
        time: Time at each waypoint, from 0. Shape (k,). [s]
        speed: Speed along the path, as a share of the programmed feed. Shape (k,).
        push: Its rate. Shape (k,). [1/s]

    """

    time: Array
    speed: Array
    push: Array


def smooth_profile(along: Array, speed: Array, window: float) -> Profile:
    """Smooth the speed along a path over a window of time.

    Args:
        along: Programmed time at each waypoint, from 0. Shape (k,). [s]
        speed: Speed at each waypoint as a share of the programmed feed, its square linear between them, 0 at both ends.
            Shape (k,).
        window: Length of the window, 0 for none. [s]

    """
    step = 2 * np.diff(along) / np.maximum(speed[1:] + speed[:-1], 1e-12)
    time = np.r_[0.0, np.cumsum(step)]
    rate = np.diff(speed) / step
    if window <= 0:
        return Profile(time, speed, np.r_[rate, rate[-1]])
    rest = np.zeros((2, 1))  # before and behind the run
    law = PPoly(np.hstack([rest, [rate, speed[:-1]], rest]), np.r_[-window, time, time[-1] + window])
    place, area = law.antiderivative(), law.antiderivative(2)
    low, high = time, time + window  # the average runs behind by up to the window
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
    share, push = ((each(when) - each(when - window)) / window for each in (place, law))
    share[[0, -1]] = push[[0, -1]] = 0.0
    return Profile(np.maximum.accumulate(when), np.maximum(share, 0.0), push)


def ease(u: Array) -> Array:
    """Return how far a move has come that starts and ends gently, at shares of its time: 10 u^3 - 15 u^4 + 6 u^5."""
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


def ease_times(places: Array, duration: float) -> Array:
    """Return when a move that starts and ends gently passes places: s = 10 u^3 - 15 u^4 + 6 u^5, u = t / duration.

    Args:
        places: Shares of the way, 0 to 1. Shape (k,).
        duration: Time of the whole move. [s]

    """
    u = np.linspace(0.0, 1.0, 4001)
    return np.asarray(duration * np.interp(places, ease(u), u))


def ease_duration(distance: Array, velocity_limits: Array, acceleration_limits: Array) -> float:
    """Return the time that a gentle move needs: greatest speed 1.875 d / T, greatest acceleration 5.774 d / T^2 [s]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        by_speed = np.nan_to_num(1.875 * distance / velocity_limits).max(initial=0.0)
        by_push = np.sqrt(np.nan_to_num(5.774 * distance / acceleration_limits).max(initial=0.0))
    return float(max(by_speed, by_push))


def subdivide(along: Array, q: Array) -> tuple[Array, Array]:
    """Divide the straight move between two waypoints into twenty."""
    grid = np.linspace(along[0], along[-1], 21)
    return grid, interpolate(grid, along, q)
