"""Read and write a robot folder: robot.urdf, elasticity.toml, effects.toml."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, UnknownNameError
from compplan.files.tables import read_text, write_text
from compplan.files.tomlfile import read_toml
from compplan.robot.beam import hollow_beam_compliance
from compplan.robot.model import (
    GRADES,
    SPRING_AXES,
    Array,
    Body,
    Joint,
    LinkElasticity,
    Mimic,
    Robot,
    Spring,
    roll_pitch_yaw_of,
)

ELASTICITY_KEYS = {
    "schema", "tcp", "flange", "gravity", "acceleration_limits", "repeatability_mm", "sources", "grade",
    "spring", "link",
}  # fmt: skip
SPRING_KEYS = {"joint", "axis", "compliance", "offset", "actuator"}
LINK_KEYS = {"link", "compliance", "beam"}
BEAM_KEYS = {"length", "outer_diameter", "inner_diameter", "young", "shear", "axis"}


def robot_folders() -> dict[str, Path]:
    """Find the robot folders that ship with compplan, by name."""
    package = Path(str(resources.files("compplan")))
    for root in (package.parent / "robots", package / "robots"):
        if root.is_dir():
            return {path.name: path for path in sorted(root.iterdir()) if (path / "robot.urdf").is_file()}
    return {}


def find_robot_folder(name: str | Path, relative_to: Path | None = None) -> Path:
    """Find a robot folder by path or by the name of a shipped robot.

    Args:
        name: Path of a folder, or name of a shipped robot.
        relative_to: Folder that a relative path counts from, besides the working directory.

    Raises:
        UnknownNameError: If there is neither such a folder nor such a robot.
    """
    candidates = [Path(name)] if relative_to is None else [relative_to / name, Path(name)]
    for path in candidates:
        if (path / "robot.urdf").is_file():
            return path
        if path.is_dir() and path.name not in robot_folders():
            raise InputError("no robot.urdf in this robot folder", file=path)
    shipped = robot_folders()
    if str(name) in shipped:
        return shipped[str(name)]
    raise UnknownNameError("robot", str(name), sorted(shipped))


def load_robot(name: str | Path, *, relative_to: Path | None = None) -> Robot:
    """Load a robot folder.

    Args:
        name: Path of the folder, or name of a shipped robot.
        relative_to: Folder that a relative path counts from, besides the working directory.

    Raises:
        InputError: If a file of the folder is missing, cannot be read or contradicts another one.
    """
    return read_robot_folder(find_robot_folder(name, relative_to))


def read_robot_folder(folder: Path) -> Robot:
    """Read a robot folder.

    Args:
        folder: The folder that holds robot.urdf and elasticity.toml.

    Raises:
        InputError: If a file is missing, cannot be read, or names a joint, link or frame that does not exist.
    """
    urdf_file, elasticity_file = folder / "robot.urdf", folder / "elasticity.toml"
    for file in (urdf_file, elasticity_file):
        if not file.is_file():
            raise InputError(f"no {file.name} in this robot folder", file=folder)
    urdf = read_text(urdf_file)
    root = _parse_xml(urdf, urdf_file)
    table = read_toml(elasticity_file)
    _refuse_unknown_keys(table, ELASTICITY_KEYS, elasticity_file, "")
    all_joints = [_read_joint(element, urdf_file) for element in root.findall("joint")]
    links = [element.attrib["name"] for element in root.findall("link")]
    tcp = str(_required(table, "tcp", elasticity_file))
    if tcp not in links:
        raise UnknownNameError("frame", tcp, links, file=elasticity_file, where="tcp")
    joints, base = _chain_to(tcp, all_joints, urdf_file)
    flange = str(table.get("flange", _default_flange(joints)))
    chain_links = [base, *(joint.child for joint in joints)]
    if flange not in chain_links:
        raise UnknownNameError("frame", flange, chain_links, file=elasticity_file, where="flange")
    nq = sum(joint.actuated for joint in joints)
    grade = str(table.get("grade", "placeholder"))
    if grade not in GRADES:
        raise UnknownNameError("grade", grade, list(GRADES), file=elasticity_file, where="grade")
    repeatability = table.get("repeatability_mm")
    gravity = table.get("gravity")
    accelerations = table.get("acceleration_limits", [math.inf] * nq)
    return Robot(
        name=folder.resolve().name,
        urdf=urdf,
        joints=tuple(joints),
        bodies=_read_bodies(root, all_joints, chain_links, urdf_file),
        springs=tuple(_read_springs(table, joints, elasticity_file)),
        link_elasticities=tuple(_read_links(table, chain_links, elasticity_file)),
        base=base,
        tcp=tcp,
        flange=flange,
        gravity=None if gravity is None else _vector(gravity, 3, elasticity_file, "gravity"),
        acceleration_limits=_vector(accelerations, nq, elasticity_file, "acceleration_limits"),
        repeatability=None if repeatability is None else float(repeatability) * 1e-3,
        sources=dict(table.get("sources", {})),
        grade=grade,
        folder=folder,
        effects=_read_effects(folder / "effects.toml"),
    )


def write_robot_folder(robot: Robot, folder: Path) -> None:
    """Write a robot folder: geometry and masses go into the URDF, springs and links into elasticity.toml.

    Only what the robot holds differently from its URDF text is edited there. No file is ever half written.

    Args:
        robot: The robot.
        folder: The folder to write; made if needed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "robot.urdf", _edit_urdf(robot))
    write_text(folder / "elasticity.toml", tomli_w.dumps(_elasticity_table(robot)))
    if robot.effects:
        table = {"schema": 1, "effect": [dict(effect) for effect in robot.effects]}
        write_text(folder / "effects.toml", tomli_w.dumps(table))
    else:
        (folder / "effects.toml").unlink(missing_ok=True)
    if robot.folder is not None:
        for name in ("controller.toml", "controller.urdf"):
            source = robot.folder / name
            if source.is_file() and source.resolve() != (folder / name).resolve():
                write_text(folder / name, source.read_text(encoding="utf-8"))


def _parse_xml(text: str, file: Path) -> ElementTree.Element:
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"not valid XML: {error.msg}", file=file, where=error.position[0]) from None


def _numbers(element: ElementTree.Element | None, key: str, default: str) -> Array:
    text = default if element is None else element.attrib.get(key, default)
    return np.array([float(value) for value in text.split()])


def _placement(element: ElementTree.Element | None) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = _numbers(element, "xyz", "0 0 0")
    pose[:3, :3] = Rotation.from_euler("xyz", _numbers(element, "rpy", "0 0 0")).as_matrix()
    return pose


def _read_joint(element: ElementTree.Element, file: Path) -> Joint:
    name, kind = element.attrib["name"], element.attrib["type"]
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise InputError(f"joint {name!r} lacks its parent or child link", file=file)
    if kind not in ("revolute", "continuous", "prismatic", "fixed"):
        raise InputError(
            f"joint {name!r} is of type {kind!r}, expected revolute, continuous, prismatic or fixed", file=file
        )
    axis = _numbers(element.find("axis"), "xyz", "1 0 0")
    limit, mimic = element.find("limit"), element.find("mimic")
    limits: dict[str, float] = {}
    if limit is not None and kind != "fixed":
        keys = ("velocity", "effort") if kind == "continuous" else ("lower", "upper", "velocity", "effort")
        limits = {key: float(limit.attrib[key]) for key in keys if key in limit.attrib}
    follows = None
    if mimic is not None:
        follows = Mimic(
            mimic.attrib["joint"], float(mimic.attrib.get("multiplier", 1)), float(mimic.attrib.get("offset", 0))
        )
    return Joint(
        name=name,
        kind="revolute" if kind == "continuous" else kind,
        parent=parent.attrib["link"],
        child=child.attrib["link"],
        placement=_placement(element.find("origin")),
        axis=axis / np.linalg.norm(axis),
        mimic=follows,
        **limits,
    )


def _chain_to(tcp: str, joints: list[Joint], file: Path) -> tuple[list[Joint], str]:
    by_child = {joint.child: joint for joint in joints}
    chain: list[Joint] = []
    link = tcp
    while link in by_child:
        chain.append(by_child[link])
        link = by_child[link].parent
        if len(chain) > len(joints):
            raise InputError(f"the joints above frame {tcp!r} form a loop", file=file)
    chain.reverse()
    names = [joint.name for joint in chain if joint.actuated]
    for joint in chain:
        if joint.mimic is not None and joint.mimic.joint not in names:
            raise UnknownNameError("joint", joint.mimic.joint, names, file=file)
    return chain, link


def _default_flange(joints: list[Joint]) -> str:
    return joints[-1].parent if joints and joints[-1].kind == "fixed" else joints[-1].child


def _read_bodies(
    root: ElementTree.Element, joints: list[Joint], chain_links: list[str], file: Path
) -> tuple[Body, ...]:
    """Collect the masses; a link beside the chain counts with the chain link that carries it, its joint at zero."""
    by_child = {joint.child: joint for joint in joints}
    bodies = []
    for element in root.findall("link"):
        inertial = element.find("inertial")
        if inertial is None:
            continue
        mass_element = inertial.find("mass")
        if mass_element is None:
            raise InputError(f"link {element.attrib['name']!r} has an inertial without a mass", file=file)
        link, pose = element.attrib["name"], _placement(inertial.find("origin"))
        carrier = link
        while carrier not in chain_links:
            pose = by_child[carrier].placement @ pose
            carrier = by_child[carrier].parent
        bodies.append(Body(carrier, float(mass_element.attrib["value"]), pose[:3, 3]))
    return tuple(bodies)


def _read_springs(table: Mapping[str, Any], joints: list[Joint], file: Path) -> list[Spring]:
    names = [joint.name for joint in joints]
    springs = []
    for index, entry in enumerate(table.get("spring", [])):
        key = f"spring[{index}]"
        _refuse_unknown_keys(entry, SPRING_KEYS, file, key)
        joint, axis = str(_required(entry, "joint", file, key)), str(entry.get("axis", "own"))
        if joint not in names:
            raise UnknownNameError("joint", joint, names, file=file, where=f"{key}.joint")
        if axis not in SPRING_AXES:
            raise UnknownNameError("axis", axis, list(SPRING_AXES), file=file, where=f"{key}.axis")
        if axis == "own" and joints[names.index(joint)].kind == "fixed":
            raise InputError(
                f"fixed joint {joint!r} has no own axis, give tx ty tz rx ry rz", file=file, where=f"{key}.axis"
            )
        compliance = float(_required(entry, "compliance", file, key))
        if not (math.isfinite(compliance) and compliance >= 0):
            raise InputError(
                f"compliance {compliance:g} is not a finite number >= 0", file=file, where=f"{key}.compliance"
            )
        springs.append(
            Spring(
                joint=joint,
                axis=axis,
                compliance=compliance,
                offset=_vector(entry.get("offset", [0, 0, 0]), 3, file, f"{key}.offset"),
                actuator=bool(entry.get("actuator", axis == "own")),
            )
        )
    return springs


def _read_links(table: Mapping[str, Any], chain_links: list[str], file: Path) -> list[LinkElasticity]:
    blocks = []
    for index, entry in enumerate(table.get("link", [])):
        key = f"link[{index}]"
        _refuse_unknown_keys(entry, LINK_KEYS, file, key)
        link = str(_required(entry, "link", file, key))
        if link not in chain_links:
            raise UnknownNameError("link", link, chain_links, file=file, where=f"{key}.link")
        if ("compliance" in entry) == ("beam" in entry):
            raise InputError("give either compliance (6x6) or beam", file=file, where=key)
        if "beam" in entry:
            beam = dict(entry["beam"])
            _refuse_unknown_keys(beam, BEAM_KEYS, file, f"{key}.beam")
            try:
                matrix = hollow_beam_compliance(**beam)
            except (TypeError, ValueError) as error:
                raise InputError(str(error), file=file, where=f"{key}.beam") from None
        else:
            matrix = np.array([_vector(row, 6, file, f"{key}.compliance") for row in entry["compliance"]])
            if matrix.shape != (6, 6) or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-15):
                raise InputError("compliance is not a symmetric 6x6 matrix", file=file, where=f"{key}.compliance")
            if np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.abs(matrix).max(), 1e-300):
                raise InputError("compliance has a negative eigenvalue", file=file, where=f"{key}.compliance")
        blocks.append(LinkElasticity(link, matrix))
    return blocks


def _read_effects(file: Path) -> tuple[Mapping[str, Any], ...]:
    if not file.is_file():
        return ()
    return tuple(read_toml(file).get("effect", []))


def _required(table: Mapping[str, Any], key: str, file: Path, prefix: str = "") -> Any:
    if key not in table:
        raise InputError(f"key {key!r} is missing", file=file, where=prefix or None)
    return table[key]


def _vector(values: Any, size: int, file: Path, key: str) -> Array:
    try:
        array = np.array(values, float)
    except (TypeError, ValueError):
        array = np.full(0, np.nan)
    if array.shape != (size,) or np.isnan(array).any():
        raise InputError(f"expected {size} numbers, got {values!r}", file=file, where=key)
    return array


def _refuse_unknown_keys(table: Mapping[str, Any], known: set[str], file: Path, prefix: str) -> None:
    for key in table:
        if key not in known:
            where = f"{prefix}.{key}" if prefix else key
            raise InputError(f"unknown key, choose from {sorted(known)}", file=file, where=where)


def _edit_urdf(robot: Robot) -> str:
    root = ElementTree.fromstring(
        robot.urdf, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    )
    elements = {element.attrib["name"]: element for element in root.findall("joint")}
    for joint in robot.joints:
        element = elements[joint.name]
        origin = element.find("origin")
        if not np.allclose(_placement(origin), joint.placement, rtol=0, atol=1e-14):
            if origin is None:
                origin = ElementTree.SubElement(element, "origin")
            origin.set("xyz", _text(joint.placement[:3, 3]))
            origin.set("rpy", _text(roll_pitch_yaw_of(joint.placement[:3, :3])))
        axis = element.find("axis")
        if axis is not None and joint.kind != "fixed":
            old = _numbers(axis, "xyz", "1 0 0")
            if not np.allclose(old / np.linalg.norm(old), joint.axis, rtol=0, atol=1e-14):
                axis.set("xyz", _text(joint.axis))
    _edit_masses(root, robot)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _edit_masses(root: ElementTree.Element, robot: Robot) -> None:
    """Set the mass of a link that carries one body; a link that carries several keeps its URDF blocks."""
    for element in root.findall("link"):
        bodies = [body for body in robot.bodies if body.link == element.attrib["name"]]
        if len(bodies) != 1:
            continue
        body = bodies[0]
        inertial = element.find("inertial")
        if inertial is None:
            inertial = ElementTree.SubElement(element, "inertial")
            small = repr(1e-2 * body.mass)
            zeros = {"ixy": "0", "ixz": "0", "iyz": "0"}
            ElementTree.SubElement(inertial, "inertia", {"ixx": small, "iyy": small, "izz": small, **zeros})
        for tag, attributes in (("mass", {"value": repr(float(body.mass))}), ("origin", {"xyz": _text(body.centre)})):
            child = inertial.find(tag)
            if child is None:
                child = ElementTree.SubElement(inertial, tag)
            child.attrib.update(attributes)


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _elasticity_table(robot: Robot) -> dict[str, Any]:
    table: dict[str, Any] = {"schema": 1, "tcp": robot.tcp, "flange": robot.flange, "grade": robot.grade}
    if robot.gravity is not None:
        table["gravity"] = [float(value) for value in robot.gravity]
    if np.isfinite(robot.acceleration_limits).all():
        table["acceleration_limits"] = [float(value) for value in robot.acceleration_limits]
    if robot.repeatability is not None:
        table["repeatability_mm"] = robot.repeatability * 1e3
    table["sources"] = dict(robot.sources)
    table["spring"] = [
        {
            "joint": spring.joint,
            "axis": spring.axis,
            "compliance": float(spring.compliance),
            "offset": [float(value) for value in spring.offset],
            "actuator": spring.actuator,
        }
        for spring in robot.springs
    ]
    table["link"] = [
        {"link": block.link, "compliance": [[float(value) for value in row] for row in block.compliance]}
        for block in robot.link_elasticities
    ]
    return {key: value for key, value in table.items() if value != []}
