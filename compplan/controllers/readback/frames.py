"""Frames of a job, tool and part, in every form: the independent check's own reading.

Written from the keys as docs/formats.md states them; it shares nothing with `compplan.job.frames`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from compplan.io.tomlfile import read_toml


def read_rotation(table: Mapping[str, Any]) -> Rotation:
    """Return the rotation that a table says."""
    if table.get("quaternion") is not None:
        w, x, y, z = table["quaternion"]
        return Rotation.from_quat((x, y, z, w))
    if table.get("abc_deg") is not None:  # A about z, B about the new y, C about the newest x
        return Rotation.from_euler("ZYX", table["abc_deg"], degrees=True)
    if table.get("wpr_deg") is not None:  # W, P and R about the fixed x, y and z
        return Rotation.from_euler("xyz", table["wpr_deg"], degrees=True)
    return Rotation.from_rotvec(table.get("rotation_deg") or (0.0, 0.0, 0.0), degrees=True)


def read_frame(table: Mapping[str, Any]) -> pin.SE3:
    """Return the frame that a table says by position and rotation. [m]"""
    place = np.array(table.get("position_mm") or (0.0, 0.0, 0.0), float)
    return pin.SE3(read_rotation(table).as_matrix(), place / 1000.0)


def read_part(table: Mapping[str, Any]) -> pin.SE3:
    """Return the part frame seen from the base, stated or from points. [m]"""
    if table.get("points_mm") is None:
        return read_frame(table)
    nominal, measured = (np.array(table["points_mm"][key], float) for key in ("nominal", "measured"))
    middle, seen = nominal.mean(axis=0), measured.mean(axis=0)
    turn = Rotation.align_vectors(measured - seen, nominal - middle)[0].as_matrix()
    return pin.SE3(turn, (seen - turn @ middle) / 1000.0)


def read_mounting(tool: Mapping[str, Any], folder: Path, flange_to_tool0: pin.SE3 | None) -> pin.SE3:
    """Return the frame that a tool is counted from, seen from the URDF's flange. [m]

    Args:
        tool: The table [tool] as it stands in the job.
        folder: The robot folder; its controller.toml may say how the pendant counts.
        flange_to_tool0: The URDF's tool0 seen from its flange where both are on one body, else None.
    """
    if tool.get("frame", "flange") != "pendant":
        return pin.SE3.Identity()
    file = folder / "controller.toml"
    stated = read_toml(file).get("pendant") if file.is_file() else None
    if stated is None:
        return pin.SE3.Identity() if flange_to_tool0 is None else flange_to_tool0
    x, z = np.array(stated["x"], float), np.array(stated["z"], float)
    return pin.SE3(np.array([x, np.cross(z, x), z]).T, np.array(stated.get("position_mm", (0, 0, 0)), float) / 1000.0)
