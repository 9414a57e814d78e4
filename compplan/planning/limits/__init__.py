"""Constraints of the nonlinear program, one file each: rows, their bounds, and one sentence.

A new limit is one file with a class derived from `Limit`, one import here, and its place in the lists of
`compplan.planning.dense.state_problem` (correction) or `compplan.planning.redundancy.state_problem` (posture).
"""

from compplan.planning.limits.acceleration import AccelerationLimit
from compplan.planning.limits.correction import CorrectionLimit
from compplan.planning.limits.joint_range import JointRange
from compplan.planning.limits.pose import PoseEquation
from compplan.planning.limits.velocity import VelocityLimit

__all__ = ["AccelerationLimit", "CorrectionLimit", "JointRange", "PoseEquation", "VelocityLimit"]
