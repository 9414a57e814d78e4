"""Force model of an end mill with a force from its engagement in the stock."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from compplan.io.tomlfile import StrictTable
from compplan.process.cutting import CuttingTable
from compplan.process.engagement import Cutter

words = "end mill, force from its engagement in the stock"
#: Default flute length (assumed), in diameters.
FLUTES = 3.0


class ToolModeTable(StrictTable):
    """[process.tool_mode]: the lowest bending mode of tool and holder, for the stability limit of depth."""

    frequency_Hz: float = Field(ge=1.0, le=2e4)
    stiffness_N_mm: float = Field(ge=1.0, le=1e7)
    damping: float = Field(default=0.03, ge=1e-4, le=0.5)


class EndMillProcess(CuttingTable):
    """An end mill with engagement from stock and path, see `compplan.process.cutting`."""

    model: Literal["end_mill"]
    flute_mm: float | None = Field(default=None, ge=0.01, le=1000.0)
    corner_radius_mm: float = Field(default=0.0, ge=0.0)
    tool_mode: ToolModeTable | None = None

    @model_validator(mode="after")
    def _check(self) -> EndMillProcess:
        if self.corner_radius_mm > 0.5 * self.diameter_mm:
            raise ValueError(
                f"corner_radius_mm is {self.corner_radius_mm:g}, at most half of diameter_mm = {self.diameter_mm:g} "
                "is allowed (a ball end mill)"
            )
        return self

    def cutter(self) -> Cutter:
        """Return the cutter's shape."""
        radius, corner = 0.5e-3 * self.diameter_mm, 1e-3 * self.corner_radius_mm
        flute = 2.0 * FLUTES * radius if self.flute_mm is None else 1e-3 * self.flute_mm
        return Cutter(radius, max(flute, corner), corner)


table = EndMillProcess
