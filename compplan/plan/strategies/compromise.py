"""The best that single waypoints can do within the limits: as near to the path as joints and correction limit allow.

Waypoint by waypoint, for many at once:

    minimise    |pose equations|^2 + m |q - q_ref|^2    subject to  q_min <= q <= q_max,  |correction| <= c

by Levenberg-Marquardt steps on the exact loaded pose, projected onto the joint limits; the correction limit is a steep
penalty, and kept to the letter in the end: the tool leans rather than leave it. A waypoint whose pose equations vanish
here can be reached within the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.plan.strategies.equations import differentiate_equations, pose_equations
from compplan.plan.task import PlanTask, attain_rows
from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames

STEPS = 80
#: A waypoint is done where its step is smaller [rad or m], where a step lowers its cost by a smaller share (what can be
#: reached falls to nothing in steps of many decades), or where no step helps however damped.
STILL, SLIGHT, STUCK = 1e-10, 1e-6, 1e4
#: What an error of orientation costs against one of position. [m/rad]
LEVER = 0.2
#: Weight of a correction beyond its limit, against that of a missed position: raised stage by stage.
STEEP = (1e2, 1e4, 1e6)
#: Weight of a joint that strays from where it came from. [m^2/rad^2]
STRAY = 1e-12
#: The correction limit is kept this far inside. [m]
INSIDE = 2e-7


@dataclass(frozen=True)
class _Point:
    """Joint positions of some waypoints with residual, its derivative and the cost."""

    q: Array
    residual: Array
    columns: Array
    cost: Array


def find_compromise(task: PlanTask, q: Array, rows: NDArray[np.int_]) -> Array:
    """Bring some waypoints as near to the path as the limits allow.

    Args:
        task: The task.
        q: Joint positions to start from; brought within the joint limits first. Shape (n, nq). [rad or m]
        rows: The waypoints. Shape (k,).

    Returns:
        Joint positions within the limits. Shape (k, nq). [rad or m]
    """
    reference = np.clip(q[rows], task.robot.lower, task.robot.upper)
    path, here = np.array(q), reference
    for steep in STEEP if np.isfinite(task.max_correction) else STEEP[:1]:
        here = _descend(task, path, here, reference, rows, steep)
    return _keep_correction(task, here, rows)


def _keep_correction(task: PlanTask, q: Array, rows: NDArray[np.int_]) -> Array:
    """Bring corrections that are still beyond their limit within it, by the shortest motion of free joints."""
    low, high, most = task.robot.lower, task.robot.upper, task.max_correction - INSIDE
    stays = task.problem.stays & ~task.missed[rows, None]
    for _ in range(STEPS):
        frames = locate_frames(task.chain, q)
        gap = frames.tcp_position - task.position[rows]
        length = np.linalg.norm(gap, axis=1)
        beyond = task.compensated[rows] & (length > most + 0.5 * INSIDE)
        if not beyond.any():
            break
        along = gap / np.maximum(length, 1e-12)[:, None]
        slope = np.einsum("ki,kij->kj", along, joint_jacobian(task.chain, frames)[:, :3])
        slope *= ~(((q <= low) & (slope > 0)) | ((q >= high) & (slope < 0)) | stays)
        step = slope * ((length - most) / np.maximum((slope**2).sum(axis=1), 1e-12))[:, None]
        q = np.where(beyond[:, None], np.clip(q - np.clip(step, -0.1, 0.1), low, high), q)
    return q


def _descend(task: PlanTask, path: Array, q: Array, reference: Array, rows: NDArray[np.int_], steep: float) -> Array:
    """Take damped steps down to the compromise at one weight of the correction limit."""
    low, high = task.robot.lower, task.robot.upper
    here = _visit(task, path, q, reference, rows, steep)
    damping, busy = np.full(len(rows), 1e-6), np.arange(len(rows))
    stays = task.problem.stays & ~task.missed[rows, None]  # where the arm alone does not reach, the rail helps
    for _ in range(STEPS):
        now = _Point(*(value[busy] for value in _parts(here)))
        gradient = np.einsum("kij,ki->kj", now.columns, now.residual)
        held = ((now.q <= low) & (gradient > 0)) | ((now.q >= high) & (gradient < 0)) | stays[busy]
        columns = now.columns * ~held[:, None, :]
        normal = np.swapaxes(columns, 1, 2) @ columns + damping[busy, None, None] * np.eye(q.shape[1])
        step = np.linalg.solve(normal, (gradient * ~held)[..., None])[..., 0]
        step *= np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        there = _visit(task, path, np.clip(now.q - step, low, high), reference[busy], rows[busy], steep)
        better = there.cost < now.cost
        for value, new in zip(_parts(here), _parts(there), strict=True):
            value[busy[better]] = new[better]
        path[rows[busy]] = here.q[busy]
        damping[busy] = np.where(better, np.maximum(damping[busy] * 0.1, 1e-14), np.minimum(damping[busy] * 10.0, 1e6))
        slight = better & (now.cost - there.cost < SLIGHT * now.cost)
        busy = busy[(np.abs(step).max(axis=1) > STILL) & ~slight & (damping[busy] < STUCK)]
        if not len(busy):
            break
    return here.q


def _visit(task: PlanTask, path: Array, q: Array, reference: Array, rows: NDArray[np.int_], steep: float) -> _Point:
    """Evaluate residual and derivative at joint positions of some waypoints, the others stay where `path` has them."""
    path[rows] = q
    attained = attain_rows(task, path, rows)
    problem = task.problem
    weight = np.r_[np.ones(3), np.full(problem.equations - 3, LEVER)]
    residual = [pose_equations(problem, attained, rows) * weight]
    columns = [differentiate_equations(problem, attained, rows) * weight[:, None]]
    frames = locate_frames(task.chain, q)
    gap = frames.tcp_position - task.position[rows]
    length = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
    most = task.max_correction - INSIDE if np.isfinite(task.max_correction) else np.inf
    beyond = task.compensated[rows] & (length > most)
    # the vector to the nearest place within the limit, and how it changes: along the gap wholly, across it in part
    share = np.where(beyond, 1.0 - np.minimum(most / length, 1.0), 0.0)[:, None]
    along = gap / length[:, None]
    residual += [steep**0.5 * share * gap, STRAY**0.5 * (q - reference)]
    tip = joint_jacobian(task.chain, frames)[:, :3]
    lengthwise = along[:, :, None] * np.einsum("ki,kij->kj", along, tip)[:, None, :]
    slope = share[..., None] * tip + np.where(beyond[:, None], 1.0 - share, 0.0)[..., None] * lengthwise
    columns += [
        steep**0.5 * slope,
        np.broadcast_to(STRAY**0.5 * np.eye(q.shape[1]), (len(q), *[q.shape[1]] * 2)),
    ]
    together = np.hstack(residual)
    return _Point(q, together, np.concatenate(columns, axis=1), np.einsum("ki,ki->k", together, together))


def _parts(point: _Point) -> tuple[Array, Array, Array, Array]:
    return point.q, point.residual, point.columns, point.cost

