"""Solve the program of time, posture and promise: step by step, everything linearised where the search stands."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from compplan.plan.one_program import JointProgram, Point, TimedStretch
from compplan.plan.quadratic import StepRows, StepVariables, solve_quadratic
from compplan.plan.timing import time_rapids
from compplan.posture.clearance import EXACT
from compplan.robot import Array

LOG = logging.getLogger(__name__)

#: Share of a limit from which on a row stands in a step.
NEAR = 0.3
#: First step of a coefficient, the least one, growth and shrinkage of steps. [units]
FIRST_STEP, LEAST_STEP, GROW, SHRINK = 0.6, 0.02, 1.6, 0.35
#: Steps at most, gain that counts as one, and small gains in a row that end the search.
STEPS, GAIN, DULL = 24, 1e-3, 3


def solve_program(program: JointProgram) -> Point:
    """Search for the least cost; the start itself where no step brings any.

    Args:
        program: The program.

    """
    assert program.first is not None
    point, size, dull = replace(program.first, cost=program.cost(program.first)), FIRST_STEP, 0
    for count in range(STEPS):
        point = program.differentiate(point)
        step = propose_step(program, point, size)
        if step is None:
            break
        near = point.q + np.einsum("kjf,kf->kj", point.rate, program.freedom.values(point.change + step) - point.values)
        trial = program.evaluate(point.change + step, near)
        program.steps = count + 1
        gain = -np.inf if trial is None else point.cost - trial.cost
        LOG.debug("step %d of %.3f: gain %.5f, time %.4f s", count, size, gain, np.nan if trial is None else trial.time)
        if trial is None or gain <= 0.0:
            size *= SHRINK
        else:
            point, size, dull = trial, size * (GROW if np.abs(step).max() > 0.8 * size else 1.0), dull + 1
            dull = 0 if gain > GAIN else dull
        if size < LEAST_STEP or dull >= DULL:
            break
    return point


def propose_step(program: JointProgram, point: Point, size: float) -> Array | None:
    """Solve the quadratic program around a point; return the change of the coefficients, None without any."""
    freedom, prices, first = program.freedom, program.prices, program.first
    assert first is not None
    m, f = point.change.shape
    counts = [run.last + 1 - run.first for run in program.runs]
    marks = program.marks()
    variables = StepVariables(m * f, sum(counts), len(program.rapids), (len(marks) - 1) * f)
    columns = (freedom.basis[:, None, :, None] * (point.rate * freedom.units)[:, :, None, :]).reshape(
        len(freedom.rows), -1, m * f
    )
    spread = (freedom.basis[:, None, :, None] * (np.eye(f) * freedom.units)[None, :, None, :]).reshape(-1, f, m * f)
    rows = StepRows(variables)
    offset = 0
    for run, speed in zip(program.runs, point.speeds, strict=True):
        _add_run(program, rows, run, speed**2, point.q, columns, offset, size)
        offset += len(run.along)
    lower, upper = program.bounds()
    _add_limits(rows, point.q, columns, lower, upper, size)
    for k in np.flatnonzero(np.isfinite(freedom.most).any(axis=0)).tolist():
        for side in (1.0, -1.0):
            rows.add(np.maximum(freedom.most[:, k] - side * point.values[:, k], 0.0), c=side * spread[:, k])
    _add_rapids(program, rows, point, columns)
    _add_band(program, rows, point, spread)
    if program.ground.clear is not None:
        margin, by_c = program.ground.clear.linearise(point.q, columns)
        rows.add(np.maximum(margin - EXACT, 0.0), c=-by_c)
    travel, move = np.diff(spread[marks], axis=0) / freedom.units[:, None], np.diff(point.values[marks], axis=0)
    every = np.arange((len(marks) - 1) * f)
    for sign in (1.0, -1.0):
        rows.add(-sign * (move / freedom.units).ravel(), c=sign * travel.reshape(-1, m * f), t=(every, -1.0))
    weight = prices.time / first.time
    parts = [_time_slopes(run.along, speed) for run, speed in zip(program.runs, point.speeds, strict=True)]
    square = np.concatenate([speed**2 for speed in point.speeds])
    ends = np.concatenate([[0, n - 1] + np.cumsum([0, *counts])[i] for i, n in enumerate(counts)]).astype(int)
    pull, push = _price_work(program, point, columns)
    answer = solve_quadratic(
        rows, slope=weight * np.concatenate([part[0] for part in parts]) + push, pull=pull, fixed=freedom.fixed,
        bend=[weight * np.concatenate([part[k] for part in parts]) for k in (1, 2)],
        rapid=weight, travel=prices.motion, band=prices.band, square=square, ends=ends, size=size,
    )  # fmt: skip
    return None if answer is None else answer.reshape(m, f)


def _time_slopes(along: Array, speed: Array) -> tuple[Array, Array, Array]:
    """Return first and second derivatives of the time of a run by the squares of its speed: slope, diagonal, beside it.

    T = sum 2 ds / (r_i + r_{i+1}), r the root of the square.
    """
    r = np.maximum(speed, 1e-3)
    step, both = np.diff(along), r[1:] + r[:-1]
    slope, diagonal, beside = np.zeros(len(r)), np.zeros(len(r)), np.zeros(len(r))
    for here, side in ((r[:-1], slice(None, -1)), (r[1:], slice(1, None))):
        slope[side] -= step / (here * both**2)
        diagonal[side] += step * (0.5 / (here**3 * both**2) + 1.0 / (here**2 * both**3))
    beside[:-1] = step / (r[:-1] * r[1:] * both**3)
    return slope, diagonal, beside


def _add_run(
    program: JointProgram, rows: StepRows, run: TimedStretch, x: Array, q: Array, columns: Array, offset: int,
    size: float,
) -> None:  # fmt: skip
    """Add velocity, acceleration, torque and jerk along one run: what is near a limit, or may pass it in a step."""
    task, part = program.freedom.task, slice(run.first, run.last + 1)
    curve = CubicSpline(run.along, q[part], bc_type="natural")
    moved = CubicSpline(run.along, columns[part], bc_type="natural")
    rate, change = curve(run.along, 1), curve(run.along, 2)
    d_rate, d_change = moved(run.along, 1), moved(run.along, 2)
    here = offset + np.arange(len(x))
    limit = task.velocity_limits
    used = rate**2 * x[:, None] / limit**2
    i, j = np.nonzero(used > NEAR)
    rows.add(1.0 - used[i, j], c=(2.0 * rate[i, j] * x[i] / limit[j] ** 2)[:, None] * d_rate[i, j],
             x=((here[i], rate[i, j] ** 2 / limit[j] ** 2),))  # fmt: skip
    speed = np.sqrt(np.maximum(x, 1e-6))[:, None]
    for side in (1.0, -1.0):  # a square says nothing of a joint that stands
        value, by_c = side * rate * speed / limit, side * d_rate * (speed / limit)[:, :, None]
        i, j = np.nonzero((used <= NEAR) & _reaches(value, by_c, size))
        rows.add(1.0 - value[i, j], c=by_c[i, j], x=((here[i], (0.5 * value / speed**2)[i, j]),))
    half, grow = 0.5 / np.diff(run.along), np.diff(x)
    u = grow * half
    limit = np.where(np.isfinite(task.acceleration_limits), task.acceleration_limits, 1e4)
    pushes = []
    for end in (0, 1):
        p, b, at = rate[end : len(rate) - 1 + end], change[end : len(rate) - 1 + end], x[end : len(x) - 1 + end]
        value = (p * u[:, None] + b * at[:, None]) / limit
        by_c = (d_rate[end : len(x) - 1 + end] * u[:, None, None] + d_change[end : len(x) - 1 + end]
                * at[:, None, None]) / limit[:, None]  # fmt: skip
        ahead, behind = (p * half[:, None] + end * b) / limit, ((1 - end) * b - p * half[:, None]) / limit
        pushes.append((value, by_c, ahead, behind))
        for side in (1.0, -1.0):
            i, j = np.nonzero((side * value > NEAR) | _reaches(side * value, by_c, size))
            rows.add(1.0 - side * value[i, j], c=side * by_c[i, j],
                     x=((here[i + 1], side * ahead[i, j]), (here[i], side * behind[i, j])))  # fmt: skip
    if task.jerk_limits is not None:
        _add_jerk(rows, pushes, x, run.along, limit / task.jerk_limits, here)
    if program.ground.torques is not None:
        a, b, c, most = program.ground.torques(q)(run.first, run.last, rate, change)
        torque = (a[:-1] * u[:, None] + b[:-1] * x[:-1, None] + c[:-1]) / most
        i, j = np.nonzero(np.abs(torque) > NEAR)
        sign = np.sign(torque[i, j]) / most[j]
        rows.add(np.maximum(1.0 - np.abs(torque[i, j]), 0.0), x=(
            (here[i + 1], sign * a[i, j] * half[i]), (here[i], sign * (b[i, j] - a[i, j] * half[i]))))  # fmt: skip


def _reaches(value: Array, by_c: Array, size: float) -> NDArray[np.bool_]:
    """Tell which shares of a limit a step of this size may bring beyond it."""
    return np.asarray(value + size * np.abs(by_c).sum(axis=2) > 1.0)


def _add_jerk(
    rows: StepRows, pushes: list[tuple[Array, Array, Array, Array]], x: Array, along: Array, scale: Array,
    here: NDArray[np.int_],
) -> None:  # fmt: skip
    """Add the change of the mean acceleration from move to move; no step makes one worse that is beyond its limit."""
    value, by_c, ahead, behind = (0.5 * (first + second) for first, second in zip(*pushes, strict=True))
    speed = np.sqrt(np.maximum(x, 1e-6))
    time = 2.0 * np.diff(along) / (speed[1:] + speed[:-1])
    between = (0.5 * (time[1:] + time[:-1]))[:, None]
    jerk = scale * np.diff(value, axis=0) / between
    i, j = np.nonzero(np.abs(jerk) > NEAR)
    sign = np.sign(jerk[i, j]) * scale[j] / between[i, 0]
    rows.add(np.maximum(1.0 - np.abs(jerk[i, j]), 0.0), c=sign[:, None] * (by_c[i + 1, j] - by_c[i, j]), x=(
        (here[i + 2], sign * ahead[i + 1, j]), (here[i + 1], sign * (behind[i + 1, j] - ahead[i, j])),
        (here[i], -sign * behind[i, j])))  # fmt: skip


def _add_limits(rows: StepRows, q: Array, columns: Array, lower: Array, upper: Array, size: float) -> None:
    """Add joint limits where a step may come to them."""
    reach = size * np.abs(columns).sum(axis=2)
    for room, side in ((upper - q, 1.0), (q - lower, -1.0)):
        i, j = np.nonzero(room < reach)
        rows.add(np.maximum(room[i, j], 0.0), c=side * columns[i, j])


def _add_rapids(program: JointProgram, rows: StepRows, point: Point, columns: Array) -> None:
    """Add the times of rapid moves: the slowest joint counts."""
    task, ends = program.freedom.task, program.rapids
    if not len(ends):
        return
    move, d_move = point.q[ends] - point.q[ends - 1], columns[ends] - columns[ends - 1]
    nq = move.shape[1]
    alone = np.abs(move)[:, :, None] * np.eye(nq)
    moved = alone + 1e-6 * np.eye(nq)
    limits = task.velocity_limits, task.acceleration_limits
    time = time_rapids(alone.reshape(-1, nq), *limits).reshape(-1, nq)
    rate = np.minimum((time_rapids(moved.reshape(-1, nq), *limits).reshape(-1, nq) - time) / 1e-6, 10.0)
    slowest = time.max(axis=1, keepdims=True)
    i, j = np.nonzero(time > NEAR * slowest)
    rows.add(slowest[i, 0] - time[i, j], c=(np.sign(move) * rate)[i, j][:, None] * d_move[i, j], r=(i, -1.0))


def _add_band(program: JointProgram, rows: StepRows, point: Point, spread: Array) -> None:
    """Add the band at its stations: below B, B below what is allowed."""
    first, prices = program.first, program.prices
    assert first is not None
    if point.slope is None:
        return
    scale = float(first.radius.max())
    by_c = np.einsum("fj,jfc->jc", point.slope, spread[program.looked]) / scale
    widest = float(point.radius.max()) / scale
    value = point.radius / scale
    rows.add(widest - value, c=by_c, b=-1.0)
    if np.isfinite(prices.most_band):
        rows.add(np.array([max(prices.most_band - widest, 0.0)]), b=1.0)


def _price_work(program: JointProgram, point: Point, columns: Array) -> tuple[Array, Array]:
    """Return what the work of the motors costs by coefficients and squares of speed. Shapes (c,), (x,)."""
    first, pull, pushes = program.first, np.zeros(columns.shape[2]), []
    assert first is not None
    found = list(program.work(point.q, point.speeds))
    weight = program.prices.energy / first.energy if found and first.energy > 0.0 else 0.0
    for run, (_, by_move, ahead, behind) in zip(program.runs, found, strict=bool(found)):
        pull += weight * np.einsum("kj,kjc->c", by_move, np.diff(columns[run.first : run.last + 1], axis=0))
        pushes.append(weight * (np.r_[0.0, ahead.sum(axis=1)] + np.r_[behind.sum(axis=1), 0.0]))
    return pull, np.concatenate(pushes) if pushes else np.zeros(sum(len(run.along) for run in program.runs))
