"""Cutting coefficients of materials, each with its source, range of validity and uncertainty.

Force on a slice of cutting edge of width b at chip thickness h, for each of the directions along the cutting speed
(tangential), against the outward normal (radial) and along the edge away from the spindle (axial):

    F = (K h^(1 - m) + K_edge) b        h and b in mm, K in N/mm^2 (at h = 1 mm where m > 0), K_edge in N/mm.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from compplan.io.tomlfile import StrictTable

Force3 = Annotated[tuple[float, float, float], Field(strict=False)]


@dataclass(frozen=True)
class Coefficients:
    """Cutting coefficients of a material."""

    cutting: tuple[float, float, float]  #: Tangential, radial, axial. [N/mm^2]
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: The same, per width. [N/mm]
    exponent: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Kienzle's exponent m of each. []
    #: Relative standard deviation of the cutting coefficients that Monte Carlo draws from. []
    uncertainty: float = 0.15
    #: Range of chip thickness of the measurement, or the usual one. [mm]
    valid_chip_mm: tuple[float, float] = (0.02, 0.3)
    source: str = "the job"  #: Source of the coefficients.
    assumed: bool = False  #: Whether they are not verified against a publication.


class CoefficientTable(StrictTable):
    """[process.coefficients]: tangential, radial, axial; `exponent` is Kienzle's m of each (K is then at h = 1 mm)."""

    cutting_N_mm2: Force3
    edge_N_mm: Force3 = (0.0, 0.0, 0.0)
    exponent: Force3 = (0.0, 0.0, 0.0)
    uncertainty: float = Field(default=0.1, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _check(self) -> CoefficientTable:
        if not 10.0 <= self.cutting_N_mm2[0] <= 20_000.0 or max(map(abs, self.cutting_N_mm2)) > 20_000.0:
            raise ValueError(
                f"cutting_N_mm2 is {list(self.cutting_N_mm2)}, the tangential one is 10 to 20000 N/mm2 "
                "and none is larger: check the unit"
            )
        if not all(0.0 <= value <= 500.0 for value in self.edge_N_mm):
            raise ValueError(f"edge_N_mm is {list(self.edge_N_mm)}, 0 to 500 N/mm is allowed: check the unit")
        if not all(0.0 <= value <= 0.9 for value in self.exponent):
            raise ValueError(f"exponent is {list(self.exponent)}, 0 to 0.9 is allowed")
        return self

    def coefficients(self) -> Coefficients:
        """Return the table as `Coefficients`."""
        return Coefficients(self.cutting_N_mm2, self.edge_N_mm, self.exponent, uncertainty=self.uncertainty)


#: Names of `Coefficients` fields by the keys of a table, where they differ.
KEYS = {"cutting_N_mm2": "cutting", "edge_N_mm": "edge"}
#: Materials of the package, by name.
MATERIALS: dict[str, Coefficients] = {}
for _name, _table in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items():
    _fields: dict[str, Any] = {KEYS.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in _table.items()}
    MATERIALS[_name] = Coefficients(**_fields)
