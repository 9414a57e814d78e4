"""Costs of the program, one file each: a term of the objective and one sentence.

A new cost is one file with a class derived from `Cost`, and one entry in `COSTS`.
"""

from __future__ import annotations

from compplan.planning.costs.band import Band
from compplan.planning.costs.departure import Departure
from compplan.planning.costs.missed import MissedPose
from compplan.planning.costs.smoothness import Smoothness
from compplan.planning.costs.time import Time
from compplan.planning.costs.travel import JointTravel

#: Every cost by its name.
COSTS = {cost.name: cost for cost in (Band, Departure, MissedPose, Smoothness, Time, JointTravel)}
