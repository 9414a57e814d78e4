"""Cost of the joint accelerations along the path."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station
from compplan.robot import Array


@dataclass(frozen=True)
class Smoothness(Cost):
    """w sum (q'' / a_max)^2 ds, q'' the second derivative with respect to the programmed time."""

    weight: float  #: w relative to the other costs, per total programmed time. [1/s]
    unit: Array  #: Reference acceleration of each joint. Shape (nq,). [rad/s^2 or m/s^2]
    name = "smoothness"
    formula = "{weight:g} sum (q'' / a_max)^2 ds"
    timed = True

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the second derivative."""
        return self.weight * station.step * ca.sumsqr(station.change / ca.DM(self.unit))
