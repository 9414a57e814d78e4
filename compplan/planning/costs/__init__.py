"""Costs of the program, one file each: a term of the objective and one sentence.

A new cost is one file with a class that has what `Cost` has, and one line in `COSTS`.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca

from compplan.planning.costs.band import Band
from compplan.planning.costs.departure import Departure
from compplan.planning.costs.missed import MissedPose
from compplan.planning.costs.smoothness import Smoothness
from compplan.planning.costs.time import Time
from compplan.planning.costs.travel import Travel
from compplan.planning.problem import Station


class Cost(Protocol):
    """What the class of a cost offers; `str` says it in one term of mathematics."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def timed(self) -> bool:
        """Whether it speaks of the speed along the path."""
        ...

    def term(self, station: Station) -> ca.SX:
        """Return what one station costs."""
        ...


#: Every cost by its name.
COSTS: dict[str, type] = {
    "band": Band,
    "departure": Departure,
    "missed_pose": MissedPose,
    "smoothness": Smoothness,
    "time": Time,
    "travel": Travel,
}

__all__ = ["COSTS", "Band", "Cost", "Departure", "MissedPose", "Smoothness", "Time", "Travel"]
