"""Limits of the program, one file each: rows of the program, a check of a result, and one sentence.

A new limit is one file with a class derived from `Limit`, and one entry in `LIMITS`.
"""

from __future__ import annotations

from compplan.planning.limits.acceleration import AccelerationLimit
from compplan.planning.limits.clearance import ClearanceLimit
from compplan.planning.limits.correction import CorrectionLimit
from compplan.planning.limits.joint_range import JointRange
from compplan.planning.limits.pose import PoseEquation
from compplan.planning.limits.torque import TorqueLimit
from compplan.planning.limits.velocity import VelocityLimit

#: Every limit by its name.
LIMITS = {
    limit.name: limit
    for limit in (PoseEquation, JointRange, CorrectionLimit, VelocityLimit, AccelerationLimit, ClearanceLimit,
                  TorqueLimit)
}  # fmt: skip
