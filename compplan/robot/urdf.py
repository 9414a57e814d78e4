"""Reading of URDF files with checks of every name, number and connection."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, UnknownNameError
from compplan.io.parsing import GREATEST, parse_xml
from compplan.io.tables import is_plain
from compplan.robot.model import Array, Body, Joint, Mimic

KINDS = ("revolute", "continuous", "prismatic", "fixed")
MESHES = (".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off")
#: Attributes of a shape that hold lengths.
SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "capsule": ("radius", "length")}
#: Greatest length [m] and angle [rad]; beyond them the file is in mm or degrees.
FARTHEST, WIDEST = 100.0, 50.0
#: Greatest velocity limit [rad/s or m/s], mass [kg] and length of a name.
FASTEST, HEAVIEST, LONGEST_NAME = 50.0, 1e5, 200
Colour = tuple[float, float, float, float]
#: Greatest number of links; libraries walk the chain by recursion.
MOST_LINKS = 1000


@dataclass(frozen=True)
class UrdfNode:
    """An element of a URDF, or a missing one, with its location for messages."""

    element: ElementTree.Element | None
    file: Path
    where: str | None

    def fault(self, message: str) -> InputError:
        """Return an error at this element."""
        return InputError(message, file=self.file, where=self.where)

    def child(self, tag: str) -> UrdfNode:
        """Return the first child of this tag."""
        return replace(self, element=None if self.element is None else self.element.find(tag))

    def text(self, key: str) -> str | None:
        """Return an attribute, or None."""
        return None if self.element is None else self.element.get(key)

    def numbers(self, key: str, default: str | None, count: int, expected: str) -> Array:
        """Return the finite numbers of an attribute; the default if it is missing. Shape (count,).

        Raises:
            InputError: If they are not such numbers, or missing without a default.
        """
        tag = "" if self.element is None else f"{self.element.tag} "
        text = default if self.element is None else self.element.get(key, default)
        if text is None:
            raise self.fault(f"{tag}has no {key}")
        values = [_parse(word) for word in text.split()]
        if len(values) != count or not all(abs(value) <= GREATEST for value in values):
            raise self.fault(f"{tag}{key} is {text!r}, expected {expected} up to {GREATEST:g}")
        return np.array(values)

    def number(self, key: str, default: str | None = None) -> float:
        """Return a finite number, see `numbers`."""
        return float(self.numbers(key, default, 1, "a finite number")[0])

    def vector(self, key: str, default: str) -> Array:
        """Return three finite numbers, see `numbers`. Shape (3,)."""
        return self.numbers(key, default, 3, "three numbers")

    def placement(self) -> Array:
        """Return the pose of an <origin>. Shape (4, 4). [m]

        Raises:
            InputError: If it is invalid, or too far away to be in metres.
        """
        pose = np.eye(4)
        pose[:3, 3] = self.vector("xyz", "0 0 0")
        far = float(np.abs(pose[:3, 3]).max())
        if far > FARTHEST:
            raise self.fault(f"origin xyz lies {far:g} m away, at most {FARTHEST:g} m; URDF is in metres")
        turned = self.vector("rpy", "0 0 0")
        if turned.any():
            pose[:3, :3] = Rotation.from_euler("xyz", turned).as_matrix()
        return pose


def read_placement(element: ElementTree.Element | None) -> Array:
    """Return the pose of an <origin> of a URDF that was checked before. Shape (4, 4). [m]"""
    return UrdfNode(element, Path("robot.urdf"), None).placement()


@dataclass(frozen=True, eq=False)
class LinkShape:
    """One shape of a link."""

    link: str  #: Its link.
    kind: str  #: "visual" or "collision".
    name: str  #: Name of its link, numbered if the link has several of this kind.
    #: ("box", size (3,)), ("cylinder" or "capsule", radius, length), ("sphere", radius), ("mesh", address, scale (3,));
    #: a capsule's length is between its two centres. [m]
    form: tuple[Any, ...]
    placement: Array  #: Its pose in the frame of the link. Shape (4, 4). [m]
    colour: Colour | None  #: Red, green, blue, alpha from 0 to 1, or None.


@dataclass(frozen=True)
class Urdf:
    """Contents of a URDF: joints, names of links, masses and shapes in the frames of their links."""

    file: Path
    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    masses: tuple[Body, ...]
    shapes: tuple[LinkShape, ...]

    def chain_to(self, tcp: str) -> tuple[list[Joint], str]:
        """Return the joints from the base to a frame, and the base.

        Raises:
            InputError: If no joint moves the frame, or a joint follows one that is not in the chain.
        """
        by_child = {joint.child: joint for joint in self.joints}
        chain: list[Joint] = []
        link = tcp
        while link in by_child:
            chain.insert(0, by_child[link])
            link = by_child[link].parent
        names = [joint.name for joint in chain if joint.actuated]
        for joint in chain:
            if joint.mimic is not None and joint.mimic.joint not in names:
                where = f"joint {joint.name!r}"
                raise UnknownNameError("joint to mimic", joint.mimic.joint, names, file=self.file, where=where)
        if not names:
            message = f"no joint moves the tcp {tcp!r}, expected a frame at the end of the arm"
            raise InputError(message, file=self.file)
        return chain, link

    def chain_from(self, part: str, chain: list[Joint]) -> list[Joint]:
        """Return the joints from the link that carries the part back to the root.

        The inverse of a joint (placement T, rotation R(a, q)) is R(-a, q) followed by T^-1: two joints here.

        Raises:
            InputError: If no joint moves that link, or one moves it and the tool.

        """
        by_child, back, link = {joint.child: joint for joint in self.joints}, [], part
        while link in by_child:
            joint = by_child[link]
            if (joint.actuated and joint in chain) or joint.mimic is not None:
                message = f"joint {joint.name!r} moves the part and the tool, or follows another"
                raise InputError(f"{message}; expected a positioner beside the arm", file=self.file)
            turned = f"{joint.name} turned"
            if joint.kind != "fixed":
                back.append(replace(joint, parent=link, child=turned, placement=np.eye(4), axis=-joint.axis))
            parent = turned if joint.kind != "fixed" else link
            way = np.asarray(np.linalg.inv(joint.placement))
            back.append(Joint(f"{joint.name} mount", "fixed", parent, joint.parent, way, joint.axis))
            link = joint.parent
        if not any(joint.actuated for joint in back):
            raise InputError(f"no joint moves the link {part!r} that carries the part", file=self.file)
        return back

    def carriers(self, chain: Collection[str], without: str = "") -> dict[str, tuple[str, Array, bool]]:
        """Find the link of a chain that carries each link, joints outside the chain at zero.

        Args:
            chain: Links of the chain.
            without: Link whose attached links outside the chain are ignored (the flange, if a job mounts a tool),
                or "".

        Returns:
            By link: the carrying link, the pose in its frame, shape (4, 4) [m], and whether a joint outside the chain
            moves it. Links that nothing in the chain carries are missing.
        """
        found = {link: (link, np.eye(4), False) for link in chain}
        by_parent: dict[str, list[Joint]] = {}
        for joint in self.joints:
            by_parent.setdefault(joint.parent, []).append(joint)
        waiting = [link for link in chain if link != without]
        while waiting:
            above = waiting.pop()
            carrier, pose, moved = found[above]
            for joint in by_parent.get(above, ()):
                if joint.child not in chain:
                    found[joint.child] = carrier, pose @ joint.placement, moved or joint.kind != "fixed"
                    waiting.append(joint.child)
        return found

    def bodies(self, chain_links: Collection[str]) -> tuple[Body, ...]:
        """Collect the masses; links outside the chain count with the chain link that carries them, joints at zero."""
        carriers, bodies = self.carriers(chain_links), []
        for body in self.masses:
            carrier, place, _ = carriers[body.link]
            turn = place[:3, :3]
            bodies.append(Body(carrier, body.mass, turn @ body.centre + place[:3, 3], turn @ body.inertia @ turn.T))
        return tuple(bodies)


@lru_cache(maxsize=16)  # a command reads the same text many times
def read_urdf(text: str, file: Path) -> Urdf:
    """Read a URDF.

    Args:
        text: The text of the file.
        file: The file, for messages.

    Raises:
        InputError: If it is not a URDF, or a name, number or connection in it is wrong.
    """
    root = parse_xml(text, file)
    if root.tag != "robot":
        raise InputError(f"its root is <{root.tag}>, expected <robot>", file=file)
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError("holds xacro commands; compplan init robot FILE.xacro expands them", file=file)
    elements = root.findall("link")
    if not elements:
        raise InputError("no <link> in this robot", file=file)
    if len(elements) > MOST_LINKS:
        raise InputError(f"holds {len(elements)} links, at most {MOST_LINKS} are read", file=file)
    links = _read_names(elements, "link", file)
    moving = root.findall("joint")
    names = _read_names(moving, "joint", file)
    joints = [_read_joint(element, name, file) for element, name in zip(moving, names, strict=True)]
    roots = _find_roots(links, joints, file)
    masses: list[Body] = []
    shapes: list[LinkShape] = []
    paints = {element.attrib["name"]: _read_colour(UrdfNode(element, file, None)) for element in
              root.findall("material[@name]")}  # fmt: skip
    for link, element in zip(links, elements, strict=True):
        body = _read_body(UrdfNode(element, file, f"link {link!r}"), link)
        masses += [] if body is None else [body]
        shapes += _read_shapes(element, file, paints)
    urdf = Urdf(file, tuple(joints), tuple(links), tuple(masses), tuple(shapes))
    if loop := sorted(set(links) - set(urdf.carriers(roots)), key=links.index):
        raise InputError(f"the joints above link {loop[0]!r} form a loop", file=file)
    return urdf


def _parse(word: str) -> float:
    try:
        return float(word) if is_plain(word) else math.nan
    except ValueError:
        return math.nan


def _read_names(elements: Sequence[ElementTree.Element], kind: str, file: Path) -> list[str]:
    names: dict[str, None] = {}
    for element in elements:
        name = element.get("name", "")
        if not 0 < len(name.strip()) <= LONGEST_NAME:
            raise InputError(f"a {kind} has a name of {len(name)} letters, expected 1 to {LONGEST_NAME}", file=file)
        if name in names:
            raise InputError(f"{kind} {name!r} occurs twice", file=file)
        names[name] = None
    return list(names)


def _read_joint(element: ElementTree.Element, name: str, file: Path) -> Joint:
    node, kind = UrdfNode(element, file, f"joint {name!r}"), element.get("type")
    if kind not in KINDS:
        raise node.fault(f"is of type {kind!r}, expected {', '.join(KINDS)}")
    ends = [node.child(tag).text("link") for tag in ("parent", "child")]
    for tag, end in zip(("parent", "child"), ends, strict=True):
        if not end:
            raise node.fault(f"lacks its {tag} link")
    axis = node.child("axis").vector("xyz", "1 0 0")
    length, mimic = float(np.linalg.norm(axis)), _read_mimic(node.child("mimic"), name)
    if not 1e-6 < length < 1e6:
        raise node.fault(f"axis {axis.tolist()} has length {length:g}, expected a direction")
    return Joint(
        name=name,
        kind="revolute" if kind == "continuous" else kind,
        parent=str(ends[0]),
        child=str(ends[1]),
        placement=node.child("origin").placement(),
        axis=axis / length,
        mimic=mimic,
        **_read_limits(node.child("limit"), "mimic" if mimic is not None else kind),
    )


def _read_limits(limit: UrdfNode, kind: str) -> dict[str, float]:
    """Read the limits of a joint; only mimic joints and the effort may leave them out."""
    free = kind in ("continuous", "mimic")
    if kind == "fixed" or (free and limit.element is None):
        return {}
    if limit.element is None:
        raise limit.fault(f"has no <limit>, a {kind} joint needs lower, upper and velocity")
    limits: dict[str, float] = {}
    unit, widest, hint = ("m", FARTHEST, "millimetres") if kind == "prismatic" else ("rad", WIDEST, "degrees")
    if not free or {"lower", "upper"} & set(limit.element.keys()):
        limits = {key: limit.number(key) for key in ("lower", "upper")}
        for key, value in limits.items():
            if abs(value) > widest:
                raise limit.fault(f"limit {key} is {value:g} {unit}, at most {widest:g}; is it in {hint}?")
        if not limits["lower"] < limits["upper"]:
            ends = f"lower limit {limits['lower']:g} {unit} is not below the upper limit {limits['upper']:g} {unit}"
            raise limit.fault(ends)
    if not free or limit.text("velocity") is not None:
        velocity = limits["velocity"] = limit.number("velocity")
        if not 0.0 < velocity <= FASTEST:
            raise limit.fault(f"limit velocity is {velocity:g} {unit}/s, expected more than 0 and at most {FASTEST:g}")
    effort = limit.number("effort", "0")
    if effort < 0.0:
        raise limit.fault(f"limit effort is {effort:g}, expected 0 or more")
    return {**limits, "effort": effort} if effort else limits  # ROS-Industrial writes 0 for unknown


def _read_mimic(mimic: UrdfNode, own: str) -> Mimic | None:
    if mimic.element is None:
        return None
    leader = mimic.element.get("joint", "")
    if not leader or leader == own:
        raise mimic.fault(f"mimic names the joint {leader!r}, expected another joint")
    return Mimic(leader, mimic.number("multiplier", "1"), mimic.number("offset", "0"))


def _find_roots(links: Sequence[str], joints: Sequence[Joint], file: Path) -> list[str]:
    """Return the base link, none of a loop; refuse joints without a link, two parents, unconnected links."""
    known = set(links)
    parents: dict[str, Joint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise UnknownNameError("link", link, sorted(known), file=file, where=f"joint {joint.name!r}")
        if joint.child in parents:
            names = [parents[joint.child].name, joint.name]
            raise InputError(f"link {joint.child!r} is the child of two joints, {names}", file=file)
        parents[joint.child] = joint
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        message = f"links {roots[:5]} have no parent joint, expected one base link and joints to all others"
        raise InputError(message, file=file)
    return roots


def _read_body(node: UrdfNode, link: str) -> Body | None:
    """Read the mass of a link, or None; inertia off the diagonal may be left out."""
    inertial = node.child("inertial")
    if inertial.element is None:
        return None
    mass, inertia, tensor = inertial.child("mass"), inertial.child("inertia"), np.zeros((3, 3))
    if mass.element is None:
        raise node.fault("has an inertial without a mass")
    value = mass.number("value")
    if not 0.0 <= value <= HEAVIEST:
        raise node.fault(f"mass is {value:g} kg, expected 0 to {HEAVIEST:g} kg")
    for i, j in zip(*np.triu_indices(3), strict=True) if inertia.element is not None else ():
        key = f"i{'xyz'[i]}{'xyz'[j]}"
        tensor[i, j] = tensor[j, i] = inertia.number(key, None if i == j else "0")
        if i == j and tensor[i, i] < 0.0:
            raise node.fault(f"inertia {key} is {tensor[i, i]:g}, expected 0 or more")
    place = inertial.child("origin").placement()
    return Body(link, value, place[:3, 3], place[:3, :3] @ tensor @ place[:3, :3].T)


def _read_shapes(element: ElementTree.Element, file: Path, paints: Mapping[str, Colour | None]) -> list[LinkShape]:
    """Read the shapes of a link; refuse one without size and a mesh without a file."""
    link, shapes = element.attrib["name"], []
    for kind in ("visual", "collision"):
        entries = element.findall(kind)
        for number, entry in enumerate(entries, 1):
            name = link if len(entries) == 1 else f"{link} ({number})"
            node = UrdfNode(entry, file, f"link {link!r}, {kind}")
            material = node.child("material")
            colour = _read_colour(material) or paints.get(material.text("name") or "")
            shapes.append(LinkShape(link, kind, name, _read_form(node), node.child("origin").placement(), colour))
    return shapes


def _read_form(shape: UrdfNode) -> tuple[Any, ...]:
    """Read the form of a shape, see `LinkShape`."""
    geometry = shape.child("geometry").element
    if geometry is None or not len(geometry):
        raise shape.fault("has no geometry, expected box, cylinder, sphere or mesh")
    form, tag = replace(shape, element=geometry[0]), geometry[0].tag
    if tag == "mesh":
        name = form.text("filename") or ""
        if Path(name).suffix.lower() not in MESHES:
            raise shape.fault(f"mesh {name!r} is not a mesh file, expected {' '.join(MESHES)}")
        return tag, name, form.vector("scale", "1 1 1")
    if tag not in SHAPES:
        raise shape.fault(f"geometry <{tag}>, expected box, cylinder, sphere or mesh")
    sizes = [form.vector(key, "") if key == "size" else form.number(key) for key in SHAPES[tag]]
    for key, size in zip(SHAPES[tag], sizes, strict=True):
        if not ((np.asarray(size) > 0.0) & (np.asarray(size) <= FARTHEST)).all():
            raise shape.fault(f"{tag} {key} is {form.text(key)}, expected more than 0 and at most {FARTHEST:g} m")
    return tag, *sizes


def _read_colour(material: UrdfNode) -> Colour | None:
    """Return red, green, blue, alpha (0 to 1) of a <material>, or None."""
    colour = material.child("color")
    if colour.element is None:
        return None
    numbers = [_parse(word) for word in colour.element.get("rgba", "0.6 0.6 0.6 1").split()]
    if len(numbers) != 4 or not all(0.0 <= number <= 1.0 for number in numbers):
        return None
    return numbers[0], numbers[1], numbers[2], numbers[3]
