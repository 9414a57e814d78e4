"""Small CAM files as texts."""

from __future__ import annotations

from pathlib import Path

import tomli_w

from compplan.toolpath.readers import CamFile, CamTable, read_cam
from compplan.toolpath.readers.options import MachineAxes


def read_cam_text(folder: Path, text: str, suffix: str, **options: object) -> CamFile:
    """Write a CAM file, its rotary axes as a machine beside it, and read it; robot programs hold the tool along z."""
    file = folder / f"part{suffix}"
    file.write_text(text)
    axes = {key: options.pop(key) for key in MachineAxes.model_fields if key in options}
    if axes:
        machine = {"rotary": options.pop("rotary", "head"), **axes}
        (folder / "own.toml").write_text(tomli_w.dumps({"schema": 1, "machine": machine}))
        options["machine"] = "own"
    return read_cam(file, CamTable.model_validate({"tool_direction": "z", **options}))


def ends(cam: CamFile) -> list[list[float]]:
    """Return the waypoints. [mm]"""
    return (cam.toolpath.position * 1e3).round(6).tolist()


def cuts(cam: CamFile) -> list[list[float]]:
    """Return where cutting moves end. [mm]"""
    return [point for point, rapid in zip(ends(cam), cam.toolpath.rapid, strict=True) if not rapid]
