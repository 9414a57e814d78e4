"""[stability] of a job: whether a cut chatters, and how the tip of the tool answers."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from compplan.io.tomlfile import StrictTable


class StabilityTable(StrictTable):
    """[stability]: judge chatter in `compplan forces`, avoid it by the posture, damping of the arm's modes (assumed).

    `modes` is a table of measured modes of tool, holder and spindle, `frf` names measured responses of the tip along x,
    y, z of the tool that modes are fitted to; with arm_modes = false they stand for the arm too. The spreads are
    standard deviations of the logarithms of the arm's frequencies and damping (assumed).

    A job without this table asks for no judgement; one with it does, unless it says judge = false.
    """

    judge: bool = True
    avoid: bool = False
    damping: float = Field(default=0.03, gt=0.0, le=0.5)
    modes: str | None = None
    frf: dict[Literal["x", "y", "z"], str] | None = None
    arm_modes: bool = True
    frequency_spread: float = Field(default=0.1, ge=0.0, le=1.0)
    damping_spread: float = Field(default=0.4, ge=0.0, le=2.0)

    @model_validator(mode="after")
    def _check_modes(self) -> StabilityTable:
        if self.modes is not None and self.frf is not None:
            raise ValueError("modes and frf both say how the tip answers, choose one")
        if not self.arm_modes and self.modes is None and not self.frf:
            raise ValueError("arm_modes = false needs measured ones: give modes or frf")
        return self
