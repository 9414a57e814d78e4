"""Kinematic quality (dexterity) of a posture.

The Jacobian mixes lengths and angles; a characteristic length L makes its rows comparable. The inverse condition number
1/kappa_F = k / sqrt(tr(J J^T) tr((J J^T)^-1)) of the normalised Jacobian is 1 in an isotropic posture and 0 in a
singular one [Dumas2011, eqs. 7 and 8].
"""

from __future__ import annotations

import numpy as np

from compplan.robot import Array
from compplan.statics.chain import Chain, joint_jacobian, locate_frames


def normalise_jacobian(jacobian: Array, length: float) -> Array:
    """Divide the linear rows of Jacobians by a characteristic length. Shape (..., 6, m), L [m]."""
    scale = np.array([1 / length] * 3 + [1.0] * 3)
    return np.asarray(jacobian * scale[:, None])


def inverse_condition(jacobian: Array) -> Array:
    """Compute 1/kappa_F of (normalised) Jacobians, based on the Frobenius norm; 0 where singular.

    Args:
        jacobian: Shape (..., k, m) with m >= k.

    Returns:
        Shape (...).
    """
    values = np.linalg.svd(jacobian, compute_uv=False)
    smallest, rows = values[..., -1], values.shape[-1]
    regular = smallest > 1e-14 * values[..., 0]
    square = np.where(regular[..., None], values, 1.0) ** 2
    kappa = np.sqrt(square.sum(axis=-1) * (1 / square).sum(axis=-1)) / rows
    return np.where(regular, 1 / kappa, 0.0)


def quality_of_poses(chain: Chain, q: Array, length: float) -> Array:
    """Compute the inverse condition number of the length-normalised Jacobian at poses.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        length: Characteristic length. [m]

    Returns:
        Shape (n,).
    """
    q = np.atleast_2d(np.asarray(q, float))
    return inverse_condition(normalise_jacobian(joint_jacobian(chain, locate_frames(chain, q)), length))


def natural_length(chain: Chain, limits: tuple[Array, Array]) -> float:
    """Return the characteristic length that balances linear and angular rows over the joint ranges. [m]"""
    lower, upper = (np.clip(limit, -np.pi, np.pi) for limit in limits)
    q = lower + (upper - lower) * np.random.default_rng(0).random((64, chain.nq))
    columns = joint_jacobian(chain, locate_frames(chain, q))
    return float(np.sqrt((columns[:, :3] ** 2).sum() / max((columns[:, 3:] ** 2).sum(), 1e-12)))


def find_characteristic_length(chain: Chain, q: Array) -> float:
    """Find the length of the most isotropic of some poses [Angeles1992].

    Used for papers only; plans and maps use `natural_length`.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]

    Returns:
        Characteristic length. [m]
    """
    columns = joint_jacobian(chain, locate_frames(chain, np.atleast_2d(q)))
    reach = float(np.abs(columns[:, :3]).max())
    grid = np.geomspace(0.03 * reach, 3 * reach, 60)
    for _ in range(3):
        best = [inverse_condition(normalise_jacobian(columns, length)).max() for length in grid]
        k = int(np.clip(np.argmax(best), 1, len(grid) - 2))
        grid = np.geomspace(grid[k - 1], grid[k + 1], 15)
    return float(grid[len(grid) // 2])
