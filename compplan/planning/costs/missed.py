"""Released stations miss their pose by as little as the limits allow."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station


@dataclass(frozen=True)
class MissedPose(Cost):
    """W sum (|tip|^2 + (lever angle)^2) over the pose that released stations miss; too long a correction costs more."""

    weight: float = 1e3  #: W against the other costs. [1/m^2]
    lever: float = 0.2  #: What an error of orientation costs against one of position. [m/rad]
    steep: float = 20.0  #: What a metre of correction beyond its limit costs against W, an exact penalty. [1/m]
    name = "missed_pose"

    def __str__(self) -> str:
        return f"{self.weight:g} sum |missed pose|^2"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the slack."""
        tip, rest = station.slack[:3], station.slack[3:]
        return self.weight * (ca.sumsqr(tip) + self.lever**2 * ca.sumsqr(rest) + self.steep * station.excess)
