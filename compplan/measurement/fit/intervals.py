"""Whether residuals are noise, and honest intervals where they are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.measurement.fit.linear_system import System, count_spare, information, invert, stack, weigh
from compplan.measurement.fit.robust import loss_weights
from compplan.robot import Array

#: Standard normal score from which residuals of neighbouring poses count as dependent (one in 30,000 by chance).
AGREEMENT_SCORE = 4.0
SEED = 20240501


def state_spread(
    system: System, q: Array, noise: Array, loss: str, group: NDArray[np.int_] | None, free: NDArray[np.bool_],
    sigma: str,
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Compute covariance, degrees of freedom of each parameter, and whether groups of poses gave the covariance.

    Args:
        system: The linearised problem at the fitted state.
        q: Joint positions. Shape (n, nq). [rad or m]
        noise: Noise against the stated one, of each block. Shape (3,).
        loss: "least_squares", "huber" or "tukey".
        group: Number of the pose of each row, for differences; None for absolute poses. Shape (n,).
        free: Which parameters are estimated. Shape (p,).
        sigma: "residuals" or "stated".

    Raises:
        InputError: If the parameters use up all measured numbers.
    """
    whitener, index = system.whitener(noise), np.flatnonzero(free)
    count = system.seen
    spare = count_spare(system, whitener, group, free)
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
    """Weigh the freedom of the blocks by what each adds to the variance of a parameter. Shape (k,)."""
    columns = weigh(system, whitener, group)[1][:, :, free]
    inverse = invert(stack(columns).T @ stack(columns))
    parts = []
    for block in range(3):
        flat = stack(columns[:, system.block == block])
        parts.append(np.einsum("ij,jk,ki->i", inverse, flat.T @ flat, inverse))
    share = np.array(parts)
    return np.asarray(share.sum(axis=0) ** 2 / (share**2 / np.maximum(spare, 1.0)[:, None]).sum(axis=0))


def neighbours_agree(q: Array, residual: Array) -> bool:
    """Tell whether residuals of neighbouring poses agree more than noise does.

    The score is sum_i r_i . r_nn(i) / sqrt(sum_i (r_i . r_nn(i))^2) over nearest neighbours in joint space.

    Args:
        q: Joint positions. Shape (n, nq). [rad or m]
        residual: Weighted residuals. Shape (n, m).
    """
    if len(q) < 20:
        return False
    _, index = cKDTree(q).query(q, k=2)
    neighbour = np.where(index[:, 0] == np.arange(len(q)), index[:, 1], index[:, 0])
    product = np.einsum("ij,ij->i", residual, residual[neighbour])
    # A mutual pair is one product, not two.
    once = (neighbour[neighbour] != np.arange(len(q))) | (np.arange(len(q)) < neighbour)
    product = product[once]
    return bool(product.sum() > AGREEMENT_SCORE * np.sqrt((product**2).sum() + 1e-300))


def cluster_covariance(q: Array, residual: Array, columns: Array) -> Array | None:
    """Compute the covariance from groups of neighbouring poses that share their errors [LiangZeger1986].

    Args:
        q: Joint positions. Shape (n, nq). [rad or m]
        residual: Weighted residuals. Shape (n, m).
        columns: Weighted derivatives. Shape (n, m, p).

    Returns:
        Shape (p, p), or None where there are too few poses to form groups.
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
    """Group poses that are near in joint space; the same poses give the same groups. Shape (n,)."""
    spread = np.where(q.std(axis=0) > 1e-9, q.std(axis=0), 1.0)
    return np.asarray(kmeans2(q / spread, count, minit="++", seed=SEED, missing="warn")[1])
