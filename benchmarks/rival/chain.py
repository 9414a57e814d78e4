"""A robot folder as a serial chain of small motions: poses, loads, and where each moves the tool centre point."""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
#: Steps of the fixed point between load and deflection.
STEPS = 4


@dataclass(frozen=True, eq=False)
class Spring:
    """One elastic degree of freedom in a child frame."""

    axis: Array  #: Its direction in that frame. Shape (3,).
    turns: bool  #: Whether it turns (else it slides).
    own: bool  #: Whether it bends about the joint's own axis.
    compliance: float  #: [rad/(N m) or m/N]
    offset: Array  #: Where it sits in that frame. Shape (3,). [m]


@dataclass(frozen=True, eq=False)
class Segment:
    """A URDF joint and the link behind it."""

    name: str  #: Name of the joint.
    place: Array  #: Origin in the parent link. [m]
    turn: Array  #: Rotation of the origin.
    axis: Array  #: Axis of motion in the child frame.
    kind: str  #: fixed, revolute or prismatic.
    reading: int  #: Number of the reading that moves it, -1 for none.
    gain: float  #: Multiplier of that reading (1, or a mimic's).
    zero: float  #: Offset of that reading.
    mass: float  #: Mass of the link. [kg]
    centre: Array  #: Its centre of mass. [m]
    springs: tuple[Spring, ...]  #: What bends behind the joint.


@dataclass(frozen=True, eq=False)
class Chain:
    """A nominal robot."""

    segments: tuple[Segment, ...]  #: From the base to the tool centre point.
    joints: tuple[str, ...]  #: Names of the joints that have a reading.
    gravity: Array  #: What the folder says. Shape (3,). [m/s^2]
    has_gravity: bool  #: Whether the folder says it.
    repeatability: float  #: One standard deviation, 0 where nothing is stated. [m]
    tcp: str  #: Frame of the tool centre point.

    def slides(self, joint: int) -> bool:
        """Tell whether a reading is a length."""
        return next(s for s in self.segments if s.name == self.joints[joint]).kind == "prismatic"


@dataclass(frozen=True, eq=False)
class Posed:
    """The chain at n rows, in base axes: for every segment, and for every spring of every segment."""

    parent: list[Array]  #: Axes of the parent link. Each (n, 3, 3).
    origin: list[Array]  #: Where the joint sits. Each (n, 3). [m]
    child: list[Array]  #: Axes behind the joint. Each (n, 3, 3).
    axis: list[Array]  #: Axis of motion. Each (n, 3).
    springs: list[list[tuple[Array, Array]]]  #: Direction and place of each spring, a list a segment.
    force: list[Array]  #: Force of everything beyond a segment. Each (n, 3). [N]
    moment: list[Array]  #: Its moment about the base origin. Each (n, 3). [N m]
    centres: list[Array]  #: Centre of mass of each link. Each (n, 3). [m]
    tip: Array  #: Tool centre point. Shape (n, 3). [m]
    attitude: Array  #: Its axes. Shape (n, 3, 3).
    theta: Array  #: Deflections in the order of the segments. Shape (n, m).


def read_chain(folder: Path) -> Chain:
    """Read robot.urdf and elasticity.toml of a robot folder."""
    table = tomllib.loads((folder / "elasticity.toml").read_text(encoding="utf-8"))
    root = ElementTree.parse(folder / "robot.urdf").getroot()
    links = {e.attrib["name"]: e for e in root.findall("link")}
    behind = {_child(e): e for e in root.findall("joint")}
    tcp = str(table["tcp"])
    path, link = [], tcp
    while link in behind:
        path.append(behind[link])
        link = behind[link].find("parent").attrib["link"]  # type: ignore[union-attr]
    path.reverse()
    movable = [e for e in path if e.attrib["type"] != "fixed" and e.find("mimic") is None]
    names = tuple(e.attrib["name"] for e in movable)
    springs = table.get("spring", [])
    segments = tuple(_segment(e, links[_child(e)], names, springs) for e in path)
    gravity = np.array(table.get("gravity", [0.0, 0.0, -9.81]), float)
    return Chain(segments, names, gravity, "gravity" in table, 1e-3 * float(table.get("repeatability_mm", 0.0)), tcp)


def _child(joint: ElementTree.Element) -> str:
    return joint.find("child").attrib["link"]  # type: ignore[union-attr]


def _vector(element: ElementTree.Element | None, key: str, default: str = "0 0 0") -> Array:
    return np.array((default if element is None else element.attrib.get(key, default)).split(), float)


def _segment(
    joint: ElementTree.Element, link: ElementTree.Element, names: tuple[str, ...], springs: list[dict[str, Any]]
) -> Segment:
    name, mimic, origin = joint.attrib["name"], joint.find("mimic"), joint.find("origin")
    kind = {"fixed": "fixed", "prismatic": "prismatic"}.get(joint.attrib["type"], "revolute")
    axis = _vector(joint.find("axis"), "xyz", "1 0 0")
    axis = axis / np.linalg.norm(axis)
    reading, gain, zero = (names.index(name) if name in names else -1), 1.0, 0.0
    if mimic is not None:
        reading = names.index(mimic.attrib["joint"])
        gain, zero = float(mimic.attrib.get("multiplier", 1.0)), float(mimic.attrib.get("offset", 0.0))
    inertial, mass, centre = link.find("inertial"), 0.0, np.zeros(3)
    if inertial is not None and inertial.find("mass") is not None:
        mass = float(inertial.find("mass").attrib["value"])  # type: ignore[union-attr]
        centre = _vector(inertial.find("origin"), "xyz")
    own = tuple(_spring(s, axis, kind) for s in springs if s["joint"] == name)
    turn = Rotation.from_euler("xyz", _vector(origin, "rpy")).as_matrix()
    return Segment(name, _vector(origin, "xyz"), turn, axis, kind, reading, gain, zero, mass, centre, own)


def _spring(entry: dict[str, Any], axis: Array, kind: str) -> Spring:
    offset = np.array(entry.get("offset", [0.0, 0.0, 0.0]), float)
    if entry["axis"] == "own":
        return Spring(axis, kind != "prismatic", True, float(entry["compliance"]), offset)
    direction, turns = np.eye(3)["xyz".index(entry["axis"][1])], entry["axis"][0] == "r"
    own = turns == (kind == "revolute") and abs(float(direction @ axis)) > 0.999
    return Spring(direction, turns, own and kind != "fixed", float(entry["compliance"]), offset)


def rotate(axis: Array, angle: Array) -> Array:
    """Turn about a fixed axis by an angle a row [Rodrigues]. Shape (n, 3, 3)."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * k + (1.0 - np.cos(angle))[:, None, None] * (k @ k)


def dot(a: Array, b: Array) -> Array:
    """Return the dot product row by row. Shape (n, 1)."""
    return np.asarray(np.sum(a * b, axis=1, keepdims=True))


def load_chain(chain: Chain, q: Array, wrench: Array, gravity: Array) -> Posed:
    """Pose the loaded chain: deflections theta = C tau(theta), found as a fixed point.

    Args:
        chain: The robot.
        q: Readings. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
        gravity: Base axes. Shape (3,). [m/s^2]
    """
    springs = [s for segment in chain.segments for s in segment.springs]
    theta = np.zeros((len(q), len(springs)))
    posed = _pose(chain, q, theta, wrench, gravity)
    for _ in range(STEPS if springs else 0):
        torque = [
            spring_torque(posed, s, k)
            for s, segment in enumerate(chain.segments)
            for k in range(len(segment.springs))
        ]  # fmt: skip
        bent = np.hstack(torque) * np.array([s.compliance for s in springs])
        posed = _pose(chain, q, bent, wrench, gravity)
    return posed


def spring_torque(posed: Posed, segment: int, spring: int) -> Array:
    """Return what a spring carries. Shape (n, 1). [N m or N]"""
    axis, place = posed.springs[segment][spring]
    force, moment = posed.force[segment], posed.moment[segment]
    return dot(axis, moment - np.cross(place, force)) if np.isfinite(place).all() else dot(axis, force)


def _pose(chain: Chain, q: Array, theta: Array, wrench: Array, gravity: Array) -> Posed:
    n, k = len(q), 0
    axes, point = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    parent, origin, child, axis, springs, centres = [], [], [], [], [], []
    for s in chain.segments:
        parent.append(axes)
        point = point + axes @ s.place
        origin.append(point)
        axes = axes @ s.turn
        axis.append(axes @ s.axis)
        value = s.gain * q[:, s.reading] + s.zero if s.reading >= 0 else np.zeros(n)
        if s.kind == "revolute":
            axes = axes @ rotate(s.axis, value)
        elif s.kind == "prismatic":
            point = point + axis[-1] * value[:, None]
        child.append(axes)
        here = []
        for spring in s.springs:
            direction, place = axes @ spring.axis, point + axes @ spring.offset
            here.append((direction, place if spring.turns else np.full((n, 3), np.inf)))
            if spring.turns:
                turned = axes @ rotate(spring.axis, theta[:, k])
                point = place - turned @ spring.offset
                axes = turned
            else:
                point = point + direction * theta[:, k : k + 1]
            k += 1
        springs.append(here)
        centres.append(point + axes @ s.centre)
    force, moment = wrench[:, :3], wrench[:, 3:] + np.cross(point, wrench[:, :3])
    forces, moments = [], []
    for s, centre in zip(reversed(chain.segments), reversed(centres), strict=True):
        weight = s.mass * gravity
        force, moment = force + weight, moment + np.cross(centre, weight)
        forces.append(force)
        moments.append(moment)
    return Posed(
        parent, origin, child, axis, springs, forces[::-1], moments[::-1], centres, point, np.array(axes), theta
    )  # fmt: skip
