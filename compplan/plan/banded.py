"""The program of a path where none of its limits is active, solved by a banded factorisation; IPOPT is the reference.

A step of Gauss-Newton takes the pose equations at their linearisation, e + J dq = 0, and the objective as it stands.
What the equations leave free at a waypoint are the columns of N, J N = 0, and dq = -J^+ e + N z. With S the matrix of
smoothness, h the hold, w the worth of the joints, and b = q - q_start where its shape is kept, q otherwise,

    minimise  sum w (|S b|^2 + h (q - q_start)^2)     over z,

which couples a waypoint with the next two alone: f free directions make a band of 3 f - 1 beside the diagonal.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from compplan.plan.path_problem import PathProblem, smoothness_matrix
from compplan.robot import Array


def step_banded(problem: PathProblem, q: Array, missed: Array, columns: Array) -> Array | None:
    """Return the joint positions after a step, limits not looked at; None where the factorisation fails.

    Args:
        problem: What the path has to fulfil.
        q: Joint positions before it. Shape (n, nq). [rad or m]
        missed: Missed pose equations there. Shape (n, m). [m, rad]
        columns: Their derivative with respect to the commanded joints. Shape (n, m, nq).

    """
    moving = np.flatnonzero(~problem.stays)
    columns, worth = columns[:, :, moving], problem.worth[moving]
    m, free = columns.shape[1], len(moving) - columns.shape[1]
    orthogonal, triangle = np.linalg.qr(np.swapaxes(columns, 1, 2), mode="complete")
    onto = np.linalg.solve(np.swapaxes(triangle[:, :m], 1, 2), -missed[..., None])
    start = problem.q_start[:, moving]
    at = q[:, moving] + (orthogonal[:, :, :m] @ onto)[..., 0]
    basis = orthogonal[:, :, m:]
    bend = smoothness_matrix(problem)
    smooth = (bend.T @ bend).tocsr()
    pull = worth * (smooth @ (at - start if problem.keeps_shape else at) + problem.anchor[:, None] * (at - start))
    slope = np.einsum("njf,nj->nf", basis, pull)
    band = np.zeros((3 * free, len(q), free))
    for away in range(3):  # the block of waypoints k and k + away: element (i, j) stands on diagonal away f + j - i
        part = np.zeros(len(q))
        part[: len(q) - away] = smooth.diagonal(away) + (problem.anchor if away == 0 else 0.0)
        blocks = part[:, None, None] * np.einsum("nji,j,njk->nik", basis, worth, np.roll(basis, -away, axis=0))
        for i in range(free):
            for j in range(free):
                if (below := away * free + j - i) >= 0:
                    band[below, :, i] = blocks[:, i, j]
    try:
        z = solveh_banded(band.reshape(3 * free, -1), -slope.ravel(), lower=True)
    except LinAlgError:
        return None
    found = q.copy()
    found[:, moving] = at + np.einsum("njf,nf->nj", basis, z.reshape(len(q), free))
    return found if np.isfinite(found).all() else None
