"""The robot of a campaign: chain of URDF joints, link masses and springs, read by a parser of its own.

Nothing here comes from the product: campaigns have to be a second, independent statement of what a robot does.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPRING_AXES = {
    "tx": (0, (1.0, 0.0, 0.0)),
    "ty": (0, (0.0, 1.0, 0.0)),
    "tz": (0, (0.0, 0.0, 1.0)),
    "rx": (1, (1.0, 0.0, 0.0)),
    "ry": (1, (0.0, 1.0, 0.0)),
    "rz": (1, (0.0, 0.0, 1.0)),
}


@dataclass(frozen=True)
class Segment:
    """One URDF joint with the link that it carries."""

    joint: str  #: Name of the joint.
    kind: str  #: "revolute", "prismatic" or "fixed".
    child: str  #: Name of the link that the joint carries.
    xyz: tuple[float, float, float]  #: Origin of the joint frame in the parent link. Shape (3,). [m]
    #: Roll, pitch, yaw of the joint frame in the parent link. Shape (3,). [rad]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)  #: Unit axis of the joint, joint frame. Shape (3,).
    lower: float = 0.0  #: Lower position limit. [rad or m]
    upper: float = 0.0  #: Upper position limit. [rad or m]
    velocity: float = 1.0  #: Velocity limit. [rad/s or m/s]
    effort: float = 0.0  #: Effort limit. [N m or N]
    mass: float = 0.0  #: Mass of the child link. [kg]
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Centre of mass of the child link, child frame. Shape (3,). [m]
    #: Joint that this one follows, multiplier and offset; None for a joint of its own.
    mimic: tuple[str, float, float] | None = None

    @property
    def moves(self) -> bool:
        """Tell whether the joint moves, by a motor or by following another joint."""
        return self.kind != "fixed"

    @property
    def actuated(self) -> bool:
        """Tell whether a motor moves the joint."""
        return self.moves and self.mimic is None


@dataclass(frozen=True)
class Spring:
    """One elastic degree of freedom, in the child frame of a joint after the joint's own motion."""

    joint: str  #: Name of the URDF joint.
    axis: str  #: "own" or tx ty tz rx ry rz of the child frame.
    compliance: float  #: rad/(N m), or m/N along an axis.
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Origin of the spring in the child frame. Shape (3,). [m]
    actuator: bool = False  #: Whether it lies between motor-side and link-side encoder.
    #: Unit axis in the child frame where it is none of those that `axis` can name (which then only tells turning from
    #: sliding); no robot folder can state such a spring. Shape (3,).
    direction: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class RobotDescription:
    """A robot as its folder states it."""

    name: str  #: Name of the robot.
    segments: tuple[Segment, ...]  #: Joints from the root of the URDF to the TCP frame.
    springs: tuple[Spring, ...]  #: Elastic degrees of freedom in the order listed.
    #: Gravity in the base frame, or None if the model takes no gravity load. Shape (3,). [m/s^2]
    gravity: tuple[float, float, float] | None
    tcp: str = "tool0"  #: Name of the link whose frame is the TCP.
    repeatability_mm: float | None = None  #: Stated repeatability, one standard deviation, or None.

    @property
    def actuated(self) -> list[int]:
        """Indices of the segments that a motor moves."""
        return [i for i, s in enumerate(self.segments) if s.actuated]

    @property
    def joint_names(self) -> list[str]:
        """Names of the actuated joints, base first."""
        return [s.joint for s in self.segments if s.actuated]

    def index_of(self, joint: str) -> int:
        """Return the segment index of a joint name."""
        return [s.joint for s in self.segments].index(joint)

    def with_segment(self, index: int, **changes: Any) -> RobotDescription:
        """Return a copy in which one segment differs."""
        segments = list(self.segments)
        segments[index] = replace(segments[index], **changes)
        return replace(self, segments=tuple(segments))


def rotation_from_rpy(rpy: tuple[float, float, float]) -> Array:
    """Return the rotation matrix of URDF's fixed-axis roll, pitch, yaw. Shape (3, 3)."""
    cr, cp, cy = np.cos(rpy)
    sr, sp, sy = np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a rotation matrix, also where pitch is a right angle."""
    pitch = float(np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0])))
    if abs(np.cos(pitch)) < 1e-9:
        return float(np.arctan2(-rotation[1, 2], rotation[1, 1])), pitch, 0.0
    roll = float(np.arctan2(rotation[2, 1], rotation[2, 2]))
    return roll, pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def _triple(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    if text is None:
        return default
    x, y, z = (float(v) for v in text.split())
    return x, y, z


def _read_segment(joint: ET.Element, links: dict[str, ET.Element]) -> Segment:
    child = joint.find("child").get("link")  # type: ignore[union-attr]
    origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
    zero = (0.0, 0.0, 0.0)
    kind = joint.get("type", "fixed")
    numbers: dict[str, float] = {}
    if limit is not None:
        for key in ("lower", "upper", "velocity", "effort"):
            numbers[key] = float(limit.get(key, "0"))
    mass, com = 0.0, zero
    inertial = links[str(child)].find("inertial")
    if inertial is not None:
        mass = float(inertial.find("mass").get("value", "0"))  # type: ignore[union-attr]
        at = inertial.find("origin")
        com = _triple(None if at is None else at.get("xyz"), zero)
    follows = joint.find("mimic")
    mimic = None
    if follows is not None:
        mimic = (
            str(follows.get("joint")),
            float(follows.get("multiplier", "1")),
            float(follows.get("offset", "0")),
        )
    direction = np.array(_triple(None if axis is None else axis.get("xyz"), (1.0, 0.0, 0.0)))
    direction = direction / np.linalg.norm(direction)
    return Segment(
        joint=str(joint.get("name")),
        kind="revolute" if kind == "continuous" else kind,
        child=str(child),
        xyz=_triple(None if origin is None else origin.get("xyz"), zero),
        rpy=_triple(None if origin is None else origin.get("rpy"), zero),
        axis=(float(direction[0]), float(direction[1]), float(direction[2])),
        mass=mass,
        com=com,
        mimic=mimic,
        **numbers,
    )


def read_description(folder: str | Path) -> RobotDescription:
    """Read robot.urdf and elasticity.toml of a robot folder.

    Args:
        folder: The robot folder.
    """
    folder = Path(folder)
    root = ET.parse(folder / "robot.urdf").getroot()
    elastic = tomllib.loads((folder / "elasticity.toml").read_text(encoding="utf-8"))
    links = {str(link.get("name")): link for link in root.findall("link")}
    by_child = {str(j.find("child").get("link")): j for j in root.findall("joint")}  # type: ignore[union-attr]
    chain: list[Segment] = []
    link = str(elastic["tcp"])
    while link in by_child:
        joint = by_child[link]
        chain.append(_read_segment(joint, links))
        link = str(joint.find("parent").get("link"))  # type: ignore[union-attr]
    springs = []
    for entry in elastic.get("spring", []):
        offset = entry.get("offset", [0.0, 0.0, 0.0])
        springs.append(
            Spring(
                joint=entry["joint"],
                axis=entry["axis"],
                compliance=float(entry["compliance"]),
                offset=(float(offset[0]), float(offset[1]), float(offset[2])),
                actuator=bool(entry.get("actuator", entry["axis"] == "own")),
            )
        )
    gravity = elastic.get("gravity")
    return RobotDescription(
        name=str(root.get("name")),
        segments=tuple(reversed(chain)),
        springs=tuple(springs),
        gravity=None if gravity is None else (float(gravity[0]), float(gravity[1]), float(gravity[2])),
        tcp=str(elastic["tcp"]),
        repeatability_mm=elastic.get("repeatability_mm"),
    )


def is_own_axis(description: RobotDescription, spring: Spring) -> bool:
    """Tell whether a spring acts about (or along) its joint's own axis, however its axis is written."""
    if spring.direction is not None:
        return False
    if spring.axis == "own":
        return True
    segment = description.segments[description.index_of(spring.joint)]
    kind, direction = SPRING_AXES[spring.axis]
    same_kind = (kind == 1) == (segment.kind == "revolute")
    return segment.actuated and same_kind and abs(float(np.dot(direction, segment.axis))) > 1.0 - 1e-9


def write_robot_folder(description: RobotDescription, folder: Path, sources: dict[str, str]) -> None:
    """Write robot.urdf and elasticity.toml of a description.

    Args:
        description: The robot.
        folder: Folder to write to; made if it is missing.
        sources: Where compliance, geometry and masses come from.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = ['<?xml version="1.0"?>', f'<robot name="{description.name}">', '  <link name="world"/>']
    parent = "world"
    for s in description.segments:
        if s.mass > 0.0:
            i = 0.03 * s.mass
            lines.append(
                f'  <link name="{s.child}"><inertial><origin xyz="{_text(s.com)}" rpy="0 0 0"/>'
                f'<mass value="{s.mass:.10g}"/>'
                f'<inertia ixx="{i:.6g}" ixy="0" ixz="0" iyy="{i:.6g}" iyz="0" izz="{i:.6g}"/></inertial></link>'
            )
        else:
            lines.append(f'  <link name="{s.child}"/>')
        row = (
            f'  <joint name="{s.joint}" type="{s.kind}"><parent link="{parent}"/><child link="{s.child}"/>'
            f'<origin xyz="{_text(s.xyz)}" rpy="{_text(s.rpy)}"/>'
        )
        if s.moves:
            row += (
                f'<axis xyz="{_text(s.axis)}"/><limit lower="{s.lower:.8f}" upper="{s.upper:.8f}" '
                f'velocity="{s.velocity:.6f}" effort="{s.effort:.10g}"/>'
            )
        if s.mimic is not None:
            leader, multiplier, offset = s.mimic
            row += f'<mimic joint="{leader}" multiplier="{multiplier:.10g}" offset="{offset:.10g}"/>'
        lines.append(row + "</joint>")
        parent = s.child
    lines.append("</robot>")
    (folder / "robot.urdf").write_text("\n".join(lines) + "\n", encoding="utf-8")
    toml = ["schema = 1", f'tcp = "{description.tcp}"']
    if description.repeatability_mm is not None:
        toml.append(f"repeatability_mm = {description.repeatability_mm:.4g}")
    if description.gravity is not None:
        toml.append("gravity = [" + ", ".join(f"{v:g}" for v in description.gravity) + "]")
    toml.append("sources = { " + ", ".join(f'{k} = "{v}"' for k, v in sources.items()) + " }")
    for spring in description.springs:
        toml += ["", "[[spring]]", f'joint = "{spring.joint}"', f'axis = "{spring.axis}"']
        toml.append(f"compliance = {spring.compliance:.10g}")
        if any(spring.offset):
            toml.append("offset = [" + ", ".join(f"{v:g}" for v in spring.offset) + "]")
        if spring.actuator != (spring.axis == "own"):
            toml.append(f"actuator = {'true' if spring.actuator else 'false'}")
    (folder / "elasticity.toml").write_text("\n".join(toml) + "\n", encoding="utf-8")


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{v:.10g}" for v in values)
