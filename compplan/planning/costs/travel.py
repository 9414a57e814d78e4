"""Cost of joint travel: it keeps joints from turning back without gain."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station
from compplan.robot import Array

#: Steps below this are none. Smaller ones bend the root so much that Newton steps go to and fro. [unit]
SMALL = 1e-2


@dataclass(frozen=True)
class JointTravel(Cost):
    """w sum |q_i+1 - q_i| / unit, rounded at nothing; a way back pays twice."""

    weight: float  #: w against the other costs.
    unit: Array  #: Motion that each joint is counted in. Shape (nq,). [rad or m]
    name = "travel"

    def __str__(self) -> str:
        return f"{self.weight:g} sum |dq|"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted way to the next station."""
        step = (station.q_next - station.q) / ca.DM(self.unit)
        return self.weight * ca.sum1(ca.sqrt(step**2 + SMALL**2) - SMALL)
