"""Joint and link compliance told apart with double encoders: measuring modes U1 U2 L1 L2 [Klimchik2018].

U is unloaded and L loaded; 1 holds the joints by their motor-side and 2 by their link-side encoders. Under mode 2 the
gears add no deflection, so that L2 - U2 shows the links alone and L1 - U1 joints and links together. These are the
equations of the paper, linear and unweighted; `estimate_parameters` with springs "joint_3" and "joint_3.link" fits all
modes at once, weighted, in exact equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, joint_jacobian, locate_frames

MODES = ("U1", "U2", "L1", "L2")
#: Singular values below this share of the largest one belong to what the loads cannot show.
RANK_LIMIT = 1e-9


@dataclass(frozen=True)
class DoubleEncoderCompliances:
    """Compliances about the joint axes; NaN where the loads cannot show them. Shape (nq,) each. [rad/(N m)]

    Attributes:
        joint: Of the gears, from (L1 - U1) - (L2 - U2), eq. 4 (the paper prints the differences with the other sign).
        link: Of the links about the joint axes, from L2 - U2, eq. 5.
        total: Of both, from L1 - U1, eq. 6.
        encoders: Of the gears, from the difference of the encoders, eq. 8; None where no readings are given.
        observable: Which joints the loads can show. Shape (nq,).
    """

    joint: Array
    link: Array
    total: Array
    encoders: Array | None
    observable: NDArray[np.bool_]


def identify_modes(
    robot: Robot, q: Array, wrench: Array, position: Mapping[str, Array], *, deflection: Array | None = None
) -> DoubleEncoderCompliances:
    """Identify joint and link compliances from poses that were measured in all four modes.

    Args:
        robot: The robot; only its geometry counts.
        q: Commanded joint positions, the same in every mode. Shape (n, nq). [rad or m]
        wrench: Wrench in modes L1 and L2 less that in U1 and U2, at the TCP, base axes. Shape (n, 6). [N, N m]
        position: Measured TCP by mode U1 U2 L1 L2. Shape (n, 3) each. [m]
        deflection: Link-side reading in L1 less that in U1. Shape (n, nq). [rad or m]

    Raises:
        InputError: If a mode is missing.
    """
    for mode in MODES:
        if mode not in position:
            raise InputError(f"no positions in mode {mode}, expected all of {list(MODES)}")
    chain = build_chain(robot, gravity=False)
    columns = joint_jacobian(chain, locate_frames(chain, np.atleast_2d(q)))
    torque = np.einsum("nij,ni->nj", columns, wrench)
    observation = columns[:, :3] * torque[:, None, :]
    flat = observation.reshape(-1, robot.nq)
    size = np.linalg.norm(flat, axis=0)
    observable = size > RANK_LIMIT * size.max()
    link_side, motor_side = position["L2"] - position["U2"], position["L1"] - position["U1"]
    encoders = None
    if deflection is not None:
        power = (torque**2).sum(axis=0)
        shown = power > RANK_LIMIT**2 * power.max()
        encoders = np.full(robot.nq, np.nan)
        encoders[shown] = (torque * deflection).sum(axis=0)[shown] / power[shown]
    return DoubleEncoderCompliances(
        joint=_solve(flat, motor_side - link_side, observable),
        link=_solve(flat, link_side, observable),
        total=_solve(flat, motor_side, observable),
        encoders=encoders,
        observable=observable,
    )


def _solve(flat: Array, deflection: Array, observable: NDArray[np.bool_]) -> Array:
    result = np.full(flat.shape[1], np.nan)
    result[observable] = np.linalg.lstsq(flat[:, observable], deflection.ravel(), rcond=None)[0]
    return result
