"""Grinding and sanding: tangential force from the specific energy of removal, or a normal force that is held.

The power that takes away a volume Q a second with specific energy u drives the wheel's surface at the speed v_s:

    F_t = u Q / v_s,    Q = depth width feed,    F_n = F_t / ratio

[Malkin and Guo, Grinding Technology, 2nd ed. 2008: force ratio and specific energy]. With `normal_N` (force-controlled
sanding) F_n is that force and F_t = ratio F_n, whatever the feed. The ratio of tangential to normal force is 0.3 to 0.6
for most pairings; the default 0.45 is assumed, and so is +- 25 %. Valid for steady contact of a wheel, belt or pad.
The normal force acts along the tool axis (a disc or pad that lies on the surface).
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from compplan.io.tables import Array
from compplan.toolpath.contact import PathForceTable, lifts
from compplan.toolpath.toolpath import Toolpath

words = "grinding or sanding"
cites = "Malkin, Guo: Grinding Technology, 2nd edition, 2008"


class GrindingProcess(PathForceTable):
    """Mean force of grinding or sanding, see `compplan.process.force_models.grinding`."""

    uncertainty: ClassVar[float] = 0.25  #: Relative standard deviation of the level, assumed.
    model: Literal["grinding"]
    normal_N: float | None = Field(default=None, gt=0.0, le=1e4)
    specific_energy_J_mm3: float | None = Field(default=None, ge=0.5, le=500.0)
    depth_mm: float | None = Field(default=None, gt=0.0, le=50.0)
    width_mm: float | None = Field(default=None, gt=0.0, le=1000.0)
    wheel_speed_m_s: float | None = Field(default=None, ge=0.1, le=300.0)
    force_ratio: float = Field(default=0.45, gt=0.0, le=2.0)
    direction: Literal["against", "along"] = "against"

    @model_validator(mode="after")
    def _check(self) -> GrindingProcess:
        removal = (self.specific_energy_J_mm3, self.depth_mm, self.width_mm, self.wheel_speed_m_s)
        if self.normal_N is None and None in removal:
            raise ValueError("needs normal_N, or specific_energy_J_mm3, depth_mm, width_mm and wheel_speed_m_s")
        if self.normal_N is not None and any(value is not None for value in removal):
            raise ValueError("has normal_N and keys of the removal rate, one of the two is allowed")
        return self

    @property
    def follows_feed(self) -> bool:
        """Tell whether the force depends on the feed that is driven."""
        return self.normal_N is None

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench on the tool at every waypoint, path axes; none while it is lifted off. Shape (n, 6)."""
        if self.normal_N is not None:
            normal = np.full(len(nominal), self.normal_N)
            tangential = self.force_ratio * normal
        else:
            energy = float(self.specific_energy_J_mm3 or 0.0) * 1e9
            section = float(self.depth_mm or 0.0) * float(self.width_mm or 0.0) * 1e-6
            tangential = energy * section * nominal.feed / float(self.wheel_speed_m_s or 1.0)
            normal = tangential / self.force_ratio
        wrench = np.zeros((len(nominal), 6))
        wrench[:, 0], wrench[:, 2] = (-1.0 if self.direction == "against" else 1.0) * tangential, normal
        return wrench * ~lifts(nominal)[:, None]

    def describe(self, nominal: Toolpath) -> list[str]:
        """Say what was assumed."""
        how = "normal force as set in the job" if self.normal_N is not None else "specific energy of removal"
        return [
            f"Grinding: {how} [Malkin and Guo 2008], tangential by normal force {self.force_ratio:g} (assumed unless "
            "it was measured)."
        ]


table = GrindingProcess
