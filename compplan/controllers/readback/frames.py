"""Frames of a job, tool and part, in every form: the independent check's own reading.

Written from the keys as docs/formats.md states them; it shares nothing with `compplan.job.frames`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from compplan.io.tomlfile import read_toml
from compplan.robot import Array

#: Axes about which each form of angles turns, one after the other, and whether they turn along.
FORMS = {"abc_deg": ("zyx", True), "wpr_deg": ("xyz", False)}


def read_rotation(table: Mapping[str, Any]) -> Array:
    """Return the rotation that a table says. Shape (3, 3)."""
    if table.get("quaternion") is not None:
        w, *rest = np.array(table["quaternion"], float) / np.linalg.norm(table["quaternion"])
        cross = pin.skew(np.array(rest))
        return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)
    for key, (axes, along) in FORMS.items():
        if table.get(key) is not None:
            turns = [_turn(axis, angle) for axis, angle in zip(axes, table[key], strict=True)]
            first, second, third = turns if along else turns[::-1]
            return np.asarray(first @ second @ third)
    return np.asarray(pin.exp3(np.radians(table.get("rotation_deg") or (0.0, 0.0, 0.0))))


def _turn(axis: str, degrees: float) -> Array:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    a, b = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turn = np.eye(3)
    turn[a, a], turn[b, b], turn[b, a], turn[a, b] = c, c, s, -s
    return turn


def read_frame(table: Mapping[str, Any]) -> pin.SE3:
    """Return the frame that a table says by position and rotation. [m]"""
    return pin.SE3(read_rotation(table), np.array(table.get("position_mm") or (0.0, 0.0, 0.0), float) / 1000.0)


def read_part(table: Mapping[str, Any]) -> pin.SE3:
    """Return the part frame seen from the base, stated or from points. [m]"""
    if table.get("points_mm") is not None:
        return _match(np.array(table["points_mm"]["nominal"], float), np.array(table["points_mm"]["measured"], float))
    return read_frame(table)


def _match(nominal: Array, measured: Array) -> pin.SE3:
    """Return the frame that fits points best, by the quaternion of Horn (1987): an eigenvector, no singular values."""
    a, b = nominal - nominal.mean(axis=0), measured - measured.mean(axis=0)
    s = a.T @ b
    delta = np.array([s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]])
    block = np.block([[np.array([[np.trace(s)]]), delta[None]], [delta[:, None], s + s.T - np.trace(s) * np.eye(3)]])
    turn = read_rotation({"quaternion": np.linalg.eigh(block)[1][:, -1]})
    return pin.SE3(turn, (measured.mean(axis=0) - turn @ nominal.mean(axis=0)) / 1000.0)


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
