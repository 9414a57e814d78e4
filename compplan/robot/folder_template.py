"""Template of a robot folder from a URDF or xacro file, with a comment at each key."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, UnknownNameError
from compplan.robot.brands import CONTROLLERS, ControllerProposal, propose_counting
from compplan.robot.description import find_mesh_files, read_description
from compplan.robot.model import Array, Joint
from compplan.robot.rating import Rating, check_mass, sum_arm_mass
from compplan.robot.urdf import Urdf, read_urdf

#: Folder of the templates.
TEMPLATES = Path(__file__).parent / "templates"
#: Rotations from z of a frame to an axis: roll, pitch, yaw. [rad]
TURNS = {
    "x": "0 1.5707963267948966 0", "-x": "0 -1.5707963267948966 0", "y": "-1.5707963267948966 0 0",
    "-y": "1.5707963267948966 0 0", "z": "0 0 0", "-z": "3.141592653589793 0 0",
}  # fmt: skip
#: Greatest angle between z of tool0 and the last joint's axis for a straight tool. [deg]
STRAIGHT = 5.0


@dataclass(frozen=True)
class Skeleton:
    """Texts of a robot folder."""

    #: Text of each file by name: robot.urdf, elasticity.toml, controller.toml, and SOURCE.md with a rating.
    texts: dict[str, str]
    meshes: dict[Path, Path]  #: Source of each mesh file by its place in the folder.
    missing: list[str]  #: Missing meshes.
    springs: int  #: Number of springs.
    grade: str  #: Grade of the springs.
    gaps: list[str]  #: Data missing for Cartesian programs, one sentence each.
    mass_fault: str  #: Reason why the masses of the URDF are left out, or "".


def build_skeleton(
    file: Path, tcp: str | None = None, tool_axis: str | None = None, controller: str | None = None,
    rating: Rating | None = None,
) -> Skeleton:  # fmt: skip
    """Build a robot folder for a URDF or xacro file.

    Args:
        file: The URDF or xacro file.
        tcp: Its frame of the tool centre point; left out: the link at the end of the longest chain.
        tool_axis: Axis of that frame that points out of the tool: "x", "-x", .. "-z". Left out: z of tool0
            (the all-zero tool of ROS-Industrial).
        controller: One of `CONTROLLERS`, for joint names, signs, configuration words and pendant frame.
        rating: Payload and reach, from which springs of six rotating joints are estimated.

    Raises:
        InputError: If the file is invalid, has no such frame, or does not determine the tool axis.

    """
    text = read_description(file)
    urdf = read_urdf(text, file)
    if tcp is not None and tcp not in urdf.links:
        raise UnknownNameError("frame", tcp, list(urdf.links), file=file)
    tcp = tcp if tcp is not None else _find_tip(urdf)
    joints, _ = urdf.chain_to(tcp)
    axis = tool_axis if tool_axis is not None else _find_tool_axis(joints, file)
    if axis not in TURNS:
        raise InputError(f"--tool-axis is {axis!r}, choose from {list(TURNS)}")
    parent = joints[-1].parent if joints[-1].kind == "fixed" else tcp
    turned = axis != "z"
    stated = "tool0" if "tool0" in urdf.links and not turned else ""
    if turned:
        name = next(name for name in ("tool0", "tool_tip", "compplan_tip") if name not in urdf.links)
        head, end, rest = text.rpartition("</robot>")
        text = f"{head}{_render('tip.urdf', axis=axis, parent=tcp, name=name, rpy=TURNS[axis])}{end}{rest}"
        stated = "" if name == "tool0" else name
        parent, tcp, urdf = tcp, name, read_urdf(text, file)
        joints, _ = urdf.chain_to(tcp)
    elasticity, springs, fault = _write_elasticity(urdf, joints, tcp, parent, file, rating)
    gaps, written = _write_controller(urdf, joints, parent, axis if turned else None, stated, controller)
    if fault:  # inertia uses masses even without gravity
        text = re.sub(r"<inertial\b.*?</inertial>\s*", "", text, flags=re.DOTALL)
    texts = {"robot.urdf": text, "elasticity.toml": elasticity, "controller.toml": written}
    if rating is not None:
        texts["SOURCE.md"] = _render("SOURCE.md", file=file.name, rating=rating.text)
    meshes, missing = find_mesh_files(text, file.resolve().parent)
    grade = "placeholder" if rating is None or not springs else rating.grade
    return Skeleton(texts, meshes, missing, springs, grade, gaps, fault)


def _write_elasticity(
    urdf: Urdf, joints: Sequence[Joint], tcp: str, flange: str, file: Path, rating: Rating | None
) -> tuple[str, int, str]:
    """Return elasticity.toml, the number of springs and why masses are left out."""
    moving = [joint for joint in joints if joint.actuated]
    mass = sum_arm_mass(joints, urdf.bodies([joints[0].parent, *(joint.child for joint in joints)]))
    fault = check_mass(mass, rating)
    slides = [joint.kind == "prismatic" for joint in moving]
    estimated = rating is not None and len(moving) >= 6 and all(slides[:-6]) and not any(slides[-6:])
    springs = [(joint.name, "1e-8" if slide else "1e-6") for joint, slide in zip(moving, slides, strict=True)]
    if estimated and rating is not None:
        numbers = [f"{value:.3g}" for value in rating.estimate_compliances()]
        springs = [(joint.name, number) for joint, number in zip(moving[-6:], numbers, strict=True)]
    name = file.name.replace("\\", "/").replace('"', "'")
    text = _render(
        "elasticity.toml", tcp=tcp, flange=flange, file=name, springs=springs, estimated=estimated,
        grade=rating.grade if estimated and rating is not None else "placeholder",
        masses=f"left out: {fault}" if fault else f"URDF: {name}" if mass else "none in the URDF",
        unstated=[joint.name for joint in moving if not np.isfinite(joint.effort)],
        accelerations=[f"{2.0 * joint.velocity if np.isfinite(joint.velocity) else 2.0:.3g}" for joint in moving],
    )  # fmt: skip
    return text, 6 if estimated else 0, fault


def _render(template: str, /, **values: Any) -> str:
    """Render a template of a robot folder's file."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    return environment.get_template(f"{template}.jinja").render(values)


def _find_tool_axis(joints: Sequence[Joint], file: Path) -> str:
    """Return the axis of the TCP frame that points out of the tool: z of a tool0 along the last joint's axis.

    Raises:
        InputError: For any other frame (ee_link, link_6), which follows no convention and needs --tool-axis.
    """
    tcp, hint = joints[-1].child, ""
    turns = [k for k, joint in enumerate(joints) if joint.actuated and joint.kind != "prismatic"]
    if turns:
        axis = _rotation_along(joints[turns[-1] + 1 :]).T @ joints[turns[-1]].axis
        name = "xyz"[int(np.abs(axis).argmax())]
        if np.abs(axis).max() > np.cos(np.radians(STRAIGHT)):
            if (tcp, name) == ("tool0", "z"):
                return "z"
            hint = f" (its last joint turns about {name} of it: a straight tool leaves along {name} or -{name})"
    asked = f"does not state which axis of {tcp!r} points out of the tool{hint}"
    raise InputError(f"{asked}; give --tool-axis x, -x, y, -y, z or -z", file=file)


def _rotation_along(joints: Sequence[Joint]) -> Array:
    """Return the rotation of the end of a chain, joints at zero, in the frame of its start. Shape (3, 3)."""
    turn = np.eye(3)
    for joint in joints:
        turn = turn @ joint.placement[:3, :3]
    return turn


def _write_controller(
    urdf: Urdf, joints: Sequence[Joint], flange: str, axis: str | None, stated: str, controller: str | None
) -> tuple[list[str], str]:
    """Return the data missing for Cartesian programs, and the text of controller.toml.

    Args:
        urdf: The URDF.
        joints: The chain to the TCP.
        flange: Frame that tools are mounted on.
        axis: Value of --tool-axis, or None.
        stated: Frame of the URDF with the orientation of the pendant's flange frame, or "".
        controller: One of `CONTROLLERS`, or None.
    """
    count = sum(joint.actuated for joint in joints)
    name, brand = ("", None) if controller is None else CONTROLLERS[controller]
    found = ControllerProposal([f"J{k}" for k in range(1, count + 1)], [1] * count, [0.0] * count)
    gaps = ["joint names, configuration words and pendant frame: give --controller"]
    if brand is not None:
        found = propose_counting(brand, joints, flange)
        gaps = list(found.missing)
    turn, source = None, f"assumed: usual for {name}, from the geometry; jog to check"
    beyond = urdf.chain_to(stated)[0] if stated else []
    if flange in (stated, *(joint.parent for joint in beyond)):
        first = next((k for k, joint in enumerate(beyond) if joint.parent == flange), len(beyond))
        turn = _rotation_along(beyond[first:])
    if found.pendant is None and turn is not None:
        found.pendant = [[round(float(value), 9) + 0.0 for value in turn[:, k]] for k in (0, 2)]
        source = f"tool0 of {urdf.file.name}" if axis is None else f"--tool-axis {axis}; where x points is not known"
    elif found.pendant and turn is not None and turn[:, 0] @ found.pendant[0] < np.cos(np.radians(STRAIGHT)):
        gaps.append(f"flange frame of the pendant: {stated} of the URDF has another x than {name} usually has")
    out = Rotation.from_euler("xyz", [float(word) for word in TURNS[axis or "z"].split()]).as_matrix()[:, 2]
    return gaps, _render(
        "controller.toml", **vars(found), controller=name, source=source, flange=repr(flange),
        out=[round(float(value)) + 0.0 for value in out],
    )  # fmt: skip


def _find_tip(urdf: Urdf) -> str:
    """Find the link moved by most joints; among several the one with the longest chain."""
    tips = set(urdf.links) - {joint.parent for joint in urdf.joints}
    chains = {}
    for tip in sorted(tips):
        try:
            chains[tip] = urdf.chain_to(tip)[0]
        except InputError:
            continue
    if not chains:
        raise InputError("no joint moves any link of this URDF", file=urdf.file)
    return max(chains, key=lambda tip: (sum(joint.actuated for joint in chains[tip]), len(chains[tip])))
