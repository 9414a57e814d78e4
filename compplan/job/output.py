"""[output]: programs of a job."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from compplan.controllers.writers import WRITERS, Wiring
from compplan.io.tomlfile import OneOf, StrictTable

#: Default distance of written moves from the tip: a share of the tolerance, and its minimum (assumed). [1, m]
FITTED, FINEST = 0.05, 2e-6


class CellTable(StrictTable):
    """[output.cell]: tool data and frame of the cell, and whether programs fill them."""

    tool: Annotated[int, Field(ge=0, le=999)] | Annotated[str, Field(max_length=32)] | None = None
    base: Annotated[int, Field(ge=0, le=999)] | Annotated[str, Field(max_length=32)] | None = None
    overwrite: bool = False


class OutputTable(StrictTable):
    """[output]: languages, form, fit tolerance and files of native programs."""

    programs: Annotated[tuple[Annotated[str, OneOf(WRITERS)], ...], Field(strict=False)] = ()
    form: Literal["linear", "joint", "both"] = "linear"
    fit_tolerance_mm: float | None = Field(default=None, ge=0.0, le=1.0)
    any_brand: bool = False
    templates: dict[Annotated[str, OneOf(WRITERS)], Annotated[str, Field(min_length=1)]] = Field(default_factory=dict)
    main: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")] | None = None
    cell: CellTable = CellTable.model_construct()
    io: Wiring = Wiring.model_construct()

    def bound_fit(self, tolerance: float) -> float:
        """Return the allowed distance of written moves from the tip. [m]

        Args:
            tolerance: The strictest tolerance of the path. [m]
        """
        stated = self.fit_tolerance_mm
        return max(FITTED * tolerance, FINEST) if stated is None else 1e-3 * stated
