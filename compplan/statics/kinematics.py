"""Kinematics and loaded equilibrium of the chain as CasADi expressions.

The PyPI wheel of Pinocchio has no CasADi interface, so the elements of `compplan.statics.chain` are evaluated
symbolically.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from compplan.statics.chain import Chain


class SymbolicFrames(NamedTuple):
    """Frames of a chain as expressions."""

    axis: list[ca.SX]  #: Axis of each element, base axes. m expressions (3).
    origin: list[ca.SX]  #: Origin of each element. m expressions (3). [m]
    position: ca.SX  #: TCP. Shape (3). [m]
    rotation: ca.SX  #: Orientation of the TCP. Shape (3, 3).
    centre: list[ca.SX]  #: Centre of each body. b expressions (3). [m]
    ground: ca.SX  #: Orientation of the frame of gravity. Shape (3, 3).


def build_loaded_function(chain: Chain, steps: int) -> ca.Function:
    """Build the loaded forward kinematics by steps of theta <- C (J(q, theta)^T w + tau_gravity + bias).

    Args:
        chain: The chain.
        steps: Fixed-point steps; each reduces the error by the ratio of load to buckling load.

    Returns:
        q (nq), wrench (6) [N, N m], bias (s) [N m or N], initial theta (s), 1 for a loaded and 0 for an unloaded
        arm -> TCP position (3) [m], orientation (3, 3), elastic coordinates (s), base frame.

    """
    q, wrench, loaded = ca.SX.sym("q", chain.nq), ca.SX.sym("wrench", 6), ca.SX.sym("loaded")
    bias, first = ca.SX.sym("bias", chain.n_springs), ca.SX.sym("theta", chain.n_springs)
    compliance, theta = ca.SX(ca.sparsify(ca.DM(chain.compliance))), first
    for _ in range(steps if chain.n_springs else 0):
        theta = ca.mtimes(compliance, load_springs(chain, locate_symbolic(chain, q, theta), wrench) + bias)
    frames = locate_symbolic(chain, q, loaded * theta)
    outputs = ca.cse([frames.position, frames.rotation, loaded * theta])
    return ca.Function("loaded_pose", [q, wrench, bias, first, loaded], outputs,
                       ["q", "wrench", "bias", "theta", "loaded"], ["position", "rotation", "deflection"])  # fmt: skip


def locate_symbolic(chain: Chain, q: ca.SX, theta: ca.SX | None = None) -> SymbolicFrames:
    """Build the frames of a chain at joint positions q and elastic coordinates theta, zero if left out."""
    rotation, position, ground = ca.SX.eye(3), ca.SX.zeros(3), ca.SX.eye(3)
    axis, origin, centre = [], [], [ca.SX.zeros(3)] * len(chain.body_element)
    for k in range(-1, len(chain.names)):
        if k >= 0:
            position = position + _apply(rotation, chain.position[k])
            if not np.array_equal(chain.rotation[k], np.eye(3)):
                rotation = ca.mtimes(rotation, _sparse(chain.rotation[k]))
            axis.append(_apply(rotation, chain.axis[k]))
            origin.append(position)
            value = None
            if chain.theta_index[k] >= 0 and theta is not None:
                value = theta[int(chain.theta_index[k])]
            elif chain.q_index[k] >= 0:
                value = float(chain.multiplier[k]) * q[int(chain.q_index[k])] + float(chain.q_offset[k])
            if value is not None and chain.translates[k]:
                position = position + axis[k] * value
            elif value is not None:
                rotation = ca.mtimes(rotation, _rotate(chain.axis[k], value))
        for body in np.flatnonzero(chain.body_element == k):
            centre[body] = position + _apply(rotation, chain.centre[body])
        if k >= 0 and k == chain.ground:
            ground = ca.mtimes(rotation, _sparse(chain.ground_rotation))
    position = position + _apply(rotation, chain.tcp_position)
    return SymbolicFrames(axis, origin, position, ca.mtimes(rotation, _sparse(chain.tcp_rotation)), centre, ground)


def load_springs(chain: Chain, frames: SymbolicFrames, wrench: ca.SX) -> ca.SX:
    """Build the load of wrench and weights on each elastic coordinate: J^T w + tau_g. Shape (s). [N m or N]"""
    loads = []
    down = ca.mtimes(frames.ground, ca.SX(ca.sparsify(ca.DM(chain.gravity))))
    for k in chain.spring_elements.tolist():
        force, moment = wrench[:3], wrench[3:] + ca.cross(frames.position - frames.origin[k], wrench[:3])
        for body in np.flatnonzero(chain.body_element >= k) if chain.gravity.any() else ():
            weight = float(chain.mass[body]) * down
            force, moment = force + weight, moment + ca.cross(frames.centre[body] - frames.origin[k], weight)
        loads.append(ca.dot(frames.axis[k], force if chain.translates[k] else moment))
    return ca.vertcat(*loads) if loads else ca.SX.zeros(0)


def _apply(rotation: ca.SX, vector: np.ndarray) -> ca.SX:
    return ca.mtimes(rotation, ca.SX(ca.sparsify(ca.DM(vector)))) if np.any(vector) else ca.SX.zeros(3)


def _sparse(matrix: np.ndarray) -> ca.SX:
    rounded = np.where(np.abs(matrix - np.round(matrix)) < 1e-15, np.round(matrix), matrix)
    return ca.SX(ca.sparsify(ca.DM(rounded)))


def _rotate(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    x, y, z = (float(v) for v in axis)
    skew = ca.sparsify(ca.DM([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return ca.SX.eye(3) + ca.sin(angle) * ca.SX(skew) + (1 - ca.cos(angle)) * ca.SX(ca.sparsify(ca.mtimes(skew, skew)))
