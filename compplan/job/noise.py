"""[noise] of a job: standard deviations of part, process and sensors in a Monte Carlo study.

Keys are standard deviations unless stated otherwise; defaults are assumed or from literature (`describe_noise`).
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from compplan.io.tomlfile import OneOf, StrictTable
from compplan.job.names import EFFECTS

#: Sources of the defaults by key.
SOURCES: dict[str, str] = {
    "link_share": "assumed; share of a joint spring beyond its link-side encoder where one spring stands for both",
    "part_frame_mm": "assumed; of a touched part [part] touch_repeatability_mm counts where this is not stated",
    "part_frame_deg": "assumed; as part_frame_mm",
    "wrench_level": "what the force model states, else assumed; models of milling and forming err by 10 to 20 %",
    "wrench_direction_deg": "assumed",
    "wrench_path": "assumed; relative variation of the level along the path",
    "correlation_mm": "assumed; correlation length of errors along the path",
    "motor_encoder_deg": "assumed; a 17-bit encoder behind a gear reads far finer than its mounting",
    "link_encoder_deg": "assumed; a 20-bit ring with its mounting error",
    "temperature_K": "assumed; drift of arms that warm up comes to 1 mm at most",
    "expansion_per_K": "aluminium and steel castings, mean of handbook values",
    "force_noise_N": "assumed; strain-gauge sensor of 2 to 5 kN range",
    "moment_noise_Nm": "assumed; strain-gauge sensor of 2 to 5 kN range",
    "force_bias_N": "assumed; drift since taring",
    "moment_bias_Nm": "assumed; drift since taring",
    "force_gain": "assumed; datasheets state 1 %",
    "effects": "none assumed beside the keys above",
}


class EffectNoise(StrictTable):
    """[[noise.effects]]: a random effect of the simulated robot; parameters are standard deviations, SI."""

    effect: Annotated[str, OneOf(EFFECTS)]
    joint: str | None = None
    axis: str | None = None
    parameters: dict[str, float | list[float]]


class NoiseTable(StrictTable):
    """[noise]: standard deviations of a Monte Carlo study (sources: `SOURCES`).

    Robots are drawn from the uncertainty of the robot folder (`compplan.uncertainty.assumed`); these are the rest.
    """

    link_share: float = Field(default=0.15, ge=0.0, le=1.0)
    part_frame_mm: float = Field(default=0.05, ge=0.0, le=1000.0)
    part_frame_deg: float = Field(default=0.005, ge=0.0, le=30.0)
    wrench_level: float = Field(default=0.15, ge=0.0, le=1.0)
    wrench_direction_deg: float = Field(default=3.0, ge=0.0, le=60.0)
    wrench_path: float = Field(default=0.05, ge=0.0, le=1.0)
    correlation_mm: float = Field(default=20.0, ge=1e-3, le=1000000.0)
    motor_encoder_deg: float = Field(default=0.0003, ge=0.0, le=10.0)
    link_encoder_deg: float = Field(default=0.0008, ge=0.0, le=10.0)
    temperature_K: float = Field(default=3.0, ge=0.0, le=200.0)
    expansion_per_K: float = Field(default=12e-6, ge=0.0, le=0.001)
    force_noise_N: float = Field(default=2.0, ge=0.0, le=10000.0)
    moment_noise_Nm: float = Field(default=0.1, ge=0.0, le=10000.0)
    force_bias_N: float = Field(default=5.0, ge=0.0, le=10000.0)
    moment_bias_Nm: float = Field(default=0.5, ge=0.0, le=10000.0)
    force_gain: float = Field(default=0.01, ge=0.0, le=0.5)
    effects: Annotated[tuple[EffectNoise, ...], Field(strict=False)] = ()


def describe_noise(table: NoiseTable) -> list[str]:
    """Return value and source of every key, one sentence each."""
    stated = table.model_fields_set
    return [
        f"noise.{key} = {_show(getattr(table, key))}: {'set in the job' if key in stated else source}"
        for key, source in SOURCES.items()
    ]


def _show(value: object) -> str:
    if not isinstance(value, tuple):
        return str(value)
    return ", ".join(f"{e.effect} {e.joint or ''} {e.axis or ''} {e.parameters}" for e in value) or "none"
