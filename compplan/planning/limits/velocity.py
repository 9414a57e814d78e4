"""Limit of the joint velocities."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station
from compplan.robot import Array


@dataclass(frozen=True)
class VelocityLimit(Limit):
    """q'^2 x <= v_max^2 between a station and the next, x the square of the speed."""

    most: Array  #: Greatest joint velocities. Shape (nq,). [rad/s or m/s]
    name = "velocity"
    formula = "q'^2 x <= v_max^2"
    of_joints = True

    def rows(self, station: Station) -> ca.SX:
        """Return the squared velocities as shares of their squared limits."""
        rate = (station.q_next - station.q) * station.inverse_step / ca.DM(self.most)
        return rate**2 * 0.5 * (station.square + station.square_next)

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the rows."""
        return -np.inf, 1.0
