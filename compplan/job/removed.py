"""Keys of earlier releases."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compplan.errors import InputError

CAM = "a CAM system checks finished walls and stock; delete it"
TURN = "the force is the mean of a turn, which does not depend on it; delete it"
DRAWN = "robots are drawn from the robot folder's uncertainty.toml, or by its grade; state it there and delete the key"
#: Keys of [noise] replaced by the robot folder.
OF_ROBOT = (
    "robot", "joint_compliance", "link_compliance", "joint_zero_deg", "geometry_mm", "geometry_deg", "tool_frame_mm",
    "backlash_deg", "gear_error_deg", "gear_periods", "repeatability_mm",
)  # fmt: skip
#: Removed keys, dotted, with remedies.
REMOVED = {
    "coupling": "the force is that of the tool on its path; delete it",
    "stability": "state [process] tool_mode, a plan notes the limit of depth",
    "posture.weights.stability": "delete it",
    "output.splines": "programs are lines and arcs; delete it",
    "surface": CAM,
    "tool_beam": CAM,
    "process.part": CAM,
    "process.holder_mm": CAM,
    "tool.process.part": CAM,
    "tool.process.holder_mm": CAM,
    **dict.fromkeys(("process.helix_deg", "process.runout_mm"), TURN),
    **dict.fromkeys(("tool.process.helix_deg", "tool.process.runout_mm"), TURN),
    **dict.fromkeys((f"noise.{key}" for key in OF_ROBOT), DRAWN),
    **dict.fromkeys(("noise.tracker_mm", "noise.tracker_mm_per_m"), "no strategy measures a first part; delete it"),
    **dict.fromkeys(("noise.plant_lag_ms", "noise.plant_delay_ms"), "no strategy runs a control loop; delete it"),
}


def refuse_removed(data: Mapping[str, Any], file: str | Path) -> None:
    """Refuse a job that holds a removed key.

    Raises:
        InputError: With the key and a remedy.

    """
    for key, advice in REMOVED.items():
        *tables, last = key.split(".")
        places: list[Any] = [data]
        for table in tables:
            inner = [place[table] for place in places if isinstance(place, Mapping) and table in place]
            places = [row for rows in inner for row in (rows if isinstance(rows, list) else [rows])]
        if any(isinstance(place, Mapping) and last in place for place in places):
            name = f"[{last}]" if not tables else key
            raise InputError(f"{name} is no longer supported; {advice}", file=file, where=key)
