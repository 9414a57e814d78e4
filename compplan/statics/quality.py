"""Kinematic quality (dexterity) of a posture.

The Jacobian mixes lengths and angles; a characteristic length L makes its rows comparable. The inverse condition number
1/kappa_F = k / sqrt(tr(J J^T) tr((J J^T)^-1)) of the normalised Jacobian is 1 in an isotropic posture and 0 in a
singular one [Dumas2011, eqs. 7 and 8].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.statics.chain import Chain, joint_jacobian, locate_frames


@dataclass(frozen=True)
class Zone:
    """A box in joint space."""

    name: str  #: Name of the zone.
    joints: tuple[int, ...]  #: Joints that it bounds, counted from 0.
    lower: tuple[float, ...]  #: Lower bounds, one per joint. [rad or m]
    upper: tuple[float, ...]  #: Upper bounds, one per joint. [rad or m]

    def contains(self, q: Array) -> NDArray[np.bool_]:
        """Return which joint positions lie in the zone. Shape (..., nq) -> (...)."""
        chosen = q[..., list(self.joints)]
        return np.asarray(((chosen >= np.array(self.lower)) & (chosen <= np.array(self.upper))).all(axis=-1))


@dataclass(frozen=True)
class DexterityMap:
    """Inverse condition number over two joints, all others fixed."""

    first: Array  #: Positions of the first joint. Shape (a,). [rad or m]
    second: Array  #: Positions of the second joint. Shape (b,). [rad or m]
    joints: tuple[int, int]  #: The two joints, counted from 0.
    q: Array  #: Joint positions. Shape (b, a, nq). [rad or m]
    inverse_condition: Array  #: 1/kappa_F. Shape (b, a).
    position: Array  #: TCP in the base frame. Shape (b, a, 3). [m]
    length: float  #: Characteristic length. [m]


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


def map_dexterity(
    chain: Chain, q: Array, joints: tuple[int, int], first: Array, second: Array, length: float
) -> DexterityMap:
    """Compute the inverse condition number over two joints.

    Args:
        chain: The chain.
        q: Positions of all joints; the two mapped ones are ignored. Shape (nq,). [rad or m]
        joints: The two joints, counted from 0.
        first: Positions of the first one. Shape (a,). [rad or m]
        second: Positions of the second one. Shape (b,). [rad or m]
        length: Characteristic length. [m]
    """
    grid = np.broadcast_to(np.asarray(q, float), (len(second), len(first), chain.nq)).copy()
    grid[..., joints[0]], grid[..., joints[1]] = np.meshgrid(first, second)
    rows = grid.reshape(-1, chain.nq)
    frames = locate_frames(chain, rows)
    value = inverse_condition(normalise_jacobian(joint_jacobian(chain, frames), length))
    shape = grid.shape[:2]
    position = np.ascontiguousarray(frames.tcp_position).reshape(*shape, 3)
    return DexterityMap(first, second, joints, grid, value.reshape(shape), position, length)


def mean_inside(quality: DexterityMap, zones: Sequence[Zone]) -> tuple[dict[str, float], float]:
    """Average the inverse condition number inside each zone, and outside all of them."""
    inside = {zone.name: zone.contains(quality.q) for zone in zones}
    outside = ~np.logical_or.reduce(list(inside.values()))
    means = {name: float(quality.inverse_condition[mask].mean()) for name, mask in inside.items() if mask.any()}
    return means, float(quality.inverse_condition[outside].mean())
