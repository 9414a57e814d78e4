"""Where the loaded tool goes between waypoints, whichever way the controller takes from one to the next.

Joint-linear (joints.csv, joint moves of programs), Cartesian-linear (the commanded tip on a straight line), and a cubic
spline over time through each run. The wrench goes over linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from compplan.effects.attained import attain_with_effects
from compplan.planning.task import PlanTask, attain_rows, cutting_runs
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.sensitivity import attain_pose

#: Places on a move that are looked at, as shares of it.
SHARES = (0.5, 0.25, 0.75)
#: Moves that stray by less than this in the middle are not looked at elsewhere. [m]
STRAIGHT = 2e-7
#: A spline may stray by this many chords before moves are divided for it: no program that is written follows one.
SPLINE_CHORDS = 7.0


@dataclass(frozen=True)
class Between:
    """Greatest distance of the loaded tip from each move; n - 1 moves, zero in rapid moves.

    Attributes:
        joint: Joint positions linear in time. Shape (n - 1,). [m]
        cartesian: Commanded tip on a straight line. Shape (n - 1,). [m]
        spline: Cubic spline over time; like `joint` where no times are known. Shape (n - 1,). [m]

    """

    joint: Array
    cartesian: Array
    spline: Array

    @property
    def most(self) -> Array:
        """Greatest distance of all three. Shape (n - 1,). [m]."""
        return np.maximum(np.maximum(self.joint, self.cartesian), self.spline)

    @property
    def driven(self) -> Array:
        """Greatest distance of the two ways that programs take; the cubic is no written one. Shape (n - 1,). [m]."""
        return np.maximum(self.joint, self.cartesian)

    @property
    def max_deviation(self) -> float:
        """Greatest distance over the path. [m]."""
        return float(self.most.max(initial=0.0))


def judged_moves(task: PlanTask) -> NDArray[np.int_]:
    """Return the moves of the cut, by the waypoint that they start at."""
    return np.flatnonzero(~task.nominal.rapid[1:] & ~task.lead[1:])


def measure_between(task: PlanTask, q: Array, time: Array | None = None, *, bow: bool = False) -> Between:
    """Measure how far the loaded tip strays between waypoints of a command (n, nq), by the planner's own model.

    `time` (n,) [s] gives the spline. With `bow` the straight line between the attained ends is measured against, so
    that what is missed at the waypoints themselves does not count; otherwise the wanted path is.
    """
    moves, n = judged_moves(task), len(task)
    joint, cartesian, spline = (np.zeros(n - 1) for _ in range(3))
    ends = attain_rows(task, q, np.arange(n), slope=False).position if bow else task.position
    plain = locate_frames(task.chain, q).tcp_position
    for share in SHARES:
        if share != SHARES[0]:
            moves = moves[np.maximum(np.maximum(joint, cartesian), spline)[moves] > STRAIGHT]
        if not len(moves):
            break
        start, end = ends[moves], ends[moves + 1]
        load = task.wrench[moves] * (1 - share) + task.wrench[moves + 1] * share
        middle = q[moves] * (1 - share) + q[moves + 1] * share
        bias = None if task.bias is None else task.bias[moves] * (1 - share) + task.bias[moves + 1] * share
        loaded = _attain(task, q, middle, load, bias, moves, share)
        joint[moves] = np.maximum(joint[moves], _distance(loaded, start, end))
        straight = plain[moves] * (1 - share) + plain[moves + 1] * share
        bent = loaded - locate_frames(task.chain, middle).tcp_position
        cartesian[moves] = np.maximum(cartesian[moves], _distance(straight + bent, start, end))
        if time is not None:
            curved = follow_spline(task, q, time, moves, share)
            tip = _attain(task, q, curved, load, bias, moves, share)
            spline[moves] = np.maximum(spline[moves], _distance(tip, start, end))
    return Between(joint, cartesian, joint if time is None else spline)


def insert_between(values: Array, inside: Array, moves: NDArray[np.int_], share: float) -> Array:
    """Put one row into every move: those given at `moves`, the others on a straight line. Shape (2 n - 1, ...)."""
    rows = np.empty((2 * len(values) - 1, *values.shape[1:]))
    rows[::2], rows[1::2] = values, values[:-1] * (1 - share) + values[1:] * share
    rows[2 * moves + 1] = inside
    return rows


def divide_times(step_time: Array, share: float) -> Array:
    """Return the times of all moves of a path of `insert_between`. Shape (2 n - 2,). [s]."""
    return np.stack([step_time * share, step_time * (1 - share)], axis=1).ravel()


def _attain(
    task: PlanTask, q: Array, middle: Array, load: Array, bias: Array | None, moves: NDArray[np.int_], share: float
) -> Array:
    """Return the loaded tip at a share of some moves; effects of the robot's folder see the whole path in order."""
    near = task.theta[moves]
    loaded = attain_pose(task.chain, middle, load, slope=False, torque_bias=bias, theta=near).position
    if not task.robot.effects:
        return task.see_position(loaded)
    if bias is not None:
        loaded = loaded - attain_pose(task.chain, middle, load, slope=False).position
    path, acting = (insert_between(*parts, moves, share) for parts in ((q, middle), (task.wrench, load)))
    tip = attain_with_effects(task.robot, path, acting, divide_times(task.step_time, share))[0][2 * moves + 1]
    return task.see_position(tip if bias is None else tip + loaded)


def follow_spline(task: PlanTask, q: Array, time: Array, moves: NDArray[np.int_], share: float) -> Array:
    """Return joint positions at a share of some moves, on cubic splines over time through each run at rest at its ends.

    Shape (k, nq).
    """
    found = q[moves] * (1 - share) + q[moves + 1] * share
    rapid = np.r_[False, task.nominal.rapid[1:]]
    for first, last in cutting_runs(rapid):
        mine = np.flatnonzero((moves >= first) & (moves < last))
        if not len(mine) or last - first < 2:
            continue
        run = np.arange(first, last + 1)
        run = run[np.r_[True, np.diff(time[run]) > 0.0]]  # two rows at one place take no time
        if len(run) < 2:
            continue
        curve = CubicSpline(time[run], q[run], bc_type="clamped")
        found[mine] = curve(time[moves[mine]] * (1 - share) + time[moves[mine] + 1] * share)
    return found


def wanted_pieces(between: Between, chord: Array | float) -> NDArray[np.int_]:
    """Tell into how many pieces each move has to be divided to stay within a chord, one or (n - 1,) [m]. (n - 1,)."""
    nearest = np.maximum(np.maximum(between.joint, between.cartesian), between.spline / SPLINE_CHORDS)
    excess = np.maximum(nearest / np.maximum(chord, 1e-12), 0.0)
    return np.where(excess > 1.0, np.ceil(np.sqrt(1.2 * excess)), 1.0).astype(int)


def _distance(point: Array, start: Array, end: Array) -> Array:
    """Return the distance of points from straight moves. Shape (k,)."""
    along = end - start
    square = np.maximum(np.einsum("ni,ni->n", along, along), 1e-30)
    share = np.clip(np.einsum("ni,ni->n", point - start, along) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(point - start - share[:, None] * along, axis=1))
