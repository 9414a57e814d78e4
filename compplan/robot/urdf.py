"""Reading of URDF files with checks of every name, number and connection."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, UnknownNameError
from compplan.io.parsing import GREATEST, parse_xml
from compplan.io.tables import is_plain
from compplan.robot.model import Array, Body, Joint, Mimic, Robot

KINDS = ("revolute", "continuous", "prismatic", "fixed")
MESHES = (".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off")
#: Greatest length [m] and angle [rad]; beyond them the file is in mm or degrees.
FARTHEST, WIDEST = 100.0, 50.0
#: Greatest velocity limit [rad/s or m/s], mass [kg] and length of a name.
FASTEST, HEAVIEST, LONGEST_NAME = 50.0, 1e5, 200
#: Greatest number of links; libraries walk the chain by recursion.
MOST_LINKS = 1000


@dataclass(frozen=True)
class Urdf:
    """Contents of a URDF: joints, link names and link elements."""

    file: Path
    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    elements: tuple[ElementTree.Element, ...]

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

    def bodies(self, chain_links: Sequence[str]) -> tuple[Body, ...]:
        """Collect the masses; links beside the chain count with the chain link that carries them, joints at zero."""
        by_child = {joint.child: joint for joint in self.joints}
        bodies = []
        for link, element in zip(self.links, self.elements, strict=True):
            body = _read_body(element, link, self.file)
            if body is None:
                continue
            mass, place, tensor = body
            carrier = link
            while carrier not in chain_links:
                place = by_child[carrier].placement @ place
                carrier = by_child[carrier].parent
            bodies.append(Body(carrier, mass, place[:3, 3], place[:3, :3] @ tensor @ place[:3, :3].T))
        return tuple(bodies)


def read_urdf(text: str, file: Path) -> Urdf:
    """Read a URDF.

    Args:
        text: The text of the file.
        file: The file, for messages.

    Raises:
        InputError: If names, numbers, limits, masses or shapes are invalid, or links form no tree.
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
    links = [_read_name(element, "link", file) for element in elements]
    joints = [read_joint(element, file) for element in root.findall("joint")]
    _refuse_repeats(links, "link", file)
    _refuse_repeats([joint.name for joint in joints], "joint", file)
    _check_tree(links, joints, file)
    for link, element in zip(links, elements, strict=True):
        _read_body(element, link, file)
        for shape in (*element.findall("visual"), *element.findall("collision")):
            _check_shape(shape, link, file)
    return Urdf(file, tuple(joints), tuple(links), tuple(elements))


def read_joint(element: ElementTree.Element, file: Path) -> Joint:
    """Read one joint.

    Raises:
        InputError: If a name, number or limit is missing or invalid.
    """
    name = _read_name(element, "joint", file)
    where, kind = f"joint {name!r}", element.get("type")
    if kind not in KINDS:
        raise InputError(f"is of type {kind!r}, expected {', '.join(KINDS)}", file=file, where=where)
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None or not end.get("link"):
            raise InputError(f"lacks its {tag} link", file=file, where=where)
        ends.append(str(end.get("link")))
    axis = read_numbers(element.find("axis"), "xyz", "1 0 0", file, where)
    length, mimic = float(np.linalg.norm(axis)), _read_mimic(element.find("mimic"), name, file, where)
    if not 1e-6 < length < 1e6:
        raise InputError(f"axis {axis.tolist()} has length {length:g}, expected a direction", file=file, where=where)
    return Joint(
        name=name,
        kind="revolute" if kind == "continuous" else kind,
        parent=ends[0],
        child=ends[1],
        placement=read_placement(element.find("origin"), file, where),
        axis=axis / length,
        mimic=mimic,
        **narrow_limits(
            _read_limits(element.find("limit"), "mimic" if mimic is not None else kind, file, where), element, file
        ),
    )


def read_numbers(element: ElementTree.Element | None, key: str, default: str, file: Path, where: str) -> Array:
    """Read three finite numbers of an attribute.

    Raises:
        InputError: If they are not three finite numbers.
    """
    text = default if element is None else element.get(key, default)
    values = [_parse(word) for word in text.split()]
    if len(values) != 3 or not all(abs(value) <= GREATEST for value in values):
        tag = "" if element is None else f"{element.tag} "
        message = f"{tag}{key} is {text!r}, expected three numbers up to {GREATEST:g}"
        raise InputError(message, file=file, where=where)
    return np.array(values)


def read_placement(element: ElementTree.Element | None, file: Path, where: str) -> Array:
    """Read an <origin>. Shape (4, 4) [m].

    Raises:
        InputError: If it is invalid, or too far away to be in metres.
    """
    pose = np.eye(4)
    pose[:3, 3] = read_numbers(element, "xyz", "0 0 0", file, where)
    far = float(np.abs(pose[:3, 3]).max())
    if far > FARTHEST:
        raise InputError(f"origin xyz lies {far:g} m away, at most {FARTHEST:g} m; URDF is in metres", file=file,
                         where=where)  # fmt: skip
    turned = read_numbers(element, "rpy", "0 0 0", file, where)
    if turned.any():
        pose[:3, :3] = Rotation.from_euler("xyz", turned).as_matrix()
    return pose


def _parse(word: str) -> float:
    try:
        return float(word) if is_plain(word) else math.nan
    except ValueError:
        return math.nan


def _read_name(element: ElementTree.Element, kind: str, file: Path) -> str:
    name = element.get("name", "")
    if not name.strip() or len(name) > LONGEST_NAME:
        fault = f"a name of {len(name)} letters" if name.strip() else "no name"
        raise InputError(f"a {kind} has {fault}, expected 1 to {LONGEST_NAME} letters", file=file)
    return name


def _refuse_repeats(names: Sequence[str], kind: str, file: Path) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{kind} {name!r} occurs twice", file=file)
        seen.add(name)


def _read_number(element: ElementTree.Element, key: str, file: Path, where: str) -> float:
    text = element.get(key)
    if text is None:
        raise InputError(f"{element.tag} has no {key}", file=file, where=where)
    value = _parse(text)
    if not abs(value) <= GREATEST:
        message = f"{element.tag} {key} is {text!r}, expected a finite number up to {GREATEST:g}"
        raise InputError(message, file=file, where=where)
    return value


def _read_limits(limit: ElementTree.Element | None, kind: str, file: Path, where: str) -> dict[str, float]:
    """Read the limits of a joint; only mimic joints and the effort may leave them out."""
    if kind == "fixed" or (kind in ("continuous", "mimic") and limit is None):
        return {}
    if limit is None:
        raise InputError(f"has no <limit>, a {kind} joint needs lower, upper and velocity", file=file, where=where)
    limits: dict[str, float] = {}
    unit, widest = ("m", FARTHEST) if kind == "prismatic" else ("rad", WIDEST)
    if kind not in ("continuous", "mimic") or {"lower", "upper"} & set(limit.keys()):
        limits = {key: _read_number(limit, key, file, where) for key in ("lower", "upper")}
        for key, value in limits.items():
            if abs(value) > widest:
                hint = "millimetres" if kind == "prismatic" else "degrees"
                message = f"limit {key} is {value:g} {unit}, at most {widest:g}; is it in {hint}?"
                raise InputError(message, file=file, where=where)
        if not limits["lower"] < limits["upper"]:
            message = f"lower limit {limits['lower']:g} {unit} is not below the upper limit {limits['upper']:g} {unit}"
            raise InputError(message, file=file, where=where)
    if kind not in ("continuous", "mimic") or limit.get("velocity") is not None:
        velocity = limits["velocity"] = _read_number(limit, "velocity", file, where)
        if not 0.0 < velocity <= FASTEST:
            message = f"limit velocity is {velocity:g} {unit}/s, expected more than 0 and at most {FASTEST:g}"
            raise InputError(message, file=file, where=where)
    if limit.get("effort") is not None:
        effort = limits["effort"] = _read_number(limit, "effort", file, where)
        if effort < 0.0:
            raise InputError(f"limit effort is {effort:g}, expected 0 or more", file=file, where=where)
        if effort == 0.0:  # ROS-Industrial writes 0 for unknown
            del limits["effort"]
    return limits


def _read_mimic(mimic: ElementTree.Element | None, own: str, file: Path, where: str) -> Mimic | None:
    if mimic is None:
        return None
    leader = mimic.get("joint", "")
    if not leader or leader == own:
        raise InputError(f"mimic names the joint {leader!r}, expected another joint", file=file, where=where)
    numbers = [
        default if mimic.get(key) is None else _read_number(mimic, key, file, where)
        for key, default in (("multiplier", 1.0), ("offset", 0.0))
    ]
    return Mimic(leader, *numbers)


def _check_tree(links: Sequence[str], joints: Sequence[Joint], file: Path) -> None:
    """Refuse joints without a link, links with two parents, loops, and unconnected links."""
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
    reached: set[str] = set()
    for link in links:
        path = []
        while link in parents and link not in reached and link not in path:
            path.append(link)
            link = parents[link].parent
        if link in path:
            raise InputError(f"the joints above link {link!r} form a loop", file=file)
        reached.update(path)


def _read_body(element: ElementTree.Element, link: str, file: Path) -> tuple[float, Array, Array] | None:
    """Read mass [kg], its placement in the link's frame (4, 4) [m] and the inertia there (3, 3) [kg m^2], or None."""
    inertial, where = element.find("inertial"), f"link {link!r}"
    if inertial is None:
        return None
    mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None:
        raise InputError("has an inertial without a mass", file=file, where=where)
    mass = _read_number(mass_element, "value", file, where)
    if not 0.0 <= mass <= HEAVIEST:
        raise InputError(f"mass is {mass:g} kg, expected 0 to {HEAVIEST:g} kg", file=file, where=where)
    tensor = np.zeros((3, 3))
    if inertia is not None:
        for i, j in zip(*np.triu_indices(3), strict=True):
            key = f"i{'xyz'[i]}{'xyz'[j]}"
            if i != j and inertia.get(key) is None:
                continue
            tensor[i, j] = tensor[j, i] = _read_number(inertia, key, file, where)
            if i == j and tensor[i, i] < 0.0:
                raise InputError(f"inertia {key} is {inertia.get(key)}, expected 0 or more", file=file, where=where)
    return mass, read_placement(inertial.find("origin"), file, where), tensor


def _check_shape(shape: ElementTree.Element, link: str, file: Path) -> None:
    """Refuse a shape without size or a mesh without a file."""
    where = f"link {link!r}, {shape.tag}"
    read_placement(shape.find("origin"), file, where)
    geometry = shape.find("geometry")
    if geometry is None or not len(geometry):
        raise InputError("has no geometry, expected box, cylinder, sphere or mesh", file=file, where=where)
    form = geometry[0]
    if form.tag == "mesh":
        name = form.get("filename", "")
        if Path(name).suffix.lower() not in MESHES:
            raise InputError(f"mesh {name!r} is no mesh file, expected {' '.join(MESHES)}", file=file, where=where)
        read_numbers(form, "scale", "1 1 1", file, where)
        return
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "capsule": ("radius", "length")}
    if form.tag not in keys:
        raise InputError(f"geometry <{form.tag}>, expected box, cylinder, sphere or mesh", file=file, where=where)
    for key in keys[form.tag]:
        if key == "size":
            sizes = read_numbers(form, key, "", file, where)
        else:
            sizes = np.array([_read_number(form, key, file, where)])
        if not ((sizes > 0.0) & (sizes <= FARTHEST)).all():
            message = f"{form.tag} {key} is {form.get(key)}, expected more than 0 and at most {FARTHEST:g} m"
            raise InputError(message, file=file, where=where)


#: Attributes of <safety_controller> by limit.
SOFT = {"lower": "soft_lower_limit", "upper": "soft_upper_limit"}


def read_soft_limits(element: ElementTree.Element, file: Path) -> dict[str, float]:
    """Read the soft limits of a joint; equal ones (left out, both are zero) are ignored.

    Args:
        element: The <joint>.
        file: Its file, for messages.

    Raises:
        InputError: If one is not finite, or the lower one is above the upper one.

    """
    controller = element.find("safety_controller")
    if controller is None or not set(SOFT.values()) <= set(controller.keys()):
        return {}
    soft, where = {}, f"joint {element.get('name')!r}"
    for end, key in SOFT.items():
        text = controller.get(key, "")
        try:
            soft[end] = float(text) if is_plain(text) else np.nan
        except ValueError:
            soft[end] = np.nan
        if not abs(soft[end]) <= GREATEST:
            message = f"{key} is {text!r}, expected a finite number up to {GREATEST:g}"
            raise InputError(message, file=file, where=where)
    if soft["lower"] > soft["upper"]:
        message = f"soft_lower_limit {soft['lower']:g} is above soft_upper_limit {soft['upper']:g}"
        raise InputError(message, file=file, where=where)
    return soft if soft["lower"] < soft["upper"] else {}


def narrow_limits(limits: Mapping[str, float], element: ElementTree.Element, file: Path) -> dict[str, float]:
    """Narrow the limits of a joint by its soft limits; a joint without limits keeps none.

    Args:
        limits: Its limits by name: lower, upper [rad or m], and others.
        element: The <joint>.
        file: Its file, for messages.

    Raises:
        InputError: If the soft limits are invalid, or leave no range.

    """
    soft = read_soft_limits(element, file)
    if not soft or "lower" not in limits:
        return dict(limits)
    lower, upper = max(limits["lower"], soft["lower"]), min(limits["upper"], soft["upper"])
    if lower >= upper:
        message = (
            f"soft limits {soft['lower']:g} to {soft['upper']:g} leave no room within the limits "
            f"{limits['lower']:g} to {limits['upper']:g}"
        )
        raise InputError(message, file=file, where=f"joint {element.get('name')!r}")
    return {**limits, "lower": lower, "upper": upper}


def describe_soft_limits(robot: Robot) -> str:
    """Describe the limits that soft limits narrow; "" without any."""
    by_name = {joint.name: joint for joint in robot.actuated}
    narrowed = []
    for element in ElementTree.fromstring(robot.urdf).findall("joint"):
        joint, limit = by_name.get(element.get("name", "")), element.find("limit")
        if joint is None or limit is None or limit.get("lower") is None or joint.lower == joint.upper:
            continue  # a joint without range is held by the job
        if float(limit.get("lower", "0")) < joint.lower or float(limit.get("upper", "0")) > joint.upper:
            factor, unit = (1e3, "mm") if joint.kind == "prismatic" else (180.0 / np.pi, "deg")
            narrowed.append(f"{joint.name} to {factor * joint.lower:.4g} .. {factor * joint.upper:.4g} {unit}")
    return f"soft limits of the URDF (<safety_controller>) narrow {', '.join(narrowed)}" if narrowed else ""
