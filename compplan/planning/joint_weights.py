"""What smoothness of each joint is worth: by what its motion does to the tip, since a metre is no radian."""

from __future__ import annotations

import numpy as np

from compplan.planning.posture.motion import MotionFigures
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames

#: Postures that are looked at.
LOOKED_AT = 100
#: Least and greatest weight against the mean one: no joint is free, none is stiff.
LEAST, MOST = 0.1, 10.0


def weigh_joints(chain: Chain, q: Array, robot: Robot) -> Array:
    """Weigh joints by the error that their motion makes at the tip.

    A joint of lever r turns with a gear error of amplitude a and n periods a turn, and with lost motion b. Over a
    period of the gear the tip is off by r a / sqrt(2) and r b / 2, so that a radian costs

        w = r^2 [ (a n)^2 / 2 + (b n / (4 pi))^2 ]

    with the lost motion of the folder where it states one, else the assumed one; in shares of the mean.

    Args:
        chain: The elastic chain.
        q: Joint positions along the path. Shape (n, nq). [rad or m]
        robot: The robot, for the lost motion that its folder states.

    Returns:
        Weights about 1. Shape (nq,).

    """
    some = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), LOOKED_AT)).astype(int))]
    columns = joint_jacobian(chain, locate_frames(chain, some))[:, :3]
    lever = np.einsum("nij,nij->j", columns, columns) / len(some)
    gear, periods, lost, *_ = MotionFigures()
    width = np.full(robot.nq, lost)
    for entry in robot.effects:
        if entry.get("effect") == "backlash" and entry.get("joint") in robot.joint_names:
            values = entry["parameters"]
            stated = abs(float(values.get("width_rad", values.get("width_m", 0.0))))
            width[robot.joint_names.index(entry["joint"])] = stated
    cost = lever * (0.5 * (gear * periods) ** 2 + (width * periods / (4.0 * np.pi)) ** 2)
    return np.clip(cost / max(float(cost.mean()), 1e-300), LEAST, MOST)
