"""Incremental sheet forming with given forces."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from compplan.io.tables import Array
from compplan.toolpath.contact import ContactTable, PathForceTable, cutting_progress
from compplan.toolpath.toolpath import Toolpath

words = "incremental sheet forming with given forces"


class IsfProcess(PathForceTable, ContactTable):
    """Incremental sheet forming: the sheet pushes the tool up and away from the wall, increasingly along the path.

    The axial force acts along the tool axis towards the spindle, the lateral force away from the formed wall.
    `wall_side` is the side of the travel on which the wall is, viewed down the tool axis: "right" on a cone formed
    counter-clockwise from its rim inwards, so that the force points to its axis.
    Both grow linearly along the cutting length, from `start_share` of the given level to the level itself.
    """

    model: Literal["isf"]
    axial_N: float = Field(ge=0.0)
    lateral_N: float = Field(default=0.0, ge=0.0)
    start_share: float = Field(default=0.3, ge=0.0, le=1.0)
    wall_side: Literal["left", "right"] = "right"

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench of incremental sheet forming, path axes, without contact ramps. Shape (n, 6) [N, N m]."""
        progress = cutting_progress(nominal)
        level = self.start_share + (1.0 - self.start_share) * progress / max(progress[-1], 1e-300)
        side = 1.0 if self.wall_side == "right" else -1.0
        return level[:, None] * np.array([0.0, side * self.lateral_N, self.axial_N, 0.0, 0.0, 0.0])


table = IsfProcess
