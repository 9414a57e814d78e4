"""Test a model on poses that it was not fitted to: blocks of poses are left out in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.measurement.fit.linear_system import System, weigh
from compplan.robot import Array


@dataclass(frozen=True)
class HeldOutRows:
    """Residuals of rows under models that were fitted without them."""

    residual: Array  #: Measured minus predicted; after taking off the mean of each pose for differences. Shape (n, m).
    score: Array  #: Sum of squared weighted residuals of each pose. Shape (poses,).


def predict_left_out(
    system: System, noise: Array, weights: Array, free: NDArray[np.bool_], *, group: NDArray[np.int_] | None,
    fold: NDArray[np.int_], pose: NDArray[np.int_],
) -> HeldOutRows:  # fmt: skip
    """Refit without each block of rows and predict it.

    Each refit is one Gauss-Newton step from the fit of all rows: the model is linear in its parameters far below noise.
    Row weights are those of the fit of all rows, so that gross outliers count neither in the fit nor in the test.

    Args:
        system: The linearised problem at the fitted state. Shape (n, m, p).
        noise: Noise against the stated one, of each block. Shape (3,).
        weights: Robust weight of each row. Shape (n,).
        free: Which parameters are refitted. Shape (p,).
        group: Groups in which rows are compared with each other only; None for absolute values. Shape (n,).
        fold: Block of each row. Shape (n,).
        pose: Pose of each row, for the score. Shape (n,).
    """
    whitener = system.whitener(noise)
    root = np.sqrt(weights)[:, None]
    residual, columns = weigh(system, whitener * root, group)
    columns = columns[:, :, free]
    left = residual.copy()
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
    score = np.zeros(int(pose.max()) + 1)
    np.add.at(score, pose, (left**2).sum(axis=1))
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
    known = np.isfinite(part).any(axis=1)
    return float(np.sqrt(np.mean(np.nansum(part[known] ** 2, axis=1)))) if known.any() else float("nan")
