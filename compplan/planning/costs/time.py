"""Cost of the time of the run."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station

#: Added to squared speeds, so that the square root is differentiable at rest.
AT_REST = 1e-9


@dataclass(frozen=True)
class Time(Cost):
    """w T / T_0, T = sum 2 ds / (sqrt(x_i) + sqrt(x_i+1))."""

    weight: float  #: w relative to the other costs.
    reference: float  #: T_0. [s]
    name = "time"
    formula = "{weight:g} T / T_0"
    timed = True

    def term(self, station: Station) -> ca.SX:
        """Return the share of the time to the next station."""
        root = ca.sqrt(station.square + AT_REST) + ca.sqrt(station.square_next + AT_REST)
        return self.weight * 2.0 * station.step / root / self.reference
