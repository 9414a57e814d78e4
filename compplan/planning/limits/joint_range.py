"""Range of the joint positions."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Limit, Station


@dataclass(frozen=True)
class JointRange(Limit):
    """q_min <= q <= q_max; bounds of the variables, no rows."""

    name = "joint_range"
    formula = "q_min <= q <= q_max"
    of_joints = True

    def rows(self, station: Station) -> ca.SX:
        """Return no rows: the range bounds the variables directly."""
        return ca.SX(0, 1)
