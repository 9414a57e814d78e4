"""Limits of the program, one file each: rows of the program, a check of a result, and one sentence.

A new limit is one file with a class derived from `Limit`, and one line in `LIMITS`.
"""

from __future__ import annotations

from compplan.planning.limits.acceleration import AccelerationLimit
from compplan.planning.limits.band import BandLimit, read_band, spread_tip
from compplan.planning.limits.clearance import ClearanceLimit, linearise_clearance
from compplan.planning.limits.correction import CorrectionLimit
from compplan.planning.limits.joint_range import JointRange
from compplan.planning.limits.pose import PoseEquation
from compplan.planning.limits.torque import TorqueLimit, read_torques
from compplan.planning.limits.velocity import VelocityLimit
from compplan.planning.problem import Limit

#: Every limit by its name.
LIMITS: dict[str, type] = {
    "pose": PoseEquation,
    "joint_range": JointRange,
    "correction": CorrectionLimit,
    "velocity": VelocityLimit,
    "acceleration": AccelerationLimit,
    "band": BandLimit,
    "clearance": ClearanceLimit,
    "torque": TorqueLimit,
}

__all__ = [
    "LIMITS",
    "AccelerationLimit",
    "BandLimit",
    "ClearanceLimit",
    "CorrectionLimit",
    "JointRange",
    "Limit",
    "PoseEquation",
    "TorqueLimit",
    "VelocityLimit",
    "linearise_clearance",
    "read_band",
    "read_torques",
    "spread_tip",
]
