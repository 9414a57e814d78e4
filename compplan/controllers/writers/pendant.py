"""How a teach pendant counts tools: the maker's flange frame, seen from the flange of the URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import model_validator

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable, Vector3, check_table, read_toml
from compplan.robot import Robot
from compplan.robot.urdf import Urdf, read_urdf

#: Greatest departure from length 1 and from a right angle that is taken for rounding.
ROUNDING = 1e-6
#: A frame tool0 farther from the flange is a tool, not the flange. [m]
SAME_PLACE = 1e-9


class PendantTable(StrictTable):
    """[pendant] of controller.toml: the maker's flange frame (tool 0, all zero), axes of the URDF's flange frame.

    x, z: where its x and z point.
    confirmed: whether a public source says so of the pendant itself, x included.
    source: who says so.
    """

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    x: Vector3
    z: Vector3
    confirmed: bool = False
    source: str = ""

    @model_validator(mode="after")
    def _check_axes(self) -> PendantTable:
        for name, axis in (("x", self.x), ("z", self.z)):
            if abs(np.linalg.norm(axis) - 1.0) > ROUNDING:
                raise ValueError(f"has {name} = {list(axis)} of length {np.linalg.norm(axis):.6g}, expected 1")
        if abs(np.dot(self.x, self.z)) > ROUNDING:
            raise ValueError(f"has x = {list(self.x)} and z = {list(self.z)}, expected a right angle between them")
        return self


@dataclass(frozen=True)
class Pendant:
    """Hold the maker's flange frame."""

    pose: Array  #: Pose of it seen from the URDF's flange frame. Shape (4, 4). [m]
    source: str  #: Who says so.
    confirmed: bool  #: Whether that is said of the pendant itself.
    stated: bool  #: Whether controller.toml says it; else it is the URDF's own tool0.


def read_pendant(table: PendantTable) -> Pendant:
    """Return the frame that a table [pendant] states."""
    pose, x, z = np.eye(4), np.asarray(table.x), np.asarray(table.z)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = np.asarray(table.position_mm) * 1e-3
    return Pendant(pose, table.source, table.confirmed, stated=True)


def locate_pendant(robot: Robot) -> Pendant | None:
    """Return the maker's flange frame of a robot: as controller.toml states it, else tool0 of a ROS-Industrial URDF.

    Raises:
        InputError: If [pendant] of controller.toml is not what it has to be.
    """
    file = None if robot.folder is None else robot.folder / "controller.toml"
    if file is not None and file.exists():
        table = read_toml(file).get("pendant")
        if table is not None:
            if not isinstance(table, dict):
                raise InputError(f"is {table!r}, expected a table", file=file, where="pendant")
            return read_pendant(check_table(PendantTable, table, file=file, key="pendant"))
    turn = find_tool0(robot)
    source = "tool0 of the URDF, the all-zero tool in descriptions of ROS-Industrial"
    return None if turn is None else Pendant(turn, source, confirmed=False, stated=False)


def find_tool0(robot: Robot) -> Array | None:
    """Return the pose of a frame tool0 that stands where the flange stands, seen from it, or None. Shape (4, 4)."""
    urdf = read_urdf(robot.urdf, Path("robot.urdf") if robot.folder is None else robot.folder / "robot.urdf")
    if "tool0" not in urdf.links or robot.flange not in urdf.links:
        return None
    try:
        tails = [_fixed_tail(urdf, link) for link in (robot.flange, "tool0")]
    except InputError:
        return None
    (carrier, flange), (other, tool) = tails
    if carrier != other:
        return None
    turn = np.linalg.inv(flange) @ tool
    if np.abs(turn[:3, 3]).max() > SAME_PLACE:
        return None
    turn[:3, 3] = 0.0
    return np.asarray(turn)


def _fixed_tail(urdf: Urdf, link: str) -> tuple[str, Array]:
    """Return the last moving joint before a link, and the link's pose seen from that joint's child."""
    carrier, pose = "", np.eye(4)
    for joint in urdf.chain_to(link)[0]:
        carrier, pose = (carrier, pose @ joint.placement) if joint.kind == "fixed" else (joint.name, np.eye(4))
    return carrier, pose
