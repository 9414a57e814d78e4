"""The chain's kinematics as CasADi expressions.

The PyPI wheel of Pinocchio has no CasADi interface, so the elements of `compplan.statics.chain` are written out
symbolically (Rodrigues for revolute axes), all elastic coordinates at zero.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from compplan.statics.chain import Chain


def build_pose_function(chain: Chain) -> ca.Function:
    """Build the unloaded forward kinematics: q (nq) -> TCP position (3) [m], orientation (3, 3), base frame."""
    q = ca.SX.sym("q", chain.nq)
    rotation, position = ca.SX.eye(3), ca.SX.zeros(3)
    for k in range(len(chain.names)):
        position = position + _apply(rotation, chain.position[k])
        if not np.array_equal(chain.rotation[k], np.eye(3)):
            rotation = ca.mtimes(rotation, _sparse(chain.rotation[k]))
        if chain.q_index[k] < 0:
            continue
        value = float(chain.multiplier[k]) * q[int(chain.q_index[k])] + float(chain.q_offset[k])
        if chain.translates[k]:
            position = position + _apply(rotation, chain.axis[k]) * value
        else:
            rotation = ca.mtimes(rotation, _rotate(chain.axis[k], value))
    position = position + _apply(rotation, chain.tcp_position)
    outputs = [position, ca.mtimes(rotation, _sparse(chain.tcp_rotation))]
    return ca.Function("pose", [q], outputs, ["q"], ["position", "rotation"])


def _apply(rotation: ca.SX, vector: np.ndarray) -> ca.SX:
    return ca.mtimes(rotation, ca.SX(ca.sparsify(ca.DM(vector)))) if np.any(vector) else ca.SX.zeros(3)


def _sparse(matrix: np.ndarray) -> ca.SX:
    rounded = np.where(np.abs(matrix - np.round(matrix)) < 1e-15, np.round(matrix), matrix)
    return ca.SX(ca.sparsify(ca.DM(rounded)))


def _rotate(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    x, y, z = (float(v) for v in axis)
    skew = ca.sparsify(ca.DM([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return ca.SX.eye(3) + ca.sin(angle) * ca.SX(skew) + (1 - ca.cos(angle)) * ca.SX(ca.sparsify(ca.mtimes(skew, skew)))
