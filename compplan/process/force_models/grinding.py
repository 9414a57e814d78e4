"""Grinding and sanding with a controlled normal force: the tangential force is proportional to it.

The ratio of tangential to normal force is 0.3 to 0.6 for most pairings [Malkin and Guo, Grinding Technology, 2nd ed.
2008]; 0.45 and an uncertainty of 25 % are assumed. Valid for steady contact of a wheel, belt or pad. The normal force
acts along the tool axis (a disc or pad that is flat on the surface).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from compplan.io.tables import Array
from compplan.toolpath.contact import PathForceTable, find_retracts
from compplan.toolpath.toolpath import Toolpath

words = "grinding or sanding"
#: Ratio of tangential to normal force (assumed).
RATIO = 0.45


class GrindingProcess(PathForceTable):
    """Mean force of grinding or sanding, see `compplan.process.force_models.grinding`."""

    uncertainty: ClassVar[float] = 0.25  #: Relative standard deviation of the level, assumed.
    model: Literal["grinding"]
    normal_N: float = Field(gt=0.0, le=1e4)
    direction: Literal["against", "along"] = "against"

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench on the tool at every waypoint, path axes; zero while it is lifted off. Shape (n, 6)."""
        along = RATIO * self.normal_N * (-1.0 if self.direction == "against" else 1.0)
        return np.tile([along, 0.0, self.normal_N, 0.0, 0.0, 0.0], (len(nominal), 1)) * ~find_retracts(nominal)[:, None]

    def describe(self, nominal: Toolpath) -> list[str]:
        """Return notes on assumptions."""
        return [f"Grinding: normal force as set in the job, tangential by normal force {RATIO:g} (assumed)."]


table = GrindingProcess
