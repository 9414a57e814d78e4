"""[noise] of a job: standard deviations of part, process and sensors in a Monte Carlo study.

Keys are standard deviations unless stated otherwise; defaults are assumed or from literature (`describe_noise`).
"""

from __future__ import annotations

from pydantic import Field

from compplan.io.tomlfile import StrictTable

#: Thermal expansion of an arm of aluminium and steel castings, mean of handbook values. [1/K]
EXPANSION = 12e-6
#: Sources of the defaults by key.
SOURCES: dict[str, str] = {
    "link_share": "assumed; share of a joint spring beyond its link-side encoder where one spring stands for both",
    "part_frame_mm": "assumed for an absolute frame; where this is not stated, a touched part is placed within 0.02 mm",
    "part_frame_deg": "assumed; as part_frame_mm",
    "wrench_level": "what the force model states, else assumed; models of milling and forming err by 10 to 20 %",
    "wrench_direction_deg": "assumed",
    "wrench_path": "assumed; relative variation of the level along the path",
    "temperature_K": "assumed; drift of arms that warm up comes to 1 mm at most",
    "force_noise_N": "assumed; strain-gauge sensor of 2 to 5 kN range, drift 2.5 times as large",
}


class NoiseTable(StrictTable):
    """[noise]: standard deviations of a Monte Carlo study (sources: `SOURCES`).

    Errors of robots are drawn from the uncertainty of the robot folder (`compplan.uncertainty.assumed`) instead.
    """

    link_share: float = Field(default=0.15, ge=0.0, le=1.0)
    part_frame_mm: float = Field(default=0.05, ge=0.0, le=1000.0)
    part_frame_deg: float = Field(default=0.005, ge=0.0, le=30.0)
    wrench_level: float = Field(default=0.15, ge=0.0, le=1.0)
    wrench_direction_deg: float = Field(default=3.0, ge=0.0, le=60.0)
    wrench_path: float = Field(default=0.05, ge=0.0, le=1.0)
    temperature_K: float = Field(default=3.0, ge=0.0, le=200.0)
    force_noise_N: float = Field(default=2.0, ge=0.0, le=10000.0)


def describe_noise(table: NoiseTable) -> list[str]:
    """Return value and source of every key, one sentence each."""
    stated = table.model_fields_set
    return [
        f"noise.{key} = {getattr(table, key)}: {'set in the job' if key in stated else source}"
        for key, source in SOURCES.items()
    ]
