"""The chain's kinematics and loaded equilibrium as CasADi expressions, for the planner.

The PyPI wheel of Pinocchio has no CasADi interface, so the elements of `compplan.chain` are written out symbolically
(Rodrigues for revolute axes). Deflections are eliminated inside the expression by a fixed number of equilibrium steps.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from compplan.chain import Chain

EQUILIBRIUM_STEPS = 3


def build_pose_function(chain: Chain) -> ca.Function:
    """Build the unloaded forward kinematics: q (nq) -> TCP position (3) [m], orientation (3, 3), base frame."""
    q = ca.SX.sym("q", chain.nq)
    position, rotation, _ = _locate(chain, q, None)
    return ca.Function("pose", [q], [position, rotation], ["q"], ["position", "rotation"])


def build_loaded_pose_function(chain: Chain, steps: int = EQUILIBRIUM_STEPS) -> ca.Function:
    """Build the loaded forward kinematics with the deflections eliminated.

    theta_0 = 0, theta_{i+1} = C (J(q, theta_i)^T w + tau_g(q, theta_i)); three steps reach 1e-12 rad for the stiffness of
    real robots under process loads.

    Args:
        chain: The chain.
        steps: Number of equilibrium steps.

    Returns:
        Function (q (nq) [rad or m], wrench (6) [N, N m], base axes, at the TCP) -> (position (3) [m], rotation (3, 3),
        theta (s) [rad or m]), base frame.
    """
    q, wrench = ca.SX.sym("q", chain.nq), ca.SX.sym("wrench", 6)
    theta = ca.SX.zeros(chain.n_springs)
    for _ in range(steps if chain.n_springs else 0):
        torque = _spring_torque(chain, q, theta, wrench)
        theta = ca.mtimes(ca.DM(chain.compliance), torque)
    position, rotation, _ = _locate(chain, q, theta)
    return ca.Function(
        "loaded_pose", [q, wrench], [position, rotation, theta], ["q", "wrench"], ["position", "rotation", "theta"]
    )


def _locate(chain: Chain, q: ca.SX, theta: ca.SX | None) -> tuple[ca.SX, ca.SX, dict[str, list[ca.SX]]]:
    """Walk the chain; return TCP position, TCP rotation, and per element axis and origin, per body its centre."""
    rotation, position = ca.SX.eye(3), ca.SX.zeros(3)
    parts: dict[str, list[ca.SX]] = {"axis": [], "origin": [], "centre": [ca.SX.zeros(3)] * len(chain.body_element)}
    _place_bodies(chain, -1, rotation, position, parts["centre"])
    for k in range(len(chain.names)):
        position = position + _apply(rotation, chain.position[k])
        if not np.array_equal(chain.rotation[k], np.eye(3)):
            rotation = ca.mtimes(rotation, _sparse(chain.rotation[k]))
        axis = _apply(rotation, chain.axis[k])
        parts["axis"].append(axis)
        parts["origin"].append(position)
        value = None if theta is None else theta[int(chain.theta_index[k])]
        if chain.q_index[k] >= 0:
            value = float(chain.multiplier[k]) * q[int(chain.q_index[k])] + float(chain.q_offset[k])
        if value is not None:
            if chain.translates[k]:
                position = position + axis * value
            else:
                rotation = ca.mtimes(rotation, _rotate(chain.axis[k], value))
        _place_bodies(chain, k, rotation, position, parts["centre"])
    position = position + _apply(rotation, chain.tcp_position)
    return position, ca.mtimes(rotation, _sparse(chain.tcp_rotation)), parts


def _spring_torque(chain: Chain, q: ca.SX, theta: ca.SX, wrench: ca.SX) -> ca.SX:
    position, _, parts = _locate(chain, q, theta)
    torques = []
    for k in chain.spring_elements:
        axis, origin = parts["axis"][k], parts["origin"][k]
        force, moment = wrench[:3], wrench[3:] + ca.cross(position - origin, wrench[:3])
        if chain.gravity.any():
            for b in np.flatnonzero(chain.body_element >= k):
                weight = ca.DM(chain.mass[b] * chain.gravity)
                force = force + weight
                moment = moment + ca.cross(parts["centre"][b] - origin, weight)
        torques.append(ca.dot(axis, force if chain.translates[k] else moment))
    return ca.vertcat(*torques)


def _place_bodies(chain: Chain, element: int, rotation: ca.SX, position: ca.SX, centres: list[ca.SX]) -> None:
    for b in np.flatnonzero(chain.body_element == element):
        centres[b] = position + _apply(rotation, chain.centre[b])


def _apply(rotation: ca.SX, vector: np.ndarray) -> ca.SX:
    return ca.mtimes(rotation, ca.SX(ca.sparsify(ca.DM(vector)))) if np.any(vector) else ca.SX.zeros(3)


def _sparse(matrix: np.ndarray) -> ca.SX:
    rounded = np.where(np.abs(matrix - np.round(matrix)) < 1e-15, np.round(matrix), matrix)
    return ca.SX(ca.sparsify(ca.DM(rounded)))


def _rotate(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    x, y, z = (float(v) for v in axis)
    skew = ca.sparsify(ca.DM([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return ca.SX.eye(3) + ca.sin(angle) * ca.SX(skew) + (1 - ca.cos(angle)) * ca.SX(ca.sparsify(ca.mtimes(skew, skew)))
