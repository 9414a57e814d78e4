"""The loaded Jacobian: exact derivative of the attained pose by the commanded joint positions.

Joint motion changes the levers of the load and so the deflections. With the load on the elastic coordinates
tau(q, theta) and theta = C tau, the elastic coordinates follow by the implicit function theorem:

    dtheta/dq = (1 - C dtau/dtheta)^-1 C dtau/dq,        J_loaded = J_q + J_theta dtheta/dq.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from compplan.robot import Array
from compplan.statics.chain import Chain, Frames, jacobian
from compplan.statics.elastic import load_derivative, locate_loaded, solve_equilibrium

CHUNK = 2048

#: Largest change of an elastic coordinate in the last equilibrium step. [rad or m]
SETTLED = 1e-12


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
        slope: Whether to compute the derivative; else it is zero.
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
    driven = _driven_columns(chain, columns)
    if not chain.n_springs:
        return driven
    springs = chain.spring_elements
    change = load_derivative(chain, frames, wrench, springs)
    inner = np.eye(len(springs)) - chain.compliance @ change[:, :, springs]
    answer = np.linalg.solve(inner, chain.compliance @ _driven_columns(chain, change))
    return np.asarray(driven + columns[:, :, springs] @ answer)


def chunk_rows(n: int, chain: Chain) -> Iterator[slice]:
    """Divide n poses into parts that fit the cache."""
    size = max(64, int(CHUNK * 12 / (len(chain.names) + 1)))
    for start in range(0, n, size):
        yield slice(start, min(start + size, n))


def _driven_columns(chain: Chain, columns: Array) -> Array:
    """Collect the columns of the commanded joints, mimic joints included. Shape (n, rows, m) -> (n, rows, nq)."""
    result = np.zeros((*columns.shape[:2], chain.nq))
    for k in np.flatnonzero(chain.q_index >= 0):
        result[:, :, chain.q_index[k]] += chain.multiplier[k] * columns[:, :, k]
    return result
