"""Cost of joint motion: avoids reversals without benefit."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station
from compplan.robot import Array

#: Step below which |dq| is smoothed. With smaller values the curvature makes Newton steps oscillate. [unit]
SMALL = 1e-2


@dataclass(frozen=True)
class JointTravel(Cost):
    """w sum |q_i+1 - q_i| / unit, smoothed at zero; a motion back and forth counts twice."""

    weight: float  #: w relative to the other costs.
    unit: Array  #: Reference motion of each joint. Shape (nq,). [rad or m]
    name = "travel"
    formula = "{weight:g} sum |dq|"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted joint motion to the next station."""
        step = (station.q_next - station.q) / ca.DM(self.unit)
        return self.weight * ca.sum1(ca.sqrt(step**2 + SMALL**2) - SMALL)
