"""Pose of the loaded tool on the path: an equality, or a tube and a cone where the job allows them."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station
from compplan.robot import Array


@dataclass(frozen=True)
class PoseEquation(Limit):
    """p(q, theta) = p_wanted, z(q, theta) = z_wanted; theta = C (J^T w + tau) in the loaded equilibrium."""

    room: Array | None = None  #: Allowed error of each row of the pose, None for equality. Shape (k, rows). [m, rad]
    name = "pose"
    formula = "p(q, theta) = p_wanted, z(q, theta) = z_wanted, theta = C (J^T w + tau)"

    def rows(self, station: Station) -> ca.SX:
        """Return the pose error, less the slack of a released station."""
        return station.missed - station.slack

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the pose error."""
        return (0.0, 0.0) if self.room is None else (-self.room, self.room)
