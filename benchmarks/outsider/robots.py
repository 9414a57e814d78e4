"""What a nominal robot is: elements from base to tip, and springs; and the robot folder that describes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.outsider.turns import AXES, Array, turn_rpy

SizeClass = Literal["cobot", "small", "mid", "heavy", "scara"]
Vector = tuple[float, float, float]

SCALE: Mapping[str, float] = {"cobot": 1.0, "small": 0.8, "mid": 1.6, "heavy": 2.4, "scara": 0.6}
CAPACITY_KG: Mapping[str, float] = {"cobot": 7.0, "small": 6.0, "mid": 25.0, "heavy": 180.0, "scara": 4.0}
BASE, MOUNT, TIP = "base_fixed", "tool_mount", "tool_tip"


@dataclass(frozen=True)
class Element:
    """One joint of the URDF, fixed or moving, with the link behind it."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Array
    axis: Array = field(default_factory=lambda: AXES["z"])
    lower: float = 0.0
    upper: float = 0.0
    velocity: float = 2.0
    effort: float = 100.0
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    rpy: Vector = (0.0, 0.0, 0.0)
    mimic: tuple[str, float] | None = None
    column: int | None = None

    @cached_property
    def turned(self) -> Array:
        """Rotation of the element's origin. Shape (3, 3)."""
        return turn_rpy(self.rpy)

    @property
    def prismatic(self) -> bool:
        """Whether it slides."""
        return self.kind == "prismatic"


@dataclass(frozen=True)
class Spring:
    """An elastic degree of freedom behind a joint's own motion.

    `axis` is "own", one of "rx".."tz" (child axes) or a vector to turn about; `offset` its place in the child frame
    [m]; `law(torque, compliance)` is the deflection, compliance times torque if there is none.
    """

    joint: str
    axis: str | Array
    compliance: float
    offset: Sequence[float] | None = None
    law: Callable[[Array, float], Array] | None = None

    def deflect(self, torque: Array) -> Array:
        """Deflection under a torque or force along the spring. Shape (n,). [rad or m]"""
        return self.law(torque, self.compliance) if self.law else self.compliance * torque


@dataclass(frozen=True)
class Robot:
    """A nominal robot: elements from world to tip, and springs."""

    name: str
    size: SizeClass
    elements: tuple[Element, ...]
    springs: tuple[Spring, ...]
    rail: bool = False

    @cached_property
    def element(self) -> dict[str, Element]:
        """Elements by name."""
        return {e.name: e for e in self.elements}

    @cached_property
    def movers(self) -> list[Element]:
        """Driven elements, one a column of the log."""
        return [e for e in self.elements if e.column is not None]

    @property
    def count(self) -> int:
        """How many joints are driven."""
        return len(self.movers)

    @cached_property
    def prismatic(self) -> Array:
        """Which driven joints slide. Shape (count,)."""
        return np.array([e.prismatic for e in self.movers])

    @cached_property
    def turning(self) -> list[int]:
        """Columns of the driven joints that turn."""
        return [k for k in range(self.count) if not self.prismatic[k]]

    @cached_property
    def own(self) -> dict[str, int]:
        """Place of each joint's spring about its own axis among `springs`."""
        return {s.joint: i for i, s in enumerate(self.springs) if isinstance(s.axis, str) and s.axis == "own"}

    @cached_property
    def first_compliance(self) -> float:
        """Compliance of the first joint that has an own spring. [rad/(N m)]"""
        return next(s.compliance for s in self.springs if isinstance(s.axis, str) and s.axis == "own")

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest joint values. Shape (count,) each. [rad or m]"""
        return np.array([e.lower for e in self.movers]), np.array([e.upper for e in self.movers])

    @cached_property
    def reach(self) -> float:
        """Length of all links behind the first joint. [m]"""
        return sum(float(np.linalg.norm(e.xyz)) for e in self.movers[1:])

    @property
    def tool(self) -> Element:
        """The element that carries the tool's mass."""
        return self.element[MOUNT]

    @property
    def column_1(self) -> int:
        """Column of the joint that turns the whole arm: behind the rail where there is one."""
        return 1 if self.rail else 0

    def across(self, column: int) -> list[str]:
        """Names of the axes across a driven joint's own axis."""
        return [a for a in "xyz" if abs(AXES[a] @ self.movers[column].axis) < 0.5]

    def leaning(self) -> list[int]:
        """Columns of elastic joints that turn about y: those that carry the arm's weight."""
        return [k for k in self.turning if abs(self.movers[k].axis[1]) > 0.9 and joint_name(k) in self.own]


def joint_name(column: int) -> str:
    """Name of the driven joint of a column of the log."""
    return f"joint_{column + 1}"


# ------------------------------------------------------------------------------------------------------ the folder


def write_robot(robot: Robot, out: Path, repeatability_mm: float | None, gravity: bool) -> None:
    """Write the robot folder: robot.urdf and elasticity.toml."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "robot.urdf").write_text(_urdf(robot), encoding="utf-8")
    (out / "elasticity.toml").write_text(_elasticity(robot, repeatability_mm, gravity), encoding="utf-8")


def _numbers(values: Sequence[float] | Array) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def _urdf(robot: Robot) -> str:
    lines = ['<?xml version="1.0"?>', f'<robot name="{robot.name}">', '  <link name="world"/>']
    for e in robot.elements:
        lines.append(_link(e))
        text = f'  <joint name="{e.name}" type="{e.kind}"><parent link="{e.parent}"/><child link="{e.child}"/>'
        text += f'<origin xyz="{_numbers(e.xyz)}" rpy="{_numbers(e.rpy)}"/>'
        if e.kind != "fixed":
            text += f'<axis xyz="{_numbers(e.axis)}"/><limit lower="{e.lower:.9g}" upper="{e.upper:.9g}" '
            text += f'velocity="{e.velocity:.6g}" effort="{e.effort:g}"/>'
        if e.mimic:
            text += f'<mimic joint="{e.mimic[0]}" multiplier="{e.mimic[1]}" offset="0"/>'
        lines.append(text + "</joint>")
    return "\n".join([*lines, "</robot>", ""])


def _link(e: Element) -> str:
    if not e.mass:
        return f'  <link name="{e.child}"/>'
    inertia = max(0.03 * e.mass, 1e-4)
    return (
        f'  <link name="{e.child}"><inertial><origin xyz="{_numbers(e.com)}" rpy="0 0 0"/><mass value="{e.mass:g}"/>'
        f'<inertia ixx="{inertia:g}" ixy="0" ixz="0" iyy="{inertia:g}" iyz="0" izz="{inertia:g}"/></inertial></link>'
    )


def _elasticity(robot: Robot, repeatability_mm: float | None, gravity: bool) -> str:
    lines = ["schema = 1", 'tcp = "tool0"', f'flange = "{robot.tool.parent}"']
    if repeatability_mm:
        lines.append(f"repeatability_mm = {repeatability_mm:.4g}")
    if gravity:
        lines.append("gravity = [0.0, 0.0, -9.81]")
    sources = 'compliance = "assumed", geometry = "datasheet, from memory (assumed)", masses = "assumed"'
    lines.append(f"sources = {{ {sources} }}")
    for s in robot.springs:
        lines += ["", "[[spring]]", f'joint = "{s.joint}"', f'axis = "{s.axis}"', f"compliance = {s.compliance:.9g}"]
        if s.axis != "own":
            lines.append("actuator = false")
    return "\n".join(lines) + "\n"
