"""Joints stay within their range."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Limit, PlanningProblem, Station
from compplan.robot import Array


@dataclass(frozen=True)
class JointRange(Limit):
    """q_min <= q <= q_max; bounds of the variables, no rows."""

    name = "joint_range"
    of_joints = True

    def __str__(self) -> str:
        return "q_min <= q <= q_max"

    def rows(self, station: Station) -> ca.SX:
        """Return no rows: the range bounds the variables themselves."""
        return ca.SX(0, 1)

    def bounds(self, problem: PlanningProblem) -> tuple[Array, Array]:
        """Return the range. Shapes (k, nq)."""
        return problem.lower, problem.upper
