"""The widest 95 % band along the path is narrow."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station


@dataclass(frozen=True)
class Band(Cost):
    """w B / B_0, the epigraph variable of `compplan.planning.limits.band`."""

    weight: float  #: w against the other costs.
    stations: int  #: Number of stations, whose sum it is.
    name = "band"

    def __str__(self) -> str:
        return f"{self.weight:g} B / B_0"

    def term(self, station: Station) -> ca.SX:
        """Return the share of one station."""
        return self.weight * station.band / self.stations
