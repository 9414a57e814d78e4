"""Released stations miss their pose by as little as the limits allow."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station


@dataclass(frozen=True)
class MissedPose(Cost):
    """W sum (|tip|^2 + (lever angle)^2) over the pose that released stations miss; an excessive correction costs more.

    Attributes:
        weight: W against the other costs. [1/m^2]
        steep: What a metre of correction beyond its limit costs against W, an exact penalty. [1/m]
        lever: What an error of orientation costs against one of position. [m/rad]

    """

    weight: float = 1e3
    lever: float = 0.2
    steep: float = 20.0
    name = "missed_pose"

    def __str__(self) -> str:
        return f"{self.weight:g} sum |missed pose|^2"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the slack."""
        tip, rest = station.slack[:3], station.slack[3:]
        return self.weight * (ca.sumsqr(tip) + self.lever**2 * ca.sumsqr(rest) + self.steep * station.excess)
