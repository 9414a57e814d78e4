"""[noise] of a job: what is uncertain about cell, process and sensors in a Monte Carlo study.

Every key is one standard deviation unless its comment says otherwise, and every default is assumed or taken from
literature that did not measure the machine in front of you: `describe_noise` says which.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from compplan.io.tomlfile import OneOf, StrictTable
from compplan.job.names import EFFECTS

#: Where the defaults come from, key by key.
SOURCES: dict[str, str] = {
    "robot": "spread: the keys below; posterior: what the robot folder knows of itself",
    "joint_compliance": "assumed; identified to 2 to 9 % [Dumas2011], reduced models to 15 % [Mamedov2018]",
    "link_compliance": "assumed; beams stand for castings whose walls are not known [Mamedov2018]",
    "joint_zero_deg": "assumed, after calibration",
    "geometry_mm": "assumed, after calibration (0.1 to 0.5 mm at the TCP in all)",
    "geometry_deg": "assumed, after calibration",
    "tool_frame_mm": "assumed: touched off with a dial gauge",
    "part_frame_mm": "assumed; of a touched part [part] touch_repeatability_mm counts where this is not stated",
    "part_frame_deg": "assumed; as part_frame_mm",
    "backlash_deg": "assumed, full width; 0.05 to 0.3 mm of lost motion at the TCP of worn arms",
    "gear_error_deg": "assumed, amplitude of one period a turn of the motor pinion",
    "gear_periods": "assumed",
    "wrench_level": "what the force model states, else assumed; models of milling and forming err by 10 to 20 %",
    "wrench_direction_deg": "assumed",
    "wrench_path": "assumed; relative variation of the level along the path",
    "correlation_mm": "assumed; distance at which errors along the path forget each other",
    "motor_encoder_deg": "assumed; a 17-bit encoder behind a gear reads far finer than its mounting",
    "link_encoder_deg": "assumed; a 20-bit ring with its mounting error",
    "repeatability_mm": "robot folder where it says so, else assumed 0.02 mm an axis",
    "temperature_K": "assumed; drift of arms that warm up comes to 1 mm at most",
    "expansion_per_K": "aluminium and steel castings, mean of handbook values",
    "force_noise_N": "assumed; strain-gauge sensor of 2 to 5 kN range",
    "moment_noise_Nm": "assumed; strain-gauge sensor of 2 to 5 kN range",
    "force_bias_N": "assumed; drift since taring",
    "moment_bias_Nm": "assumed; drift since taring",
    "force_gain": "assumed; datasheets state 1 %",
    "tracker_mm": "tracker datasheets: 15 um ...",
    "tracker_mm_per_m": "... and 6 um a metre",
    "plant_lag_ms": "derived from the gains of [Johra2022] by the rule of Ziegler and Nichols read backwards",
    "plant_delay_ms": "derived from the gains of [Johra2022] by the rule of Ziegler and Nichols read backwards",
    "effects": "none assumed beside the keys above",
}

#: Keys that robot = "posterior" takes from the robot folder.
OF_ROBOT = (
    "joint_compliance", "link_compliance", "joint_zero_deg", "geometry_mm", "geometry_deg", "tool_frame_mm",
    "backlash_deg", "gear_error_deg", "repeatability_mm",
)  # fmt: skip


class EffectNoise(StrictTable):
    """[[noise.effects]]: an effect of the vocabulary that the cell may have; parameters are standard deviations, SI."""

    effect: Annotated[str, OneOf(EFFECTS)]
    joint: str | None = None
    axis: str | None = None
    parameters: dict[str, float | list[float]]


class NoiseTable(StrictTable):
    """[noise]: standard deviations of a Monte Carlo study (`SOURCES` says where each default comes from).

    Compliances are log-normal, so that none becomes negative; everything else is normal.
    """

    robot: Literal["spread", "posterior"] = "spread"
    joint_compliance: float = Field(default=0.10, ge=0.0, le=1.0)
    link_compliance: float = Field(default=0.20, ge=0.0, le=1.0)
    joint_zero_deg: float = Field(default=0.003, ge=0.0, le=10.0)
    geometry_mm: float = Field(default=0.03, ge=0.0, le=100.0)
    geometry_deg: float = Field(default=0.001, ge=0.0, le=10.0)
    tool_frame_mm: float = Field(default=0.03, ge=0.0, le=100.0)
    part_frame_mm: float = Field(default=0.05, ge=0.0, le=1000.0)
    part_frame_deg: float = Field(default=0.005, ge=0.0, le=30.0)
    backlash_deg: float = Field(default=0.002, ge=0.0, le=10.0)
    gear_error_deg: float = Field(default=0.002, ge=0.0, le=10.0)
    gear_periods: float = Field(default=60.0, gt=0.0, le=100000.0)
    wrench_level: float = Field(default=0.15, ge=0.0, le=1.0)
    wrench_direction_deg: float = Field(default=3.0, ge=0.0, le=60.0)
    wrench_path: float = Field(default=0.05, ge=0.0, le=1.0)
    correlation_mm: float = Field(default=20.0, gt=0.0, le=1000000.0)
    motor_encoder_deg: float = Field(default=0.0003, ge=0.0, le=10.0)
    link_encoder_deg: float = Field(default=0.0008, ge=0.0, le=10.0)
    repeatability_mm: float | None = Field(default=None, ge=0.0, le=10.0)
    temperature_K: float = Field(default=3.0, ge=0.0, le=200.0)
    expansion_per_K: float = Field(default=12e-6, ge=0.0, le=0.001)
    force_noise_N: float = Field(default=2.0, ge=0.0, le=10000.0)
    moment_noise_Nm: float = Field(default=0.1, ge=0.0, le=10000.0)
    force_bias_N: float = Field(default=5.0, ge=0.0, le=10000.0)
    moment_bias_Nm: float = Field(default=0.5, ge=0.0, le=10000.0)
    force_gain: float = Field(default=0.01, ge=0.0, le=0.5)
    tracker_mm: float = Field(default=0.015, ge=0.0, le=100.0)
    tracker_mm_per_m: float = Field(default=0.006, ge=0.0, le=100.0)
    plant_lag_ms: float = Field(default=13.5, gt=0.0)
    plant_delay_ms: float = Field(default=37.0, ge=0.0)
    effects: Annotated[tuple[EffectNoise, ...], Field(strict=False)] = ()


def describe_noise(table: NoiseTable) -> list[str]:
    """Say of every key its value and where it comes from, one sentence each."""
    stated = table.model_fields_set
    left = OF_ROBOT if table.robot == "posterior" else ()
    return [
        f"noise.{key} = {_show(getattr(table, key))}: {'set in the job' if key in stated else source}"
        for key, source in SOURCES.items()
        if key not in left
    ]


def _show(value: object) -> str:
    if not isinstance(value, tuple):
        return str(value)
    return ", ".join(f"{e.effect} {e.joint or ''} {e.axis or ''} {e.parameters}" for e in value) or "none"
