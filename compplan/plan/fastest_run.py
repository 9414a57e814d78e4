"""The fastest run along one cut, rest to rest: within joint limits, torques and the programmed feed.

With x the square of the speed at each waypoint, every limit of a move is a straight line in the x at its ends:

    A x_{i+1} + B x_i <= c,    from  tau = a u + b x + c,  u = (x_{i+1} - x_i) / (2 ds).

As TOPP-RA [Pham2018] does, a sweep backward finds the greatest x of every waypoint from which the run still comes to
rest, and a sweep forward goes as fast as that allows. What two ends of a move allow each other is a convex polygon
around rest, so that a sweep only compares with its corner of greatest x_i, found for all moves at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from compplan.errors import ConvergenceError
from compplan.robot import Array
from compplan.toolpath.toolpath import interpolate

#: Stands for an acceleration limit that the robot folder does not state. [rad/s^2 or m/s^2]
NO_LIMIT = 1e4
#: Moves whose corners are found at once.
CHUNK = 2048
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
    """Find the fastest run along one cut.

    Args:
        along: Time of each waypoint at the programmed feed, from 0; three at least. Shape (k,). [s]
        q: Joint positions. Shape (k, nq). [rad or m]
        velocity_limits: Shape (nq,). [rad/s or m/s]
        acceleration_limits: Shape (nq,), infinite where there is none. [rad/s^2 or m/s^2]
        torques: From joint motion per programmed time and its derivative to the rows of `TorqueRows`, or None.
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
    fastest[[0, -1]] = 0.0
    bend, push_limits = np.hstack([change * slower**2, 0.0 * slower]), np.r_[limits, gentle]
    rows = _list_rows(np.diff(along), wide, bend, push_limits, None if torques is None else torques(rate, change))
    square = sweep_speed(fastest, *rows)
    speed = np.sqrt(square)
    return rate, change, speed, np.r_[0.5 * np.diff(square) / np.diff(along), 0.0]


class MoveRows(NamedTuple):
    """Limits of every move: after x_{i+1} + before x_i <= most. Shape (k - 1, r) each."""

    after: Array
    before: Array
    most: Array


def _list_rows(
    step: Array, wide: Array, bend: Array, limits: Array, torques: tuple[Array, Array, Array, Array] | None
) -> MoveRows:
    """List what limits a move: accelerations at both of its ends, torques where it begins, both ways."""
    half = (0.5 / step)[:, None]
    parts = [(wide[:-1] * half, bend[:-1] - wide[:-1] * half, limits, limits)]
    ends = wide[1:] * half
    parts.append((ends + bend[1:], -ends, limits, limits))
    if torques is not None:
        a, b, c, most = (each[:-1] if each.ndim == 2 else each for each in torques)
        parts.append((a * half, b - a * half, most - c, most + c))
    shape = (len(step), -1)
    return MoveRows(
        np.hstack([side * after for after, *_ in parts for side in (1.0, -1.0)]),
        np.hstack([side * before for _, before, *_ in parts for side in (1.0, -1.0)]),
        np.hstack([np.broadcast_to(room, (len(step), after.shape[1])).reshape(shape)
                   for after, _, upper, lower in parts for room in (upper, lower)]),
    )  # fmt: skip


def sweep_speed(fastest: Array, after: Array, before: Array, most: Array) -> Array:
    """Return the greatest squares of the speed that begin and end at rest.

    Args:
        fastest: Greatest square at each waypoint. Shape (k,).
        after: Factor of the square at the end of each move. Shape (k - 1, r).
        before: Factor of the square at its beginning. Shape (k - 1, r).
        most: What both may come to, positive. Shape (k - 1, r).

    Raises:
        ConvergenceError: If a limit leaves no room even at rest.

    """
    if (most <= 0.0).any():
        raise ConvergenceError("no run along the path keeps the joint rates from rest to rest", residual=np.nan)
    corner = np.concatenate([
        _find_corners(fastest[k : k + CHUNK], *(each[k : k + CHUNK] for each in (after, before, most)))
        for k in range(0, len(after), CHUNK)
    ])  # fmt: skip
    least = _lowest_end(corner, after, before, most)
    with np.errstate(divide="ignore", invalid="ignore"):
        start = np.where(before > 0.0, most / before, np.inf)
        lost = np.where(before > 0.0, after / before, 0.0)
        reach = np.where(after > 0.0, most / after, np.inf)
        gone = np.where(after > 0.0, before / after, 0.0)
    best = [*corner.tolist(), float(fastest[-1])]
    lowest = least.tolist()
    for i in range(len(corner) - 1, -1, -1):
        if best[i + 1] < lowest[i]:
            best[i] = max(float((start[i] - lost[i] * best[i + 1]).min()), 0.0)
    ahead = np.array(best)
    kept = (reach - gone * ahead[:-1, None]).min(axis=1) >= ahead[1:]
    square, at = [0.0], 0.0
    for i, free in enumerate(kept.tolist()):
        if not free or at < best[i]:
            at = max(min(float((reach[i] - gone[i] * at).min()), best[i + 1]), 0.0)
        else:
            at = best[i + 1]
        square.append(at)
    return np.array(square)


def _find_corners(fastest: Array, after: Array, before: Array, most: Array) -> Array:
    """Find the greatest square at the beginning of every move that any square at its end goes with.

    A row that lets the end be at most so much, and one that asks it to be at least so much, together bound the
    beginning [Fourier-Motzkin]; so do rows that need the end to be no less than rest.
    """
    top, low = np.maximum(after, 0.0), np.maximum(-after, 0.0)
    best = fastest[: len(after)].copy()
    count = after.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        alone = np.where((after >= 0.0) & (before > 0.0), most / before, np.inf)
        best = np.minimum(best, alone.min(axis=1))
        for k in range(count):
            factor = low[:, [k]] * before + top * before[:, [k]]
            room = low[:, [k]] * most + top * most[:, [k]]
            bound = np.where((top > 0.0) & (low[:, [k]] > 0.0) & (factor > 0.0), room / factor, np.inf)
            best = np.minimum(best, bound.min(axis=1))
    return np.asarray(best)


def _lowest_end(corner: Array, after: Array, before: Array, most: Array) -> Array:
    """Return the least square at the end of every move that goes with its greatest at the beginning."""
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(after < 0.0, (before * corner[:, None] - most) / -after, 0.0)
    return np.maximum(least.max(axis=1), 0.0)


def subdivide(along: Array, q: Array) -> tuple[Array, Array]:
    """Divide the straight move between two waypoints into twenty."""
    grid = np.linspace(along[0], along[-1], 21)
    return grid, interpolate(grid, along, q)
