"""Mean force of one revolution of an end mill of constant depth, width and cutting coefficients."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from compplan.io.tables import Array
from compplan.toolpath.contact import ContactTable, PathForceTable, lateral_share
from compplan.toolpath.toolpath import Toolpath

words = "mean force of an end mill of given depth and width"


class MillingProcess(PathForceTable, ContactTable):
    """Mean force of one revolution of an end mill with constant cutting coefficients, see `milling_wrench`.

    Above stock_top_mm (z of the part) there is no force; less than depth_mm below it the force is reduced linearly.
    """

    follows_feed: ClassVar[bool] = True
    model: Literal["milling"]
    depth_mm: float = Field(gt=0.0)
    width_mm: float = Field(gt=0.0)
    diameter_mm: float = Field(gt=0.0)
    spindle_rpm: float = Field(gt=0.0)
    kc_N_mm2: float = Field(gt=0.0)
    radial_ratio: float = Field(default=0.4, ge=0.0)
    material_side: Literal["left", "right"] = "right"
    stock_top_mm: float | None = None

    @model_validator(mode="after")
    def _check(self) -> MillingProcess:
        if self.width_mm > self.diameter_mm:
            raise ValueError(f"width_mm is {self.width_mm:g}, at most diameter_mm = {self.diameter_mm:g} is allowed")
        return self

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench of `milling_wrench` at the feed component across the tool axis."""
        return milling_wrench(self, nominal.feed * lateral_share(nominal))


def milling_wrench(process: MillingProcess, feed: Array) -> Array:
    """Return the mean wrench of one revolution of an end mill at a feed [m/s], path axes. (n,) -> (n, 6) [N, N m]

    Valid for a spindle that turns clockwise viewed from the spindle (M3) and many revolutions per waypoint. psi is the
    angle of the tooth from the travel towards the left, h = f cos(psi) the chip thickness (f: feed a tooth). With
    constant coefficients the force on the tool is F = N ap / (2 pi) * integral of h (kt z x r - kr r) over the
    engagement [Altintas2012], kt = kc, kr = radial_ratio kc.
    `material_side` right with M3 is climb milling.
    """
    radius = 0.5 * process.diameter_mm
    inner = float(np.arcsin(np.clip(process.width_mm / radius - 1.0, -1.0, 1.0)))
    low, high = (-0.5 * np.pi, inner) if process.material_side == "right" else (-inner, 0.5 * np.pi)
    cos_sin = 0.5 * (np.sin(high) ** 2 - np.sin(low) ** 2)
    cos_cos = 0.5 * (high - low) + 0.25 * (np.sin(2.0 * high) - np.sin(2.0 * low))
    cosine = np.sin(high) - np.sin(low)
    kr = process.radial_ratio
    shape = np.array([-cos_sin - kr * cos_cos, cos_cos - kr * cos_sin, 0.0, 0.0, 0.0, radius * 1e-3 * cosine])
    feed_mm_rev = feed * 1e3 * 60.0 / process.spindle_rpm  # teeth times feed a tooth
    return (process.kc_N_mm2 * process.depth_mm * feed_mm_rev / (2.0 * np.pi))[:, None] * shape


table = MillingProcess
