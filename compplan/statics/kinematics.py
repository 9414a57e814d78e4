"""The chain's kinematics and loaded equilibrium as CasADi expressions.

The PyPI wheel of Pinocchio has no CasADi interface, so the elements of `compplan.statics.chain` are written out
symbolically (Rodrigues for revolute axes). Deflections are eliminated inside the expression by as many equilibrium
steps as robot and load need.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from compplan.errors import ConvergenceError
from compplan.robot import Array
from compplan.statics.chain import Chain, locate_frames
from compplan.statics.elastic import spring_torque

MAX_STEPS = 60
#: Poses that the number of equilibrium steps is counted on.
SAMPLES = 200


def build_pose_function(chain: Chain) -> ca.Function:
    """Build the unloaded forward kinematics: q (nq) -> TCP position (3) [m], orientation (3, 3), base frame."""
    q = ca.SX.sym("q", chain.nq)
    position, rotation, _ = _locate(chain, q, None)
    return ca.Function("pose", [q], [position, rotation], ["q"], ["position", "rotation"])


def build_loaded_pose_function(chain: Chain, steps: int) -> ca.Function:
    """Build the loaded forward kinematics with the deflections eliminated.

    theta_0 = 0, theta_{i+1} = C (J(q, theta_i)^T w + tau_g(q, theta_i)). Every step shrinks the remainder by the share
    of the buckling load that acts; `count_equilibrium_steps` counts the steps that a robot and its load need.

    Args:
        chain: The chain.
        steps: Number of equilibrium steps.

    Returns:
        Function (q (nq) [rad or m], wrench (6) [N, N m], base axes, at the TCP) -> (position (3) [m], rotation (3, 3),
        theta (s) [rad or m]), base frame.

    """
    q, wrench = ca.SX.sym("q", chain.nq), ca.SX.sym("wrench", 6)
    theta = ca.SX.sym("theta", chain.n_springs)
    position, rotation, _ = _locate(chain, q, theta)
    arrive = ca.Function("arrive", [q, theta], [position, rotation])
    elastic = ca.MX.zeros(chain.n_springs)
    joints, load = ca.MX.sym("q", chain.nq), ca.MX.sym("wrench", 6)
    if chain.n_springs:
        torque = _spring_torque(chain, q, theta, wrench)
        step = ca.Function("step", [q, theta, wrench], [ca.mtimes(ca.DM(chain.compliance), torque)])
        for _ in range(steps):
            elastic = step(joints, elastic, load)
    outputs = [*arrive(joints, elastic), elastic]
    return ca.Function("loaded_pose", [joints, load], outputs, ["q", "wrench"], ["position", "rotation", "theta"])


def count_equilibrium_steps(chain: Chain, q: Array, wrench: Array, *, tolerance: float = 1e-12) -> int:
    """Count the equilibrium steps after which the elastic coordinates of a robot under a load stand still.

    Args:
        chain: The chain.
        q: Joint positions that occur; at most SAMPLES of them, spread evenly, are looked at. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        tolerance: Greatest change of an elastic coordinate in the last step. [rad or m]

    Raises:
        ConvergenceError: If they do not stand still after MAX_STEPS steps, as near the buckling load.

    """
    if not chain.n_springs:
        return 0
    rows = np.unique(np.linspace(0, len(q) - 1, min(len(q), SAMPLES)).astype(int))
    q, wrench = q[rows], wrench[rows]
    theta = np.zeros((len(q), chain.n_springs))
    change = np.inf
    for steps in range(1, MAX_STEPS + 1):
        torque = spring_torque(chain, locate_frames(chain, q, theta), wrench)[:, chain.spring_elements]
        update = torque @ chain.compliance.T
        change = float(np.abs(update - theta).max())
        theta = update
        if change < tolerance:
            return steps
    message = f"equilibrium needs more than {MAX_STEPS} steps, last change {change:.3g} rad"
    raise ConvergenceError(message, residual=change)


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
        value = None
        if chain.q_index[k] >= 0:
            value = float(chain.multiplier[k]) * q[int(chain.q_index[k])] + float(chain.q_offset[k])
        elif theta is not None:
            value = theta[int(chain.theta_index[k])]
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
