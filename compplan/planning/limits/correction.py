"""Limit of the correction: distance of the unloaded tip from the path."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station


@dataclass(frozen=True)
class CorrectionLimit(Limit):
    """|p_unloaded(q) - p_programmed| <= c, written sqrt(2 d^2 + 2 c^2) - 2 c <= 0: smooth, scales as a length."""

    most: float  #: Greatest distance c. [m]
    name = "correction"

    def __str__(self) -> str:
        return f"|p_unloaded(q) - p_programmed| <= {1e3 * self.most:g} mm"

    def rows(self, station: Station) -> ca.SX:
        """Return the correction beyond its limit, less the slack of a released station."""
        gap = station.frames.position - station.programmed
        return ca.sqrt(2.0 * (ca.sumsqr(gap) + self.most**2)) - 2.0 * self.most - station.excess

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the row: infinite where the tool is unloaded."""
        return -np.inf, np.where(problem.loaded, 0.0, np.inf)[:, None]
