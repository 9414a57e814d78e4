"""Joints and limits of a robot folder, read a second time from its text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from compplan.io.tables import read_text
from compplan.io.tomlfile import read_toml
from compplan.io.xmlfile import parse_xml
from compplan.robot import Array


@dataclass(frozen=True)
class JointTable:
    """The joints that a controller commands, from the base out. SI units.

    Attributes:
        names: Names. nq of them.
        slides: Whether they are prismatic. Shape (nq,).
        outer: Whether they are external axes: those that slide, or carry the part. Shape (nq,).
        lower, upper, velocity, acceleration, jerk: Limits, infinite where none is stated. Shape (nq,).
    """

    names: tuple[str, ...]
    slides: tuple[bool, ...]
    outer: tuple[bool, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array


def read_joints(folder: Path) -> JointTable:
    """Read the joints of a robot folder."""
    table = read_toml(folder / "elasticity.toml")
    root = parse_xml(read_text(folder / "robot.urdf"), folder / "robot.urdf")
    carrier = {}
    for joint in root.findall("joint"):
        child = joint.find("child")
        carrier["" if child is None else child.get("link", "")] = joint
    carrying = _list_moving(carrier, str(table.get("part", "")))
    chain = [*carrying, *_list_moving(carrier, str(table["tcp"]))]
    limits = []
    for joint in chain:
        found, soft = joint.find("limit"), joint.find("safety_controller")
        stated, inner = ({} if tag is None else tag.attrib for tag in (found, soft))
        low = max(float(stated.get("lower", "0")), float(inner.get("soft_lower_limit", "-inf")))
        high = min(float(stated.get("upper", "0")), float(inner.get("soft_upper_limit", "inf")))
        bounds = (-math.inf, math.inf) if joint.get("type") == "continuous" else (low, high)
        limits.append((*bounds, float(stated.get("velocity", "0")) or math.inf))
    lower, upper, velocity = np.array(limits, dtype=float).T
    none = [math.inf] * len(chain)
    acceleration, jerk = (np.array(table.get(f"{name}_limits", none), float) for name in ("acceleration", "jerk"))
    slides = tuple(joint.get("type") == "prismatic" for joint in chain)
    names = tuple(joint.get("name", "") for joint in chain)
    outer = tuple(slide or k < len(carrying) for k, slide in enumerate(slides))
    return JointTable(names, slides, outer, lower, upper, velocity, acceleration, jerk)


def _list_moving(carrier: Mapping[str, ElementTree.Element], link: str) -> list[ElementTree.Element]:
    """List the joints of their own motion from the root to a link."""
    chain: list[ElementTree.Element] = []
    while link in carrier:
        joint = carrier[link]
        if joint.get("type") != "fixed" and joint.find("mimic") is None:
            chain.append(joint)
        parent = joint.find("parent")
        link = "" if parent is None else parent.get("link", "")
    return chain[::-1]
