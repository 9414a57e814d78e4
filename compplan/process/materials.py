"""Cutting coefficients of materials, each with its source, range of validity and uncertainty.

Force on a slice of cutting edge of width b at chip thickness h, for each of the directions along the cutting speed
(tangential), against the outward normal (radial) and along the edge away from the spindle (axial):

    F = (K h^(1 - m) + K_edge) b        h and b in mm, K in N/mm^2 (at h = 1 mm where m > 0), K_edge in N/mm.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Coefficients:
    """What a material resists a cutting edge with."""

    cutting: tuple[float, float, float]  #: Tangential, radial, axial. [N/mm^2]
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: The same, per width. [N/mm]
    exponent: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Kienzle's exponent m of each. []
    #: Relative standard deviation of the cutting coefficients that Monte Carlo draws from. []
    uncertainty: float = 0.15
    #: Chip thickness that they were measured at, or is usual for them. [mm]
    valid_chip_mm: tuple[float, float] = (0.02, 0.3)
    source: str = "the job"  #: Where they come from.
    assumed: bool = False  #: Whether they were not checked against a publication.


#: Fields of a material by the keys of its table, where they differ.
KEYS = {"cutting_N_mm2": "cutting", "edge_N_mm": "edge"}


def _make_material(table: Mapping[str, Any]) -> Coefficients:
    fields: dict[str, Any] = {
        KEYS.get(key, key): tuple(value) if isinstance(value, list) else value for key, value in table.items()
    }
    return Coefficients(**fields)


#: The materials that ship with compplan, by name.
MATERIALS: dict[str, Coefficients] = {
    name: _make_material(table)
    for name, table in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
