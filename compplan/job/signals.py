"""[output.io]: signals of the cell."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import BeforeValidator, Field

from compplan.controllers.writers import Wiring
from compplan.io.tomlfile import StrictTable


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
