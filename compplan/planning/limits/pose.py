"""The loaded tool is on the path: an equality, or a tube and a cone where the job allows them."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station
from compplan.robot import Array


@dataclass(frozen=True)
class PoseEquation(Limit):
    """p(q, theta) = p_wanted, z(q, theta) along the tool; theta = C (J^T w + tau) in the loaded state."""

    room: Array | None = None  #: How far each row of the pose may be off, None for nowhere. Shape (k, rows). [m, rad]
    name = "pose"
    formula = "p(q, theta) = p_wanted, z(q, theta) = z_wanted, theta = C (J^T w + tau)"

    def rows(self, station: Station) -> ca.SX:
        """Return the missed pose, less the slack of a released station."""
        return station.missed - station.slack

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return how far the pose may be off."""
        return (0.0, 0.0) if self.room is None else (-self.room, self.room)
