"""Limit of the joint accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Limit, Station
from compplan.robot import Array


@dataclass(frozen=True)
class AccelerationLimit(Limit):
    """|q'' x + q' x' / 2| <= a_max on both sides of a station, x the square of the speed."""

    most: Array  #: Greatest joint accelerations. Shape (nq,). [rad/s^2 or m/s^2]
    name = "acceleration"
    formula = "|q'' x + q' x' / 2| <= a_max"
    of_joints = True

    def rows(self, station: Station) -> ca.SX:
        """Return the accelerations after and before the station as shares of their limits."""
        rates = station.half_rate, station.half_rate_before
        return ca.vertcat(*((station.change * station.square + station.rate * u) / ca.DM(self.most) for u in rates))
