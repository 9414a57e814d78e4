"""Strategies cut their parts in the cells of points; measured is how far the tool was from the path.

All strategies meet the same cells, so that their differences are paired.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from compplan.plan.correction_loop import Loop, run_loop
from compplan.plan.strategies.answer import Answer, answer_reading
from compplan.robot import Array
from compplan.studies.factors import PARTS
from compplan.studies.kernel import settle_tips
from compplan.studies.sampling import Cells, sample_robots, shift_tip
from compplan.studies.study import Study, TimeGrid, Worker
from compplan.studies.touch import move_part

#: Poses worked on at once, samples times waypoints.
BATCH = 8192


class ChunkResult(NamedTuple):
    """Figures of b samples and m strategies.

    Attributes:
        rms: Shape (b, m). [m]
        mean: Shape (b, m). [m]
        max: Shape (b, m). [m]
        within: Share of waypoints within tolerance. Shape (b, m).
        along: Distance at the stations. Shape (b, m, k). [m]

    """

    rms: Array
    mean: Array
    max: Array
    within: Array
    along: NDArray[np.float32]


#: Number and figures of each chunk of a study, as it is done.
Chunks = Generator[tuple[int, ChunkResult], None, None]


def evaluate_points(study: Study, points: Array) -> ChunkResult:
    """Let every strategy cut its part in the cell of every point.

    Args:
        study: The study.
        points: Points of the unit cube. Shape (b, size).

    Raises:
        ConvergenceError: If a cell buckles under its load.

    """
    size = max(1, BATCH // len(study.task))
    batches = [_judge_batch(study, points[start : start + size]) for start in range(0, len(points), size)]
    return ChunkResult(*(np.concatenate(parts) for parts in zip(*batches, strict=True)))


def _judge_batch(study: Study, points: Array) -> ChunkResult:
    cells = sample_robots(study.surroundings, points)
    distances = np.stack([np.linalg.norm(run_strategy(study, name, cells), axis=0) for name in study.strategies], 1)
    cut = distances[:, :, study.cut]
    return ChunkResult(
        rms=np.sqrt((cut**2).mean(axis=2)),
        mean=cut.mean(axis=2),
        max=cut.max(axis=2),
        within=(cut <= study.task.tolerance).mean(axis=2),
        along=distances[:, :, study.stations].astype(np.float32),
    )


def run_strategy(study: Study, name: str, cells: Cells) -> Array:
    """Let a strategy cut its parts in b cells; return the deviation of the judged one. Shape (3, b, n). [m]"""
    answer, worker = study.answers[name], study.workers[name]
    if answer.sensor == "tracker":
        return _learn(study, answer, worker, cells)
    last = PARTS - 1
    q = np.broadcast_to(worker.q, (len(worker.q), *cells.shift.shape[1:]))
    if worker.gain is not None and worker.expected is not None:
        q = worker.q + answer_reading(worker.gain, _read_sensor(study, answer, cells) - worker.expected)
    if answer.loop is not None and study.grid is not None:
        q = worker.q_rest + _delay(answer.loop, study.grid, q - worker.q_rest)
    return _cut_part(study, worker, cells, q, last)


def _read_sensor(study: Study, answer: Answer, cells: Cells) -> Array:
    """Read the force sensor, or the difference of the encoders, on the judged part. Shape (k, b, n)."""
    wrench, last = cells.wrench[-1], PARTS - 1
    if answer.sensor == "force":
        return wrench + cells.force
    compliance, columns, load = study.gear
    torque = load[:, None, :] + answer_reading(columns, wrench - study.surroundings.wrench[:, None, :])
    between = np.abs(study.selection)
    factor = np.einsum("js,sb->jb", between, cells.factor) / np.maximum(between.sum(axis=1), 1.0)[:, None]
    yielded = compliance[:, None, None] * factor[:, :, None] * torque + cells.drive
    return np.where(compliance[:, None, None] > 0.0, yielded + cells.link[last] - cells.motor[last], 0.0)


def _cut_part(study: Study, worker: Worker, cells: Cells, q: Array, part: int) -> Array:
    """Cut a part with a command; return its deviation. Shape (3, b, n). [m]"""
    gain = worker.spring_gain[:, None, None]
    true = q + cells.zero[:, :, None] + gain * cells.drive - gain * cells.motor[part] - (1 - gain) * cells.link[part]
    b, n = true.shape[1:]
    factor = np.repeat(cells.factor * worker.spring_factor[:, None], n, axis=1)
    theta = np.tile(worker.theta, (1, b)) * np.repeat(cells.factor, n, axis=1)
    shift = cells.shift if worker.placements is None else shift_tip(cells.causes, worker.placements)
    found = study.nominal[:, None, :]
    if worker.touch is not None:
        found = found + move_part(worker.touch, study.kernel, cells, worker.spring_factor, study.nominal)
    moved = shift + cells.repeat[part][:, :, None] + worker.offset[:, None, :] - found

    def attain(wrench: Array) -> Array:
        flat = wrench.reshape(6, -1)
        tips = settle_tips(study.kernel, true.reshape(len(true), -1), flat, factor, theta)
        return np.asarray(tips.reshape(3, b, n) + moved)

    return attain(cells.wrench[part])


def _learn(study: Study, answer: Answer, worker: Worker, cells: Cells) -> Array:
    """Cut, measure and correct, part after part; the last one is judged."""
    assert worker.gain is not None
    q = np.broadcast_to(worker.q, (len(worker.q), *cells.shift.shape[1:]))
    for part in range(answer.parts):
        measured = _cut_part(study, worker, cells, q, part) + cells.tracker[part]
        q = q + answer_reading(worker.gain, _soften(study, measured))
    return _cut_part(study, worker, cells, q, PARTS - 1)


def _soften(study: Study, measured: Array) -> Array:
    """Take the mean over neighbouring waypoints of the cut."""
    if study.softened <= 1:
        return measured
    cut = study.cut.astype(float)
    total = uniform_filter1d(measured * cut, study.softened, axis=-1, mode="constant")
    return np.asarray(total / np.maximum(uniform_filter1d(cut, study.softened, mode="constant"), 1e-9) * cut)


def _delay(loop: Loop, grid: TimeGrid, wanted: Array) -> Array:
    """Pass wanted corrections through a loop in time. Shape (nq, b, n)."""
    return _interpolate(run_loop(loop, _interpolate(wanted, grid.at_period)), grid.at_waypoint)


def _interpolate(values: Array, at: Array) -> Array:
    before = np.minimum(at.astype(int), values.shape[-1] - 2)
    share = at - before
    return np.asarray(values[..., before] * (1.0 - share) + values[..., before + 1] * share)
