"""Judge a model on poses that it never saw: blocks of poses are left out in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.identify.estimate import Estimate, pose_groups
from compplan.identify.observations import Observations
from compplan.identify.system import System, linearise, weigh
from compplan.robot import Array

FOLDS = 5


@dataclass(frozen=True)
class HeldOutRows:
    """Residuals of rows under models that were fitted without them.

    Attributes:
        residual: Measured minus predicted; after taking off the mean of each pose for differences. Shape (n, m).
        score: Sum of squared weighted residuals of each pose. Shape (poses,).
    """

    residual: Array
    score: Array


def make_folds(observations: Observations, folds: int = FOLDS) -> NDArray[np.int_]:
    """Cut the poses into blocks, in the order of measuring; rows of one pose stay together. Shape (n,)."""
    group = visited_poses(observations)
    first = np.full(int(group.max(initial=-1)) + 1, len(group))
    np.minimum.at(first, group, np.arange(len(group)))
    rank = np.argsort(np.argsort(first))
    return np.asarray(rank[group] * min(folds, len(first)) // len(first))


def visited_poses(observations: Observations) -> NDArray[np.int_]:
    """Group rows of the same commanded pose, whatever mode and target. Shape (n,)."""
    rounded = np.round(observations.q / 1e-4)
    return np.asarray(np.unique(rounded, axis=0, return_inverse=True)[1]).ravel()


def linearise_at(estimate: Estimate, observations: Observations) -> System:
    """Linearise at a fitted state."""
    return linearise(
        estimate.structure, observations, estimate.registration, estimate.prediction, estimate.model_values
    )


def leave_out(
    system: System,
    observations: Observations,
    estimate: Estimate,
    free: NDArray[np.bool_],
    *,
    difference: bool = False,
    folds: int = FOLDS,
) -> HeldOutRows:
    """Refit without each block of poses and predict it.

    Each refit is one Gauss-Newton step from the fit of all rows: the model is linear in its parameters far below noise.
    Row weights are those of the fit of all rows, so that gross outliers neither teach nor count.

    Args:
        system: The linearised problem at the fitted state. Shape (n, m, p).
        observations: The measured rows.
        estimate: The fitted state: weights and noise.
        free: Which parameters are refitted. Shape (p,).
        difference: Whether rows of a pose are compared with each other only.
        folds: Number of blocks.
    """
    whitener = system.whitener(estimate.noise)
    root = np.sqrt(estimate.weights)[:, None]
    group = pose_groups(observations) if difference else None
    residual, columns = weigh(system, whitener * root, group)
    columns = columns[:, :, free]
    fold, left = make_folds(observations, folds), residual.copy()
    p = columns.shape[2]
    if p:
        scale = np.sqrt(np.einsum("nmp,nmp->p", columns, columns))
        scale[scale == 0] = 1.0
        columns = columns / scale
        parts = [columns[fold == k].reshape(-1, p) for k in range(fold.max() + 1)]
        sides = [residual[fold == k].reshape(-1) for k in range(fold.max() + 1)]
        matrices, vectors = [a.T @ a for a in parts], [a.T @ b for a, b in zip(parts, sides, strict=True)]
        total, side = sum(matrices), sum(vectors)
        for k, (matrix, vector) in enumerate(zip(matrices, vectors, strict=True)):
            step = np.linalg.lstsq(total - matrix, side - vector, rcond=1e-12)[0]
            left[fold == k] = residual[fold == k] - columns[fold == k] @ step
    poses = visited_poses(observations)
    score = np.zeros(int(poses.max()) + 1)
    np.add.at(score, poses, (left**2).sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        back = np.where(whitener * root > 0, left / (whitener * root), np.nan)
    return HeldOutRows(back, score)


def gain_score(before: Array, after: Array) -> float:
    """Weigh a gain in held-out scores against its scatter from pose to pose: mean over standard error."""
    gain = before - after
    spread = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
    return float(gain.mean() / max(spread, 1e-300))


def distance_rms(residual: Array, rows: NDArray[np.bool_]) -> float:
    """Take the rms of the 3D distance over some rows. [m]"""
    part = residual[rows, :3]
    known = np.isfinite(part).all(axis=1)
    return float(np.sqrt(np.mean(np.sum(part[known] ** 2, axis=1)))) if known.any() else float("nan")


