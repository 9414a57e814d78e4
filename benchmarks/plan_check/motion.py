"""How a controller may go from row to row: joint-linear, Cartesian-linear, or a cubic spline over time."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.plan_check.cell import Kinematics, rotation_difference
from benchmarks.plan_check.job import Array
from benchmarks.plan_check.robot import rotation_vector

#: Places between two rows, as shares of the move.
SHARES = np.array([0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98])
#: A Cartesian move that inverse kinematics cannot follow better than this is no move. [m, rad]
FOLLOWED = 1e-7


def joint_linear(q: Array, moves: np.ndarray) -> Array:
    """Return joint positions between rows i and i + 1 for every i of `moves`. Shape (k, shares, nq)."""
    share = SHARES[None, :, None]
    return q[moves][:, None] * (1 - share) + q[moves + 1][:, None] * share


def cartesian_linear(kinematics: Kinematics, q: Array, moves: np.ndarray) -> tuple[Array, np.ndarray]:
    """Let the commanded tip go straight and its orientation turn evenly; also tell which moves can be followed."""
    start = joint_linear(q, moves)
    ends = kinematics.tip(q[moves]), kinematics.tip(q[moves + 1])
    turn = rotation_difference(ends[1][:, :3, :3] @ np.swapaxes(ends[0][:, :3, :3], 1, 2))
    wanted = np.tile(np.eye(4), (len(moves), len(SHARES), 1, 1))
    for k, share in enumerate(SHARES):
        wanted[:, k, :3, 3] = ends[0][:, :3, 3] * (1 - share) + ends[1][:, :3, 3] * share
        part = np.stack([rotation_vector(share * vector) for vector in turn]) if len(turn) else np.zeros((0, 3, 3))
        wanted[:, k, :3, :3] = part @ ends[0][:, :3, :3]
    found, left = kinematics.reach(start.reshape(-1, q.shape[1]), wanted.reshape(-1, 4, 4))
    follows = (left.reshape(len(moves), -1) < FOLLOWED).all(axis=1)
    return found.reshape(start.shape), follows


def spline(time: Array, q: Array, runs: list[tuple[int, int]], moves: np.ndarray) -> Array:
    """Return the cubic spline over time through the rows of every run, at rest at both ends. Shape (k, shares, nq)."""
    between = joint_linear(q, moves)
    for first, last in runs:
        mine = np.flatnonzero((moves >= first) & (moves < last))
        steps = np.diff(time[first : last + 1])
        if not len(mine) or last - first < 2 or steps.min() <= 0:
            continue
        curve = CubicSpline(time[first : last + 1], q[first : last + 1], bc_type="clamped")
        at = time[moves[mine]][:, None] + SHARES * (time[moves[mine] + 1] - time[moves[mine]])[:, None]
        between[mine] = curve(at)
    return between


def runs_of(fed: np.ndarray) -> list[tuple[int, int]]:
    """List first and last row of every run of moves that are fed; `fed[i]` tells of the move that ends at row i."""
    inside = fed.copy()
    inside[0] = False
    edges = np.diff(np.r_[0, inside.astype(int), 0])
    return list(zip((np.flatnonzero(edges == 1) - 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
