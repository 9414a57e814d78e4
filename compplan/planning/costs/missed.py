"""Cost of the pose error of released stations: as small as the limits allow."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from compplan.planning.problem import Cost, Station


@dataclass(frozen=True)
class MissedPose(Cost):
    """W sum (|tip|^2 + (lever angle)^2 + steep excess) of released stations, excess the correction beyond its limit."""

    weight: float = 1e3  #: W relative to the other costs. [1/m^2]
    lever: float = 0.2  #: Position error of equal cost per orientation error. [m/rad]
    steep: float = 20.0  #: Exact penalty of a correction beyond its limit, relative to W. [m]
    name = "missed_pose"
    formula = "{weight:g} sum |missed pose|^2"

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the slack and the penalty of the excess."""
        tip, rest = station.slack[:3], station.slack[3:]
        return self.weight * (ca.sumsqr(tip) + self.lever**2 * ca.sumsqr(rest) + self.steep * station.excess)
