"""Identifiability, confidence intervals under correlated residuals, and prediction of rows left out of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.measurement.fit.least_squares import System, count_dof, information, invert, loss_weights, stack, weigh
from compplan.robot import Array

#: Standard normal score above which residuals of neighbouring poses count as correlated (one in 30,000 by chance).
AGREEMENT_SCORE = 4.0
SEED = 20240501
#: Greatest standard error of an identifiable direction, in typical sizes of the parameters.
LIMIT = 10.0
#: Squared singular value of the column-scaled system below which a direction is singular at any noise.
SINGULAR = 1e-12
#: Least component of an unidentifiable direction, relative to the greatest, of a parameter that may be fixed.
SHARE = 0.2


def state_spread(
    system: System, q: Array, noise: Array, loss: str, group: NDArray[np.int_] | None, free: NDArray[np.bool_],
    sigma: str,
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Compute covariance, degrees of freedom of each parameter, and whether the residuals of poses are correlated.

    Arguments: see `iterate_gauss_newton`, at the fitted state; q: joint positions, (n, nq); noise: ratio to the stated
    noise of each block, (4,).

    Raises:
        InputError: If there are not more measured numbers than parameters.
    """
    whitener, index = system.whitener(noise), np.flatnonzero(free)
    count = system.count_measured
    spare = count_dof(system, whitener, group, free)
    if spare.sum() <= 0:
        numbers = f"{count.sum()} measured numbers"
        raise InputError(f"{numbers} leave no freedom for {len(index)} parameters; add poses")
    distance = system.distance(noise)
    weights, slopes = loss_weights(loss, distance, count)
    factor = 1.0
    if loss != "least_squares":
        spread = np.sum((weights * distance) ** 2) / count.sum()
        steep = np.sum(count * weights + slopes * distance) / count.sum()
        factor = spread / steep**2 * count.sum() / spare.sum()
    bread = factor * invert(information(system, whitener, group)[np.ix_(index, index)])
    clustered = False
    if sigma == "residuals":
        residual, columns = weigh(system, whitener * system.temper(weights), group)
        clustered = neighbours_agree(q, residual)
        wide = cluster_covariance(q, residual, columns[:, :, free]) if clustered else None
        if wide is not None:
            scale = np.sqrt(np.maximum(np.diag(wide) / np.diag(bread), 1.0))
            bread = bread * np.outer(scale, scale)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(index, index)] = bread
    freedom = np.full(len(free), np.inf)
    if sigma == "residuals":
        freedom[index] = _freedom(system, whitener, group, free, spare)
    return covariance, freedom, clustered


def _freedom(
    system: System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_], spare: Array
) -> Array:
    """Combine the degrees of freedom of the blocks by their shares in the variance of each parameter. Shape (k,)."""
    columns = weigh(system, whitener, group)[1][:, :, free]
    inverse = invert(stack(columns).T @ stack(columns))
    parts = []
    for block in range(3):
        flat = stack(columns[:, system.block == block])
        parts.append(np.einsum("ij,jk,ki->i", inverse, flat.T @ flat, inverse))
    share = np.array(parts)
    return np.asarray(share.sum(axis=0) ** 2 / (share**2 / np.maximum(spare, 1.0)[:, None]).sum(axis=0))


def neighbours_agree(q: Array, residual: Array) -> bool:
    """Test whether residuals of neighbouring poses are positively correlated.

    The score is sum_i r_i . r_nn(i) / sqrt(sum_i (r_i . r_nn(i))^2) over nearest neighbours in joint space. q: joint
    positions, (n, nq); residual: weighted, (n, m).
    """
    if len(q) < 20:
        return False
    _, index = cKDTree(q).query(q, k=2)
    neighbour = np.where(index[:, 0] == np.arange(len(q)), index[:, 1], index[:, 0])
    product = np.einsum("ij,ij->i", residual, residual[neighbour])
    # A mutual pair counts once.
    once = (neighbour[neighbour] != np.arange(len(q))) | (np.arange(len(q)) < neighbour)
    product = product[once]
    return bool(product.sum() > AGREEMENT_SCORE * np.sqrt((product**2).sum() + 1e-300))


def cluster_covariance(q: Array, residual: Array, columns: Array) -> Array | None:
    """Compute the cluster-robust covariance by groups of neighbouring poses [LiangZeger1986]. Shape (p, p).

    None if there are too few poses to form groups. Residuals (n, m) and derivatives (n, m, p) are weighted.
    """
    count = min(len(np.unique(np.round(q, 4), axis=0)) // 3, 60)
    if count <= 10:
        return None
    label = cluster_poses(q, count)
    score = np.zeros((count, columns.shape[2]))
    np.add.at(score, label, np.einsum("nmp,nm->np", columns, residual))
    bread = np.linalg.pinv(np.einsum("nmp,nmr->pr", columns, columns), hermitian=True)
    return np.asarray(count / (count - 1) * bread @ (score.T @ score) @ bread)


def cluster_poses(q: Array, count: int) -> np.ndarray:
    """Group poses that are near in joint space, deterministically. Shape (n,)."""
    spread = np.where(q.std(axis=0) > 1e-9, q.std(axis=0), 1.0)
    return np.asarray(kmeans2(q / spread, count, minit="++", seed=SEED, missing="warn")[1])


@dataclass(frozen=True)
class HeldOutRows:
    """Residuals of rows under models fitted without these rows."""

    residual: Array  #: Measured minus predicted; for differences, minus the mean of each pose. Shape (n, m).
    score: Array  #: Sum of squared weighted residuals of each pose. Shape (poses,).


def predict_left_out(
    system: System, noise: Array, weights: Array, free: NDArray[np.bool_], *, group: NDArray[np.int_] | None,
    fold: NDArray[np.int_], pose: NDArray[np.int_],
) -> HeldOutRows:  # fmt: skip
    """Refit without each fold of rows and predict it.

    Each refit is one Gauss-Newton step from the fit of all rows: nonlinearity at such steps is far below the noise.
    Row weights, (n,), are those of the fit of all rows, so that gross outliers count neither in the fit nor in the
    test. fold: fold of each row, (n,); pose: of each row, for the score, (n,); others: see `state_spread`.
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
    """Return the mean reduction of left-out scores over its standard error from pose to pose."""
    gain = before - after
    spread = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
    return float(gain.mean() / max(spread, 1e-300))


def distance_rms(residual: Array, rows: NDArray[np.bool_]) -> float:
    """Return the rms of the 3D distance over selected rows. [m]"""
    part = residual[rows, :3]
    known = np.isfinite(part).any(axis=1)
    return float(np.sqrt(np.mean(np.nansum(part[known] ** 2, axis=1)))) if known.any() else float("nan")


def find_free(information: Array, sizes: Array, rank: Sequence[int]) -> NDArray[np.bool_]:
    """Find a maximal set of identifiable parameters; the others have to be fixed. Shape (p,).

    information: A^T W A, (p, p); sizes: typical sizes of the parameters, (p,); rank: of parameters with similar effects
    the one of lowest rank is fixed, (p,).
    """
    scaled = information * np.outer(sizes, sizes)
    strength = np.sqrt(np.diag(scaled))
    free: NDArray[np.bool_] = strength * LIMIT > 1
    while free.any():
        index = np.flatnonzero(free)
        block = scaled[np.ix_(index, index)]
        norm = strength[index]
        value, vector = np.linalg.eigh(block / np.outer(norm, norm))
        direction = vector[:, 0]
        if value[0] > SINGULAR:
            value, vector = np.linalg.eigh(block)
            if value[0] * LIMIT**2 > 1:
                break
            direction = vector[:, 0]
        weight = np.abs(direction)
        suspects = np.flatnonzero(weight > SHARE * weight.max())
        free[index[min(suspects, key=lambda k: (rank[int(index[k])], -weight[k]))]] = False
    return free


def find_similar(information: Array, sizes: Array, free: NDArray[np.bool_]) -> list[tuple[int, list[int]]]:
    """Return every fixed parameter, and at most six free ones with similar effects, the most similar first.

    Arguments: see `find_free`; free: mask of the free parameters, (p,).
    """
    scaled = information * np.outer(sizes, sizes)
    strength, index = np.sqrt(np.diag(scaled)), np.flatnonzero(free)
    found = []
    for k in (int(held) for held in np.flatnonzero(~free)):
        mates: list[int] = []
        if strength[k] * LIMIT > 1 and len(index):
            share = np.linalg.lstsq(scaled[np.ix_(index, index)], scaled[index, k], rcond=None)[0]
            part = np.abs(share) * strength[index]
            mates = [int(index[j]) for j in np.argsort(-part) if part[j] > SHARE * max(strength[k], part.max())][:6]
        found.append((k, mates))
    return found


def condition_number(information: Array, free: NDArray[np.bool_]) -> float:
    """Compute the condition number of the column-scaled system of the free parameters."""
    index = np.flatnonzero(free)
    if not len(index):
        return float("nan")
    block = information[np.ix_(index, index)]
    norm = np.sqrt(np.diag(block))
    value = np.linalg.eigvalsh(block / np.outer(norm, norm))
    return float(np.sqrt(value[-1] / max(value[0], 1e-300)))
