"""Strategies cut their parts in the cells of points; measured is how far the tool was from the path.

All strategies meet the same cells, so that their differences are paired.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.planning.strategies.online import answer_reading
from compplan.robot import Array
from compplan.statics.encoders import feedback_scale
from compplan.studies.kernel import settle_tips
from compplan.studies.sampling import Cells, sample_robots, shift_tip
from compplan.studies.study import Study, Worker
from compplan.studies.touch import move_part

#: Poses worked on at once, samples times waypoints.
BATCH = 8192


class ChunkResult(NamedTuple):
    """Figures of b samples and m strategies."""

    rms: Array  #: Shape (b, m). [m]
    mean: Array  #: Shape (b, m). [m]
    max: Array  #: Shape (b, m). [m]
    within: Array  #: Share of waypoints within tolerance. Shape (b, m).
    along: NDArray[np.float32]  #: Distance at the stations. Shape (b, m, k). [m]


#: Number and figures of each chunk of a study, as it is done.
Chunks = Generator[tuple[int, ChunkResult], None, None]


def evaluate_points(study: Study, points: Array) -> ChunkResult:
    """Let every strategy cut its part in the cell of every point of the unit cube. points: shape (b, size).

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
    """Let a strategy cut its part with b robots; return the deviation. Shape (3, b, n). [m]"""
    worker = study.workers[name]
    q = np.broadcast_to(worker.q, (len(worker.q), *cells.shift.shape[1:]))
    if worker.gain is not None and worker.expected is not None:
        q = worker.q + answer_reading(worker.gain, cells.wrench + cells.force - worker.expected)
    return _cut_part(study, worker, cells, q)


def _cut_part(study: Study, worker: Worker, cells: Cells, q: Array) -> Array:
    """Cut a part with a command; return its deviation. Shape (3, b, n). [m]"""
    gain = worker.spring_gain[:, None, None]
    true = q + cells.zero[:, :, None] + gain * cells.drive - gain * cells.motor - (1 - gain) * cells.link
    b, n = true.shape[1:]
    scale = feedback_scale(worker.spring_factor[:, None], cells.link_share)
    factor = np.repeat(cells.factor * scale, n, axis=1)
    theta = np.tile(worker.theta, (1, b)) * np.repeat(cells.factor, n, axis=1)
    shift = cells.shift if worker.placements is None else shift_tip(cells.causes, worker.placements)
    found = study.nominal[:, None, :]
    if worker.touch is not None:
        found = found + move_part(worker.touch, study.kernel, cells, scale, study.nominal)
    moved = shift + cells.repeat[:, :, None] + worker.offset[:, None, :] - found

    def attain(wrench: Array) -> Array:
        flat = wrench.reshape(6, -1)
        tips = settle_tips(study.kernel, true.reshape(len(true), -1), flat, factor, theta)
        return np.asarray(tips.reshape(3, b, n) + moved)

    return attain(cells.wrench)
