"""Costs of the nonlinear program, one file each: a term of the objective and one sentence.

A new cost is one file with a class derived from `Cost`, one import here, and its place in the lists of
`compplan.planning.dense.state_problem` (correction) or `compplan.planning.redundancy.state_problem` (posture).
"""

from compplan.planning.costs.band import Band
from compplan.planning.costs.departure import Departure
from compplan.planning.costs.missed import MissedPose
from compplan.planning.costs.smoothness import Smoothness
from compplan.planning.costs.time import Time
from compplan.planning.costs.travel import JointTravel

__all__ = ["Band", "Departure", "JointTravel", "MissedPose", "Smoothness", "Time"]
