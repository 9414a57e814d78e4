"""Read a robot folder: links, joints and masses of the URDF, springs of elasticity.toml; mount a job's tool."""

from __future__ import annotations

import itertools
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STANDARD_GRAVITY = np.array([0.0, 0.0, -9.81])
UNIT = {"x": np.array([1.0, 0, 0]), "y": np.array([0, 1.0, 0]), "z": np.array([0, 0, 1.0])}


@dataclass(frozen=True)
class Joint:
    """A URDF joint on the way from base to TCP; `follows` is (driver, multiplier, offset) of a mimic joint."""

    name: str
    kind: str
    parent: str
    child: str
    pose: Array
    axis: Array
    lower: float
    upper: float
    velocity: float
    effort: float
    follows: tuple[str, float, float] | None

    @property
    def slides(self) -> bool:
        return self.kind == "prismatic"

    @property
    def commanded(self) -> bool:
        return self.kind != "fixed" and self.follows is None


@dataclass(frozen=True)
class Spring:
    """One elastic motion about (or along) an axis of the child frame, through `offset`."""

    axis: Array
    slides: bool
    compliance: float
    offset: Array


@dataclass(frozen=True)
class Mass:
    """Mass that moves with a link: centre and inertia about it, link axes."""

    link: str
    mass: float
    centre: Array
    inertia: Array


@dataclass(frozen=True)
class Arm:
    """A robot with its tool; `weights` are masses whose weight loads the springs though the folder has no gravity."""

    name: str
    base: str
    joints: tuple[Joint, ...]
    springs: dict[str, list[Spring]]
    elasticities: dict[str, list[Array]]
    masses: tuple[Mass, ...]
    gravity: Array | None
    acceleration: Array
    flange: str
    weights: tuple[Mass, ...] = field(default=())
    tool: Array | None = None
    pendant: Array | None = None

    @property
    def commanded(self) -> tuple[Joint, ...]:
        return tuple(joint for joint in self.joints if joint.commanded)


def read_arm(folder: Path) -> Arm:
    """Read a robot folder."""
    root = ElementTree.parse(folder / "robot.urdf").getroot()
    table = tomllib.loads((folder / "elasticity.toml").read_text(encoding="utf-8"))
    everything = {element.find("child").get("link"): _joint(element) for element in root.findall("joint")}
    chain, link = [], table["tcp"]
    while link in everything:
        chain.append(everything[link])
        link = everything[link].parent
    chain.reverse()
    by_name = {joint.name: joint for joint in chain}
    links = [link, *(joint.child for joint in chain)]
    springs: dict[str, list[Spring]] = {}
    for entry in table.get("spring", []):
        springs.setdefault(entry["joint"], []).append(_spring(entry, by_name[entry["joint"]]))
    elasticities: dict[str, list[Array]] = {}
    for entry in table.get("link", []):
        matrix = beam(**entry["beam"]) if "beam" in entry else np.array(entry["compliance"], float)
        elasticities.setdefault(entry["link"], []).append(matrix)
    gravity = table.get("gravity")
    count = sum(joint.commanded for joint in chain)
    return Arm(
        name=folder.name,
        base=link,
        joints=tuple(chain),
        springs=springs,
        elasticities=elasticities,
        masses=tuple(_masses(root, everything, links)),
        gravity=None if gravity is None else np.array(gravity, float),
        acceleration=np.array(table.get("acceleration_limits", [np.inf] * count), float),
        flange=table.get("flange", chain[-1].parent if chain[-1].kind == "fixed" else chain[-1].child),
        pendant=_pendant(folder / "controller.toml"),
    )


def _pendant(file: Path) -> Array | None:
    """Return the maker's flange frame that controller.toml states, seen from the URDF's flange."""
    table = tomllib.loads(file.read_text(encoding="utf-8")).get("pendant") if file.is_file() else None
    if table is None:
        return None
    x, z = np.array(table["x"], float), np.array(table["z"], float)
    return pose_of(np.column_stack([x, np.cross(z, x), z]), np.array(table.get("position_mm", [0, 0, 0]), float) * 1e-3)


def said_rotation(table: dict) -> Array:
    """Return the rotation that a table [tool] or [part] says in one of its forms."""

    def about(axis: str, degrees: float) -> Array:
        return rotation_vector(np.radians(degrees) * UNIT[axis])

    def product(axes: str, angles: list[float]) -> Array:
        first, second, third = (about(axis, angle) for axis, angle in zip(axes, angles, strict=True))
        return first @ second @ third

    if "abc_deg" in table:
        return product("zyx", table["abc_deg"])
    if "wpr_deg" in table:
        return product("zyx", table["wpr_deg"][::-1])
    if "quaternion" in table:
        w, *v = np.array(table["quaternion"], float) / np.linalg.norm(table["quaternion"])
        size = np.linalg.norm(v)
        return rotation_vector(np.array(v) / max(size, 1e-300) * 2.0 * np.arctan2(size, w))
    return rotation_vector(np.radians(table.get("rotation_deg", [0, 0, 0])))


def mount_tool(arm: Arm, tool: dict | None) -> Arm:
    """Put a job's [tool] in the place of all that the folder hangs on the flange.

    Where the folder has no gravity, the springs were identified under the folder's own tool: the difference between
    both weights bends the arm.
    """
    if tool is None:
        return arm
    at = next((k for k, joint in enumerate(arm.joints) if joint.parent == arm.flange), len(arm.joints))
    kept, gone = arm.joints[:at], arm.joints[at:]
    counted = np.eye(4) if tool.get("frame") != "pendant" or arm.pendant is None else arm.pendant
    pose = counted @ pose_of(said_rotation(tool), np.array(tool.get("position_mm", [0, 0, 0]), float) * 1e-3)
    links = {arm.base, *(joint.child for joint in kept)}
    last = Joint("tool", "fixed", arm.flange, "tool_tip", pose, UNIT["z"], -np.inf, np.inf, np.inf, np.inf, None)
    kilos, centre = tool.get("mass_kg", 0.0), np.array([*tool.get("centre_of_mass_mm", [0, 0, 0]), 1e3]) * 1e-3
    centre = (counted @ centre)[:3]
    new = (Mass(arm.flange, kilos, centre, 1e-4 * kilos * np.eye(3)),) if kilos else ()
    old, place = [], {arm.flange: np.eye(4)}
    for joint in gone:  # what hung on the flange, seen from the flange
        place[joint.child] = place[joint.parent] @ joint.pose
    for mass in arm.masses:
        if mass.link in place:
            centre = place[mass.link][:3, :3] @ mass.centre + place[mass.link][:3, 3]
            old.append(replace(mass, link=arm.flange, mass=-mass.mass, centre=centre))
    return replace(
        arm,
        joints=(*kept, last),
        masses=(*(m for m in arm.masses if m.link in links and m.link != arm.flange), *new),
        springs={name: s for name, s in arm.springs.items() if name in {joint.name for joint in kept}},
        elasticities={name: e for name, e in arm.elasticities.items() if name in links and name != arm.flange},
        weights=(*new, *old) if arm.gravity is None and "mass_kg" in tool else (),
        tool=pose,
    )


def beam(
    length: float, outer_diameter: float, inner_diameter: float, young: float, shear: float, axis: str = "z"
) -> Array:
    """Return the tip compliance of a clamped tube that runs along an axis of its tip frame. Shape (6, 6)."""
    along = UNIT[axis[-1]] * (-1.0 if axis[0] == "-" else 1.0)
    area = np.pi * (outer_diameter**2 - inner_diameter**2) / 4
    second = np.pi * (outer_diameter**4 - inner_diameter**4) / 64
    lengthwise = np.outer(along, along)
    across = np.eye(3) - lengthwise
    cross = np.array([[0, -along[2], along[1]], [along[2], 0, -along[0]], [-along[1], along[0], 0]])
    # a force f turns the tip by L^2/(2EI) (along x f); a moment m moves it by L^2/(2EI) (m x along)
    couple = length**2 / (2 * young * second) * cross
    move = length**3 / (3 * young * second) * across + length / (young * area) * lengthwise
    turn = length / (young * second) * across + length / (shear * 2 * second) * lengthwise
    return np.block([[move, couple.T], [couple, turn]])


def rotation_vector(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-300:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def pose_of(rotation: Array, position: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def _origin(element: ElementTree.Element | None) -> Array:
    text = {} if element is None else element.attrib
    roll, pitch, yaw = _numbers(text.get("rpy", "0 0 0"))
    turn = rotation_vector(yaw * UNIT["z"]) @ rotation_vector(pitch * UNIT["y"]) @ rotation_vector(roll * UNIT["x"])
    return pose_of(turn, _numbers(text.get("xyz", "0 0 0")))


def _numbers(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


def _joint(element: ElementTree.Element) -> Joint:
    kind, limit, mimic = element.get("type"), element.find("limit"), element.find("mimic")
    axis = element.find("axis")
    direction = _numbers(axis.get("xyz")) if axis is not None else UNIT["x"]
    bounds = {} if limit is None or kind == "fixed" else {key: float(value) for key, value in limit.attrib.items()}
    endless = kind == "continuous"
    follows = None
    if mimic is not None:
        follows = mimic.get("joint"), float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
    return Joint(
        element.get("name"),
        "revolute" if endless else kind,
        element.find("parent").get("link"),
        element.find("child").get("link"),
        _origin(element.find("origin")),
        direction / np.linalg.norm(direction),
        -np.inf if endless else bounds.get("lower", -np.inf),
        np.inf if endless else bounds.get("upper", np.inf),
        bounds.get("velocity", np.inf),
        bounds.get("effort", np.inf),
        follows,
    )


def _spring(entry: dict, joint: Joint) -> Spring:
    kind = entry.get("axis", "own")
    offset = np.array(entry.get("offset", [0, 0, 0]), float)
    if kind == "own":
        return Spring(joint.axis, joint.slides, entry["compliance"], offset)
    return Spring(UNIT[kind[1]], kind[0] == "t", entry["compliance"], offset)


def _masses(root: ElementTree.Element, joints: dict[str, Joint], links: list[str]) -> list[Mass]:
    found = []
    for element in root.findall("link"):
        inertial = element.find("inertial")
        if inertial is None:
            continue
        link, pose = element.get("name"), _origin(inertial.find("origin"))
        matrix = inertial.find("inertia")
        spread = np.zeros((3, 3))
        for a, b in itertools.combinations_with_replacement(range(3), 2):
            value = 0.0 if matrix is None else float(matrix.get("i" + "xyz"[a] + "xyz"[b], 0))
            spread[a, b] = spread[b, a] = value
        while link not in links:  # beside the chain: its joint at zero
            pose = joints[link].pose @ pose
            link = joints[link].parent
        spread = pose[:3, :3] @ spread @ pose[:3, :3].T
        found.append(Mass(link, float(inertial.find("mass").get("value")), pose[:3, 3], spread))
    return found
