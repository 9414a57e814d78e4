"""Whether residuals are noise, and honest intervals where they are not."""

from __future__ import annotations

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from compplan.robot import Array

#: Standard normal score from which residuals of neighbouring poses count as dependent (one in 30,000 by chance).
AGREEMENT_SCORE = 4.0
SEED = 20240501


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
