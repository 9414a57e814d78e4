"""Elastostatics: where a chain stands under load, and how it yields.

A wrench is what the environment does to the tool, at the TCP, in base axes, force first. Equilibrium is taken in the loaded
state with finite rotations: theta = C (J(q, theta)^T w + tau_gravity(q, theta)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from compplan.chain import Chain, Frames, gravity_torque, jacobian, locate_frames
from compplan.errors import ConvergenceError, ShapeError
from compplan.robot import Array

MAX_ITERATIONS = 200


class LoadedPose(NamedTuple):
    """Equilibrium of a chain at n poses.

    Attributes:
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        frames: Frames of the loaded chain; `frames.tcp_position` and `frames.tcp_rotation` are the attained pose.
        torque: Load on each elastic coordinate. Shape (n, s). [N m or N]
    """

    theta: Array
    frames: Frames
    torque: Array

    @property
    def position(self) -> Array:
        """Attained TCP, base frame. Shape (n, 3). [m]"""
        return self.frames.tcp_position

    @property
    def rotation(self) -> Array:
        """Attained orientation of the TCP, base frame. Shape (n, 3, 3)."""
        return self.frames.tcp_rotation


def solve_equilibrium(
    chain: Chain, q: Array, wrench: Array | None = None, *, tolerance: float = 1e-13, torque_bias: Array | None = None
) -> LoadedPose:
    """Solve the static equilibrium of the loaded chain.

    Fixed point theta <- C (J^T w + tau_g), which contracts while the load is far below the buckling load.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes; none if left out. Shape (n, 6) or (6,). [N, N m]
        tolerance: Largest change of an elastic coordinate in the last iteration. [rad or m]
        torque_bias: Further load on each elastic coordinate. Shape (n, s). [N m or N]

    Raises:
        ShapeError: If an array does not have the shape above.
        ConvergenceError: If the iteration does not settle, as beyond the buckling load.
    """
    q = np.atleast_2d(np.asarray(q, float))
    load = _wrench_rows(wrench, len(q))
    if not chain.n_springs:
        return LoadedPose(np.zeros((len(q), 0)), locate_frames(chain, q), np.zeros((len(q), 0)))
    theta, elements = np.zeros((len(q), chain.n_springs)), chain.spring_elements
    change = np.inf
    for _ in range(MAX_ITERATIONS):
        frames = locate_frames(chain, q, theta)
        torque = spring_torque(chain, frames, load)[:, elements]
        if torque_bias is not None:
            torque = torque + torque_bias
        if change < tolerance:
            return LoadedPose(theta, frames, torque)
        update = np.einsum("...ij,nj->ni", chain.compliance, torque)
        change = float(np.abs(update - theta).max(initial=0.0))
        theta = update
        if not np.isfinite(change):
            break
    raise ConvergenceError(
        f"equilibrium did not settle, last change {change:.3g} rad; the load is near or beyond buckling", residual=change
    )


def spring_torque(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Compute the load of wrench and weights on every element: J^T w + tau_g. Shape (n, m). [N m or N]"""
    force, moment = wrench[:, None, :3], wrench[:, None, 3:]
    load = moment + np.cross(frames.tcp_position[:, None, :] - frames.origin, force)
    if chain.translates.any():
        load[:, chain.translates] = force
    return np.asarray(np.einsum("nmi,nmi->nm", frames.axis, load)) + gravity_torque(chain, frames)


def cartesian_compliance(chain: Chain, q: Array, theta: Array | None = None) -> Array:
    """Compute the compliance of the TCP, J C J^T, at a pose (loaded if theta is given).

    Valid for a small change of the wrench where the stiffness by the change of the Jacobian is negligible [Salisbury1980];
    `loaded_compliance` holds without that condition.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates. Shape (n, s). [rad or m]

    Returns:
        Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, base axes. Shape (n, 6, 6).
    """
    frames = locate_frames(chain, np.atleast_2d(q), theta)
    columns = jacobian(chain, frames)[:, :, chain.spring_elements]
    return np.asarray(columns @ chain.compliance @ np.swapaxes(columns, 1, 2))


def loaded_compliance(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute the exact compliance of the TCP in the loaded state.

    dx/dw = J (1 - C H)^-1 C J^T with H = d(J^T w + tau_g)/dtheta at the equilibrium: this carries the complementary
    stiffness K_C [Chen2000; Dumas2011].

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Twist of the TCP per wrench, base axes. Shape (n, 6, 6).
    """
    q = np.atleast_2d(np.asarray(q, float))
    loaded = solve_equilibrium(chain, q, wrench)
    columns = jacobian(chain, loaded.frames)[:, :, chain.spring_elements]
    hessian = load_hessian(chain, q, loaded.theta, _wrench_rows(wrench, len(q)))
    inner = np.eye(chain.n_springs) - chain.compliance @ hessian
    return np.asarray(columns @ np.linalg.solve(inner, chain.compliance @ np.swapaxes(columns, 1, 2)))


def load_hessian(chain: Chain, q: Array, theta: Array, wrench: Array) -> Array:
    """Differentiate the load on the elastic coordinates: H = d(J^T w + tau_g)/dtheta, by central differences.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Shape (n, s, s). [N m/rad and kin]
    """
    n, s, step = len(q), chain.n_springs, 1e-5
    hessian = np.empty((n, s, s))
    for j in range(s):
        sides = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[:, j] += sign * step
            sides.append(spring_torque(chain, locate_frames(chain, q, moved), wrench)[:, chain.spring_elements])
        hessian[:, :, j] = (sides[0] - sides[1]) / (2 * step)
    return hessian


def _wrench_rows(wrench: Array | None, n: int) -> Array:
    if wrench is None:
        return np.zeros((n, 6))
    rows = np.asarray(wrench, float)
    if rows.shape not in ((6,), (n, 6)):
        raise ShapeError(f"wrench has shape {rows.shape}, expected ({n}, 6) or (6,)")
    return np.broadcast_to(rows, (n, 6))
