"""Cartesian stiffness of a loaded arm, with and without the complementary matrix K_C.

A wrench also changes the levers on which it acts. The conservative congruence transformation [Chen2000] includes this
as the complementary stiffness K_C = d(J^T w)/dtheta:

    K_X = J^-T (K_theta - K_C) J^-1,   or, for any number of springs,   K_X^-1 = J (1 - C K_C)^-1 C J^T.

Without K_C the formula K_X^-1 = J C J^T [Salisbury1980] holds for the unloaded arm. The indices nu_p and nu_r
[Dumas2011] measure the difference.

The loaded Jacobian is the exact derivative of the attained pose by the commanded joints. Joint motion changes the
levers of the load tau(q, theta) and so the deflections theta = C tau; by the implicit function theorem

    dtheta/dq = (1 - C dtau/dtheta)^-1 C dtau/dq,        J_loaded = J_q + J_theta dtheta/dq.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from compplan.robot import Array
from compplan.statics.chain import Chain, Frames, chunks, drive_columns, jacobian, locate_frames
from compplan.statics.elastic import load_derivative, load_hessian, locate_loaded, solve_equilibrium

CHUNK = 2048
#: Largest change of an elastic coordinate in the last equilibrium step. [rad or m]
SETTLED = 1e-12


class ComplementaryInfluence(NamedTuple):
    """Change of the displacement under a wrench without K_C [Dumas2011, eqs. 10 and 11]."""

    nu_p: Array  #: |dp_with - dp_without| / max(|dp_with|, |dp_without|), translations. Shape (n,).
    nu_r: Array  #: Largest difference of a rotation component. Shape (n,). [rad]


def complementary_stiffness(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute the complementary stiffness in the elastic coordinates, K_C = d(J^T w)/dtheta.

    Weights are left out, as in [Chen2000]; `compplan.statics.elastic.load_hessian` includes them.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Shape (n, s, s). [N m/rad, N/m or mixed]
    """
    q = np.atleast_2d(np.asarray(q, float))
    weightless = replace(chain, gravity=np.zeros(3))
    return load_hessian(weightless, q, np.zeros((len(q), chain.n_springs)), np.broadcast_to(wrench, (len(q), 6)))


def displace_linearly(chain: Chain, q: Array, wrench: Array, *, complementary: bool = True) -> Array:
    """Compute the displacement of the TCP under a wrench by the stiffness of the unloaded posture.

    dx = K_X^-1 w at the unloaded posture; `compplan.statics.elastic.solve_equilibrium` is exact.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
        complementary: Whether to include K_C.

    Returns:
        Displacement of the TCP, base axes. Shape (n, 6). [m, rad]
    """
    q = np.atleast_2d(np.asarray(q, float))
    load = np.broadcast_to(np.asarray(wrench, float), (len(q), 6))
    columns = jacobian(chain, locate_frames(chain, q))[:, :, chain.spring_elements]
    deflection = np.einsum("...ij,nkj,nk->ni", chain.compliance, columns, load)
    if complementary:
        inner = np.eye(chain.n_springs) - chain.compliance @ complementary_stiffness(chain, q, load)
        deflection = np.linalg.solve(inner, deflection[..., None])[..., 0]
    return np.asarray(np.einsum("nij,nj->ni", columns, deflection))


def complementary_influence(chain: Chain, q: Array, wrench: Array) -> ComplementaryInfluence:
    """Compute the indices nu_p and nu_r.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
    """
    with_it = displace_linearly(chain, q, wrench)
    without = displace_linearly(chain, q, wrench, complementary=False)
    gap = with_it - without
    size = np.maximum(np.linalg.norm(with_it[:, :3], axis=1), np.linalg.norm(without[:, :3], axis=1))
    nu_p = np.linalg.norm(gap[:, :3], axis=1) / np.where(size > 0, size, 1.0)
    return ComplementaryInfluence(nu_p, np.abs(gap[:, 3:]).max(axis=1))


def worst_unit_force(compliance: Array) -> tuple[Array, Array]:
    """Find the force direction of the largest displacement, by singular values of the translational compliance.

    Args:
        compliance: Compliance of the TCP. Shape (n, 6, 6).

    Returns:
        Displacement per force in that direction, shape (n,) [m/N], and the direction of the force, shape (n, 3).
    """
    _, values, directions = np.linalg.svd(compliance[..., :3, :3])
    return values[..., 0], directions[..., 0, :]


class AttainedPose(NamedTuple):
    """Loaded pose of the tool and its derivative by the commanded joints; n poses."""

    position: Array  #: Attained TCP, base frame. Shape (n, 3). [m]
    rotation: Array  #: Attained orientation of the TCP, base frame. Shape (n, 3, 3).
    #: Twist of the attained TCP per commanded joint motion, linear rows first, base axes. Shape (n, 6, nq).
    jacobian: Array
    theta: Array | None = None  #: Elastic coordinates, or None. Shape (n, s). [rad or m]


def attain_pose(
    chain: Chain,
    q: Array,
    wrench: Array | None,
    *,
    slope: bool = True,
    torque_bias: Array | None = None,
    theta: Array | None = None,
) -> AttainedPose:
    """Solve the loaded equilibrium at every pose and differentiate it with respect to the commanded joints.

    Args:
        chain: The chain.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes; none if left out. Shape (n, 6). [N, N m]
        slope: Whether to compute the derivative; otherwise it is zero.
        torque_bias: Further load on each elastic coordinate, such as that of inertia. Shape (n, s). [N m or N]
        theta: Initial elastic coordinates, zero if left out. Shape (n, s). [rad or m]

    Raises:
        ConvergenceError: If a load is near or beyond buckling.

    """
    n = len(q)
    load = np.zeros((n, 6)) if wrench is None else wrench
    columns = np.zeros((n, 6, chain.nq))
    if not slope:
        *pose, given = locate_loaded(chain, q, load, tolerance=SETTLED, torque_bias=torque_bias, theta=theta)
        return AttainedPose(pose[0], pose[1], columns, given)
    position, rotation, given = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, chain.n_springs))
    for rows in chunk_rows(n, chain):
        bias, start = (None if each is None else each[rows] for each in (torque_bias, theta))
        loaded = solve_equilibrium(chain, q[rows], load[rows], tolerance=SETTLED, torque_bias=bias, theta=start)
        position[rows], rotation[rows], given[rows] = loaded.position, loaded.rotation, loaded.theta
        columns[rows] = loaded_jacobian(chain, loaded.frames, load[rows])
    return AttainedPose(position, rotation, columns, given)


def loaded_jacobian(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Compute the twist of the attained TCP per commanded joint motion at a loaded equilibrium.

    Args:
        chain: The chain.
        frames: Its frames in the loaded equilibrium at n poses.
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Linear rows first, base axes. Shape (n, 6, nq).

    """
    columns = jacobian(chain, frames)
    driven = drive_columns(chain, columns)
    if not chain.n_springs:
        return driven
    springs = chain.spring_elements
    change = load_derivative(chain, frames, wrench, springs)
    inner = np.eye(len(springs)) - chain.compliance @ change[:, :, springs]
    answer = np.linalg.solve(inner, chain.compliance @ drive_columns(chain, change))
    return np.asarray(driven + columns[:, :, springs] @ answer)


def chunk_rows(n: int, chain: Chain) -> Iterator[slice]:
    """Divide n poses into parts whose derivatives fit the cache."""
    return chunks(n, max(64, int(CHUNK * 12 / (len(chain.names) + 1))))
