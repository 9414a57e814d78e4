"""Read and write a robot folder: robot.urdf, elasticity.toml, effects.toml, uncertainty.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import tomli_w
from pydantic import Field

from compplan.errors import InputError, UnknownNameError, find_near
from compplan.io.tables import escape_bytes, read_text, write_text
from compplan.io.tomlfile import SchemaOne, StrictTable, check_table, parse_toml
from compplan.robot.elasticity import ElasticityTable, build_links, build_springs
from compplan.robot.model import Array, Robot, roll_pitch_yaw_of
from compplan.robot.uncertainty import FILE as UNCERTAINTY
from compplan.robot.uncertainty import format_uncertainty, read_uncertainty
from compplan.robot.urdf import UrdfNode, read_placement, read_urdf

EFFECTS = "effects.toml"


class EffectTable(StrictTable):
    """[[effect]]: an effect that URDF and elasticity cannot express."""

    effect: str = Field(min_length=1)
    joint: str | None = None
    axis: str | None = None
    parameters: dict[str, Any]


class EffectsTable(StrictTable):
    """effects.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    effect: Annotated[tuple[EffectTable, ...], Field(strict=False)]


def robot_folders() -> dict[str, Path]:
    """Return the shipped robot folders by name."""
    package = Path(str(resources.files("compplan")))
    for root in (package.parent / "robots", package / "robots"):
        if root.is_dir():
            return {path.name: path for path in sorted(root.iterdir()) if (path / "robot.urdf").is_file()}
    return {}


def find_robot_folder(name: str | Path, relative_to: Path | None = None) -> Path:
    """Find a robot folder by path or by the name of a shipped robot.

    Args:
        name: Path of a folder, or name of a shipped robot.
        relative_to: Base of a relative path, in addition to the working directory.

    Raises:
        UnknownNameError: If neither exists.
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
    if len(Path(name).parts) > 1:
        folders = [str(file.parent) for path in candidates for file in sorted(path.parent.glob("*/robot.urdf"))]
        near = find_near(str(name), folders)
        raise InputError(f"no robot folder {str(name)!r}{f'; is it {near[0]!r}?' if near else ''}")
    raise UnknownNameError("robot", str(name), sorted(shipped))


def load_robot(name: str | Path, *, relative_to: Path | None = None) -> Robot:
    """Load a robot folder.

    Args:
        name: Path of the folder, or name of a shipped robot.
        relative_to: Base of a relative path, in addition to the working directory.

    Raises:
        InputError: If a file of the folder is missing, cannot be read or contradicts another one.
    """
    return read_robot_folder(find_robot_folder(name, relative_to))


def read_robot_folder(folder: Path) -> Robot:
    """Read a robot folder.

    Args:
        folder: The folder that holds robot.urdf and elasticity.toml.

    Raises:
        InputError: If a file is missing, cannot be read, or names an unknown joint, link or frame.
    """
    files = [folder / "robot.urdf", folder / "elasticity.toml"]
    for file in files:
        if not file.is_file():
            raise InputError(f"no {file.name} in this robot folder", file=folder)
    files += [folder / EFFECTS] if (folder / EFFECTS).exists() else []
    robot = _assemble({file.name: read_text(file) for file in files}, folder)
    return replace(robot, name=escape_bytes(folder.resolve().name), uncertainty=read_uncertainty(folder / UNCERTAINTY))


def as_read(robot: Robot) -> Robot:
    """Return a robot as read back from the texts of `write_robot_folder`, without writing files.

    Raises:
        InputError: If the folder is invalid, such as an implausibly soft spring or a negative mass.
    """
    read = _assemble(format_robot(robot), Path(robot.name) if robot.folder is None else robot.folder)
    return replace(read, name=robot.name, folder=robot.folder, uncertainty=robot.uncertainty)


def _assemble(texts: Mapping[str, str], folder: Path) -> Robot:
    """Build a robot from the texts of its folder, without its uncertainty; the folder is for messages."""
    urdf_file, elasticity_file = folder / "robot.urdf", folder / "elasticity.toml"
    table = check_table(ElasticityTable, parse_toml(texts["elasticity.toml"], elasticity_file), file=elasticity_file)
    effects: tuple[EffectTable, ...] = ()
    if EFFECTS in texts:
        effects = check_table(EffectsTable, parse_toml(texts[EFFECTS], folder / EFFECTS), file=folder / EFFECTS).effect
    urdf = read_urdf(texts["robot.urdf"], urdf_file)
    if table.tcp not in urdf.links:
        raise UnknownNameError("frame", table.tcp, list(urdf.links), file=elasticity_file, where="tcp")
    joints, base = urdf.chain_to(table.tcp)
    arm, arm_links, ground = joints, [base, *(joint.child for joint in joints)], ""
    flange = table.flange or (joints[-1].parent if joints[-1].kind == "fixed" else joints[-1].child)
    if flange not in arm_links:
        raise UnknownNameError("frame", flange, arm_links, file=elasticity_file, where="flange")
    if beyond := [joint.name for joint in joints[arm_links.index(flange) :] if joint.kind != "fixed"]:
        behind = arm_links[1 + max(k for k, joint in enumerate(joints) if joint.kind != "fixed") :]
        message = f"is {flange!r}, but {', '.join(beyond)} move what is mounted there; choose from {behind}"
        raise InputError(message, file=elasticity_file, where="flange")
    if table.part is not None:
        if table.part not in urdf.links:
            raise UnknownNameError("frame", table.part, list(urdf.links), file=elasticity_file, where="part")
        back = urdf.chain_from(table.part, joints)
        joints, base, ground = [*back, *joints], table.part, base
    links, nq = [base, *(joint.child for joint in joints)], sum(joint.actuated for joint in joints)
    accelerations = table.acceleration_limits
    if accelerations is not None and len(accelerations) != nq:
        message = f"has {len(accelerations)} numbers, expected {nq}, one per joint"
        raise InputError(message, file=elasticity_file, where="acceleration_limits")
    return Robot(
        name=folder.name,
        urdf=texts["robot.urdf"],
        joints=tuple(joints),
        bodies=tuple(body for body in urdf.bodies(links) if body.link in arm_links),
        springs=build_springs(table, arm, elasticity_file),
        link_elasticities=build_links(table, arm_links, elasticity_file),
        base=base,
        ground=ground,
        tcp=table.tcp,
        flange=flange,
        gravity=None if table.gravity is None else np.array(table.gravity),
        acceleration_limits=np.full(nq, np.inf) if accelerations is None else np.array(accelerations),
        repeatability=None if table.repeatability_mm is None else table.repeatability_mm * 1e-3,
        sources=dict(table.sources),
        grade=table.grade,
        folder=folder,
        effects=tuple(entry.model_dump(exclude_none=True) for entry in effects),
    )


def write_robot_folder(robot: Robot, folder: Path, before: Robot | None = None) -> None:
    """Write a robot folder: geometry and masses go into the URDF, springs and links into elasticity.toml.

    Only values that differ from the URDF text are edited. Files are written atomically.

    Args:
        robot: The robot.
        folder: The folder to write; made if needed.
        before: The robot before the measurement; its geometry becomes controller.urdf if that of `robot` differs.
            None: no controller.urdf.
    """
    folder.mkdir(parents=True, exist_ok=True)
    texts = format_robot(robot)
    for name, text in texts.items():
        write_text(folder / name, text)
    for name in {EFFECTS, UNCERTAINTY} - set(texts):
        (folder / name).unlink(missing_ok=True)
    if robot.folder is not None:
        for name in ("controller.toml", "controller.urdf"):
            source = robot.folder / name
            if source.is_file() and source.resolve() != (folder / name).resolve():
                write_text(folder / name, source.read_text(encoding="utf-8"))
    if before is not None and not (folder / "controller.urdf").is_file() and has_moved(robot, before):
        write_text(folder / "controller.urdf", before.urdf)


def format_robot(robot: Robot) -> dict[str, str]:
    """Return the text of every file of a robot folder by name, without those of the controller."""
    texts = {"robot.urdf": _edit_urdf(robot), "elasticity.toml": tomli_w.dumps(_elasticity_table(robot))}
    if robot.effects:
        texts[EFFECTS] = tomli_w.dumps({"schema": 1, "effect": [dict(effect) for effect in robot.effects]})
    if robot.uncertainty is not None:
        texts[UNCERTAINTY] = format_uncertainty(robot.uncertainty)
    return texts


def has_moved(robot: Robot, before: Robot) -> bool:
    """Return whether a joint has another placement or axis than in the URDF of another robot."""
    believed = {joint.name: joint for joint in read_urdf(before.urdf, Path("controller.urdf")).joints}
    return any(
        not np.allclose(joint.placement, old.placement, rtol=0, atol=1e-14)
        or not np.allclose(joint.axis, old.axis, rtol=0, atol=1e-14)
        for joint in robot.joints[robot.carrying :] if (old := believed.get(joint.name)) is not None
    )  # fmt: skip


def _edit_urdf(robot: Robot) -> str:
    root = ElementTree.fromstring(
        robot.urdf, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    )
    elements = {element.attrib["name"]: element for element in root.findall("joint")}
    for joint in robot.joints[robot.carrying :]:
        element = elements[joint.name]
        origin = element.find("origin")
        if not np.allclose(read_placement(origin), joint.placement, rtol=0, atol=1e-14):
            if origin is None:
                origin = ElementTree.SubElement(element, "origin")
            origin.set("xyz", _text(joint.placement[:3, 3]))
            origin.set("rpy", _text(roll_pitch_yaw_of(joint.placement[:3, :3])))
        axis = element.find("axis")
        if axis is not None and joint.kind != "fixed":
            old = UrdfNode(axis, Path("robot.urdf"), joint.name).vector("xyz", "1 0 0")
            if not np.allclose(old / np.linalg.norm(old), joint.axis, rtol=0, atol=1e-14):
                axis.set("xyz", _text(joint.axis))
    _edit_masses(root, robot)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _edit_masses(root: ElementTree.Element, robot: Robot) -> None:
    """Set the mass of a link with one body; links with several bodies keep their URDF blocks."""
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
    if robot.ground:
        table["part"] = robot.base
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
            **({"link_share": float(spring.link_share)} if spring.actuator else {}),
        }
        for spring in robot.springs
    ]
    table["link"] = [
        {"link": block.link, "compliance": [[float(value) for value in row] for row in block.compliance]}
        for block in robot.link_elasticities
    ]
    return {key: value for key, value in table.items() if value != []}
