"""Independent parser of a robot folder for the exact model: URDF by Pinocchio's parser, and elasticity.toml.

It does not use `compplan.robot.folder` or the chain of the planner, so that an error in either is detected.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from compplan.controllers.writers.frames import flange_turn
from compplan.io.parsing import guard_parser
from compplan.io.tables import read_text
from compplan.io.tomlfile import read_toml
from compplan.job.frames import ToolTable
from compplan.robot import Array, load_robot
from compplan.simulation.exact import ExactRobot, ExactRobotBuilder

#: Carrying link, mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m^2] in the link frame.
Mass = tuple[str, float, Array, Array]
#: Gravity on a mounted tool if the folder has none. [m/s^2]
GRAVITY = np.array([0.0, 0.0, -9.81])
AXES = {"x": np.array([1.0, 0, 0]), "y": np.array([0, 1.0, 0]), "z": np.array([0, 0, 1.0])}


def read_exact_robot(
    folder: Path, tool: Mapping[str, Any] | None = None, *, moving: bool = False, geometry: str = "robot.urdf"
) -> ExactRobot:
    """Read a robot folder and build the exact model of its robot.

    Args:
        folder: The robot folder.
        tool: The section [tool] of a job as in the file, or None for the tool of the folder.
        moving: Whether the model is for the inertia of motion: all masses, no weight, frame of the ground.
        geometry: URDF file of the folder; robot.urdf if it does not exist.
    """
    urdf = folder / geometry if (folder / geometry).is_file() else folder / "robot.urdf"
    table = read_toml(folder / "elasticity.toml")
    tree = _Tree(urdf)
    names = tree.chain_to(table["tcp"])
    flange = table.get("flange") or (tree.parent if tree.kind[names[-1]] == "fixed" else tree.child)[names[-1]]
    gravity = None if table.get("gravity") is None else np.array(table["gravity"], float)
    gravity = np.zeros(3) if moving else gravity
    masses, back = tree.masses(names), [] if table.get("part") is None or moving else tree.chain_to(table["part"])[::-1]
    carrying = [] if table.get("part") is None else tree.commanded(tree.chain_to(table["part"]))
    mounted, beyond = None, [name for name in names if flange in tree.links_above(name)]
    if tool is not None:
        stated = ToolTable.model_validate(tool)
        counted = pin.SE3(flange_turn(load_robot(folder)) if stated.frame == "pendant" else np.eye(4))
        mounted = counted * pin.SE3(stated.pose)
        own = {flange, *(tree.child[name] for name in beyond)}
        centre = np.asarray(counted.act(np.array(stated.centre_of_mass_mm) * 1e-3))
        new: list[Mass] = [(flange, stated.mass_kg, centre, np.zeros((3, 3)))] if stated.mass_kg else []
        if gravity is not None:
            masses = [m for m in masses if m[0] not in own] + new
        elif stated.mass_kg is not None:
            masses, gravity = new + tree.negate_masses(flange, [m for m in masses if m[0] in own]), GRAVITY
        names = [name for name in names if name not in beyond]
    builder = ExactRobotBuilder([*carrying, *tree.commanded(names)], np.zeros(3) if gravity is None else gravity)
    for name in back:  # from the link that carries the part to the ground: every motion reversed
        if tree.kind[name] != "fixed":
            builder.drive(name, tree.axis[name], tree.kind[name] == "prismatic", name, -1.0, 0.0)
        builder.move(tree.placement[name].inverse())
    if back:
        builder.set_ground()
    builder.hang(masses, tree.parent[names[0]])
    for count, name in enumerate(names):
        builder.move(tree.placement[name])
        if tree.kind[name] != "fixed":
            driver = tree.mimic.get(name, (name, 1.0, 0.0))
            builder.drive(name, tree.axis[name], tree.kind[name] == "prismatic", *driver)
        for spring in table.get("spring", ()):
            if spring["joint"] == name:
                axis, slides = _direction(spring.get("axis", "own"), tree, name)
                builder.spring(axis, slides, spring["compliance"], np.array(spring.get("offset", (0, 0, 0)), float))
        link = tree.child[name]
        builder.hang(masses, link)
        last = pin.SE3.Identity() if mounted is None else mounted
        far = tree.placement[names[count + 1]] if count + 1 < len(names) else last
        for block in table.get("link", ()):
            if block["link"] == link and not (tool is not None and link == flange and not far.isIdentity()):
                matrix = np.array(block["compliance"]) if "compliance" in block else _beam(**block["beam"])
                builder.elastic_link(far, matrix)
    return builder.finish(pin.SE3.Identity() if mounted is None else mounted)


def _write_skeleton(urdf: ElementTree.Element) -> str:
    """Return only links and joints of a URDF, since Pinocchio's parser rejects some elements without kinematics.

    Colours, masses (parsed here), dynamics, safety controllers and extensions are removed; limits are completed.
    """
    root = ElementTree.Element("robot", name=urdf.get("name") or "robot")
    for link in urdf.findall("link"):
        ElementTree.SubElement(root, "link", name=link.get("name", ""))
    for joint in urdf.findall("joint"):
        bare = ElementTree.SubElement(root, "joint", name=joint.get("name", ""), type=joint.get("type", ""))
        for tag in ("origin", "parent", "child", "axis", "mimic"):
            bare.extend(joint.findall(tag)[:1])
        if joint.get("type") in ("revolute", "prismatic"):
            limit = joint.find("limit")
            given = {} if limit is None else dict(limit.attrib)
            ElementTree.SubElement(bare, "limit", {"lower": "0", "upper": "0", "effort": "0", "velocity": "0", **given})
    return ElementTree.tostring(root, encoding="unicode")


class _Tree:
    """URDF parsed by Pinocchio; names of parents and mimic joints are read from its text."""

    def __init__(self, urdf: Path) -> None:
        with guard_parser(urdf, "cannot be read as URDF by Pinocchio"):
            text = ElementTree.fromstring(read_text(urdf))
            self.model = pin.buildModelFromXML(_write_skeleton(text))
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, pin.neutral(self.model))
        where = {f.name: data.oMf[k] for k, f in enumerate(self.model.frames) if f.type == pin.FrameType.BODY}
        self.parent: dict[str, str] = {}
        self.child: dict[str, str] = {}
        self.carrier: dict[str, str] = {}
        self.kind: dict[str, str] = {}
        self.mimic: dict[str, tuple[str, float, float]] = {}
        self.placement: dict[str, pin.SE3] = {}
        self.axis: dict[str, Array] = {}
        for element in text.findall("joint"):
            name = element.get("name", "")
            self.parent[name], self.child[name] = (_entry(element, side, "link") for side in ("parent", "child"))
            self.carrier[self.child[name]] = name
            self.placement[name] = where[self.parent[name]].inverse() * where[self.child[name]]
            self.kind[name] = "fixed"
            if self.model.existJointName(name):
                joint = self.model.joints[self.model.getJointId(name)]
                motion = joint.createData()
                joint.calc(motion, pin.neutral(self.model)[joint.idx_q : joint.idx_q + joint.nq])
                column = np.asarray(motion.S).reshape(6)
                self.kind[name] = "prismatic" if np.linalg.norm(column[:3]) > 0.5 else "revolute"
                self.axis[name] = column[:3] if self.kind[name] == "prismatic" else column[3:]
            follows = element.find("mimic")
            if follows is not None:
                numbers = float(follows.get("multiplier", "1")), float(follows.get("offset", "0"))
                self.mimic[name] = (follows.get("joint", ""), *numbers)
        self.where = where
        self.inertials = [
            (link.get("name", ""), float(_entry(entry, "mass", "value")), entry.find("origin"), entry.find("inertia"))
            for link in text.findall("link")
            for entry in link.findall("inertial")
        ]

    def chain_to(self, link: str) -> list[str]:
        """Return the joints from the root to a link."""
        names: list[str] = []
        while link in self.carrier:
            names.append(self.carrier[link])
            link = self.parent[names[-1]]
        return names[::-1]

    def links_above(self, joint: str) -> list[str]:
        """Return the links from a joint's parent up to the root."""
        return [self.parent[name] for name in [*self.chain_to(self.parent[joint]), joint]]

    def commanded(self, names: list[str]) -> list[str]:
        """Return the commanded joints, in order."""
        return [name for name in names if self.kind[name] != "fixed" and name not in self.mimic]

    def masses(self, names: list[str]) -> list[Mass]:
        """Return the masses on the links of a chain; those of other links at the link that carries them."""
        chain, found = {self.parent[names[0]], *(self.child[name] for name in names)}, []
        for link, mass, origin, inertia in self.inertials:
            words = {} if origin is None else origin.attrib
            xyz, rpy = (np.array(words.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
            carrier = link
            while carrier not in chain:
                carrier = self.parent[self.carrier[carrier]]
            place = self.where[carrier].inverse() * self.where[link] * pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
            found.append((carrier, mass, place.translation, place.rotation @ _tensor(inertia) @ place.rotation.T))
        return found

    def negate_masses(self, flange: str, masses: list[Mass]) -> list[Mass]:
        """Return masses as negative masses in the flange frame, for their weight only."""
        back, none = self.where[flange].inverse(), np.zeros((3, 3))
        seen = [(mass, np.asarray((back * self.where[link]).act(centre))) for link, mass, centre, _ in masses]
        return [(flange, -mass, centre, none) for mass, centre in seen]


def _entry(element: ElementTree.Element, tag: str, key: str) -> str:
    found = element.find(tag)
    return "" if found is None else found.get(key, "")


def _tensor(inertia: ElementTree.Element | None) -> Array:
    """Return the inertia matrix of a URDF element. Shape (3, 3). [kg m^2]"""
    if inertia is None:
        return np.zeros((3, 3))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(f"i{key}", "0")) for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _direction(axis: str, tree: _Tree, joint: str) -> tuple[Array, bool]:
    """Return the axis of a spring in the joint's child frame, and whether it is translational."""
    if axis == "own":
        return tree.axis[joint], tree.kind[joint] == "prismatic"
    return AXES[axis[1]], axis[0] == "t"


def _beam(
    length: float, outer_diameter: float, inner_diameter: float, young: float, shear: float, axis: str = "z"
) -> Array:
    """Compute the compliance of a clamped tube at its free end by energy: integral of B(s)^T D^-1 B(s) over its length.

    B transforms a load at the end to the section at a distance s from it. Shape (6, 6).
    """
    along = AXES[axis[-1]] * (-1.0 if axis[0] == "-" else 1.0)
    area = np.pi * (outer_diameter**2 - inner_diameter**2) / 4.0
    second = np.pi * (outer_diameter**4 - inner_diameter**4) / 64.0
    axial, bending = np.outer(along, along), np.eye(3) - np.outer(along, along)
    give = np.zeros((6, 6))
    give[:3, :3] = axial / (young * area)
    give[3:, 3:] = bending / (young * second) + axial / (2.0 * shear * second)
    total = np.zeros((6, 6))
    for node, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True):
        carry = np.eye(6)
        carry[3:, :3] = pin.skew(along * 0.5 * length * (1.0 + node))
        total += 0.5 * length * weight * carry.T @ give @ carry
    return total
