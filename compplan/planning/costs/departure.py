"""Cost of the departure of the joints from the chosen posture."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station
from compplan.robot import Array


@dataclass(frozen=True)
class Departure(Cost):
    """sum w (q - q_start)^2."""

    weight: Array  #: Weight of each joint relative to the other costs. Shape (nq,).
    name = "departure"
    formula = "sum w (q - q_start)^2"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the departure."""
        return ca.dot(ca.DM(self.weight), station.departure**2)
