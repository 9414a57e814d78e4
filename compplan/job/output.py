"""[output]: programs of a job."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from compplan.controllers.writers import WRITERS, Wiring
from compplan.io.tomlfile import OneOf, StrictTable


def _check_signal(value: object) -> object:
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 99999:
        return value
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,31}", value):
        return value
    raise ValueError(f"is {value!r}, expected the number of a signal (0 to 99999), or its name")


SignalValue = Annotated[int | str, BeforeValidator(_check_signal)]


class IoTable(StrictTable):
    """[output.io]: signals of the cell for events of the CAM file; events without one ask the operator."""

    spindle: SignalValue | None = None
    spindle_ready: SignalValue | None = None
    coolant: SignalValue | None = None
    tool_change: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")] | None = None
    optional_stop: SignalValue | None = None
    signals: dict[str, SignalValue] = Field(default_factory=dict)

    @property
    def wiring(self) -> Wiring:
        """The signals for program writers; names are case-insensitive."""
        signals = {name.upper(): signal for name, signal in self.signals.items()}
        return Wiring(**{**self.model_dump(exclude={"signals"}), "signals": signals})


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
    cell: CellTable = CellTable()
    io: IoTable = IoTable()

    def bound_fit(self, tolerance: float) -> float:
        """Return the allowed distance of written moves from the tip. [m]

        Args:
            tolerance: The strictest tolerance of the path. [m]

        """
        stated = self.fit_tolerance_mm
        return max(FITTED * tolerance, FINEST) if stated is None else 1e-3 * stated
