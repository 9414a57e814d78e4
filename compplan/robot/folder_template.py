"""Template of a robot folder from a URDF or xacro file, with a comment at each key."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.robot.brands import CONTROLLERS, ControllerProposal, propose_counting
from compplan.robot.description import find_mesh_files, read_description
from compplan.robot.model import Array, Joint
from compplan.robot.rating import Rating, check_mass, sum_arm_mass
from compplan.robot.urdf import Urdf, read_urdf

_HEAD = """\
# What bends in this robot. Fill in what you know; a number that nobody measured says "assumed" in its source.
# {opening}

schema  = 1
grade   = {grade:<25} # placeholder | scaled | literature | identified
tcp     = "{tcp}"                   # URDF frame of the tool centre point, z out of the tool
# flange = "{parent}"               # frame that tools are mounted on; left out: the tcp's parent
{gravity}
acceleration_limits = [{accelerations}]  # rad/s^2 (m/s^2), assumed: full speed after half a second
# repeatability_mm  = 0.03          # one standard deviation an axis: the data sheet's value / 3.6 for isotropic scatter

[sources]
compliance    = "{compliance}"
geometry      = "URDF: {file}"
masses        = "{masses}"
limits        = "URDF: {file}{effort}"
accelerations = "assumed: full speed after half a second"

# One block a spring; compliance in rad/(N m), or m/N for a slide. The robots that ship with compplan show the size to
# expect (robots/*/elasticity.toml); compplan identify or diagnose finds yours.
"""
_RIGID = "As it stands the robot is rigid: a plan corrects nothing, an identification or a diagnosis starts from it."
_RULE = "Springs by payload and reach, a rule found on other arms (docs/robots.md): measure before you correct a part."
_SPRING = """
# [[spring]]
# joint      = "{joint}"
# axis       = "own"
# compliance = {compliance}
"""
_CONTROLLER = """\
# How the controller of this robot counts joints, and its teach pendant tools.
# {state}
# Compare two postures with the display, then set checked = true. Until then programs say that it is not checked.
# controller_deg = sign * q_deg + zero_deg{coupled}

schema      = 1
checked     = false
controller  = {controller:<20}  # such as "KUKA KRC4": programs of its brand are then written without asking
joint_names = [{names}]
sign        = {sign}
zero_deg    = {zero}
{coupling}{world}{words}
# The flange frame from which the teach pendant counts tools (tool 0, all zero): its x and z in axes of {flange!r}.
{pendant}"""
_STATED = """\
[pendant]
x         = {x}
z         = {z}
confirmed = false
source    = "{source}"
"""
_OPEN = """\
# [pendant]
# x         = [1.0, 0.0, 0.0]       # not known: jog along +x of tool 0 and see where the flange goes
# z         = {z}
# confirmed = false
# source    = "jogged on the machine"
"""
_SOURCE = """\
# Where this folder comes from

- Geometry, limits and masses: {file}.
- {rating}: as given to compplan init robot.
- Compliances and accelerations are assumed; see elasticity.toml.
"""
_TIP = """\
  <!-- compplan: the tool leaves along {axis} of {parent}; z of this frame points out of it -->
  <link name="{name}"/>
  <joint name="{name}_fixed" type="fixed">
    <origin xyz="0 0 0" rpy="{rpy}"/>
    <parent link="{parent}"/>
    <child link="{name}"/>
  </joint>
"""
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
    axis = tool_axis if tool_axis is not None else find_tool_axis(urdf, tcp)
    if axis is None:
        raise InputError(ask_tool_axis(urdf, tcp), file=file)
    if axis not in TURNS:
        raise InputError(f"--tool-axis is {axis!r}, choose from {list(TURNS)}")
    parent = joints[-1].parent if joints[-1].kind == "fixed" else tcp
    turned = axis != "z"
    stated = "tool0" if "tool0" in urdf.links and not turned else ""
    if turned:
        had = "tool0" in urdf.links
        text, parent, tcp = _add_tip(text, urdf, tcp, axis)
        urdf = read_urdf(text, file)
        joints, _ = urdf.chain_to(tcp)
        stated = tcp if had else ""
    elasticity, springs, fault = _write_elasticity(urdf, joints, tcp, parent, file, rating)
    gaps, written = _write_controller(urdf, joints, parent, axis if turned else None, stated, controller)
    if fault:  # inertia uses masses even without gravity
        text = re.sub(r"<inertial\b.*?</inertial>\s*", "", text, flags=re.DOTALL)
    texts = {"robot.urdf": text, "elasticity.toml": elasticity, "controller.toml": written}
    if rating is not None:
        texts["SOURCE.md"] = _SOURCE.format(file=file.name, rating=rating.text)
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
    arm = moving[-6:]
    ruled = rating is not None and len(arm) == 6 and all(joint.kind != "prismatic" for joint in arm)
    ruled = ruled and all(joint.kind == "prismatic" for joint in moving[:-6])
    name, weight = file.name.replace("\\", "/").replace('"', "'"), "gravity = [0.0, 0.0, -9.81]"
    masses = f"left out: {fault}" if fault else f"URDF: {name}" if mass else "none in the URDF"
    if fault or not mass:
        weight = f"{f'# {weight}':<36}# m/s^2, base frame; no link has a mass"
    else:
        weight = f"{weight:<36}# m/s^2, base frame; left out: weight is no load"
    unstated = [joint.name for joint in moving if not np.isfinite(joint.effort)]
    head = _HEAD.format(
        opening=_RULE if ruled else _RIGID,
        grade='"placeholder"' if rating is None or not ruled else f'"{rating.grade}"',
        tcp=tcp, parent=flange, file=name, gravity=weight, masses=masses,
        effort=f"; effort of {', '.join(unstated)} not stated" if unstated else "",
        compliance="assumed: by payload and reach, a rule found on other arms; docs/robots.md" if ruled else
        "assumed: none known, rigid",
        accelerations=", ".join(f"{2.0 * _velocity(joint):.3g}" for joint in moving),
    )  # fmt: skip
    if ruled and rating is not None:
        numbers = rating.estimate_compliances()
        blocks = [
            _SPRING.format(joint=joint.name, compliance=f"{value:.3g}").replace("# ", "")
            for joint, value in zip(arm, numbers, strict=True)
        ]
        return head + "".join(blocks), 6, fault
    blocks = [
        _SPRING.format(joint=joint.name, compliance="1e-8" if joint.kind == "prismatic" else "1e-6") for joint in moving
    ]
    return head + "".join(blocks), 0, fault


def find_tool_axis(urdf: Urdf, tcp: str) -> str | None:
    """Return the axis of a frame that points out of the tool: z of a tool0 along the last joint's axis, else None.

    Other frames (ee_link, link_6) follow no convention.
    """
    joints = urdf.chain_to(tcp)[0]
    turns = [k for k, joint in enumerate(joints) if joint.actuated and joint.kind != "prismatic"]
    if tcp != "tool0" or not turns:
        return None
    return "z" if abs(float(_last_axis(joints, turns[-1])[2])) > np.cos(np.radians(STRAIGHT)) else None


def ask_tool_axis(urdf: Urdf, tcp: str) -> str:
    """Return the question for --tool-axis, with the axis of the last joint."""
    joints = urdf.chain_to(tcp)[0]
    turns = [k for k, joint in enumerate(joints) if joint.actuated and joint.kind != "prismatic"]
    hint = ""
    if turns:
        axis = _last_axis(joints, turns[-1])
        k = int(np.abs(axis).argmax())
        if abs(axis[k]) > np.cos(np.radians(STRAIGHT)):
            name = "xyz"[k]
            hint = f" (its last joint turns about {name} of it: a straight tool leaves along {name} or -{name})"
    return f"does not say which axis of {tcp!r} points out of the tool{hint}; give --tool-axis x, -x, y, -y, z or -z"


def _last_axis(joints: Sequence[Joint], last: int) -> Array:
    """Return the axis of a joint in the frame at the end of the chain. Shape (3,)."""
    turn = np.eye(3)
    for joint in joints[last + 1 :]:
        turn = turn @ joint.placement[:3, :3]
    return np.asarray(turn.T @ joints[last].axis)


def _add_tip(text: str, urdf: Urdf, tcp: str, axis: str) -> tuple[str, str, str]:
    """Add a frame with z out of the tool; return the URDF, the parent frame and the name."""
    name = next(name for name in ("tool0", "tool_tip", "compplan_tip") if name not in urdf.links)
    head, end, rest = text.rpartition("</robot>")
    return f"{head}{_TIP.format(axis=axis, parent=tcp, name=name, rpy=TURNS[axis])}{end}{rest}", tcp, name


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
    turn = None if not stated else _turn_between(joints if stated == joints[-1].child else urdf.chain_to(stated)[0],
                                                 flange)  # fmt: skip
    if found.pendant is not None:
        x, z = found.pendant
        if turn is not None and np.degrees(np.arccos(np.clip(turn[:, 0] @ np.array(x), -1.0, 1.0))) > STRAIGHT:
            gaps.append(f"flange frame of the pendant: {stated} of the URDF has another x than {name} usually has")
        pendant = _STATED.format(x=x, z=z, source=f"assumed: usual for {name}, from the geometry; jog to check")
    elif turn is not None:
        x, z = ([round(float(value), 9) + 0.0 for value in turn[:, k]] for k in (0, 2))
        source = f"tool0 of {urdf.file.name}" if axis is None else f"--tool-axis {axis}; where x points is not known"
        pendant = _STATED.format(x=x, z=z, source=source)
    else:
        out = np.zeros(3)
        out["xyz".index((axis or "z")[-1])] = -1.0 if (axis or "z")[0] == "-" else 1.0
        pendant = _OPEN.format(z=out.tolist())
    state = "Nothing here is checked: fill it in." if brand is None else (
        "Derived from the geometry and what is usual for the maker, NOT checked.")  # fmt: skip
    coupling, world = "", ""
    if found.coupling is not None:
        coupling = "coupling    = [\n" + "".join(f"    {row},\n" for row in found.coupling) + "]\n"
    if found.world_mm is not None:
        remark = "# where axis 1 meets the height of axis 2"
        world = f"\n{'[world]':<35}{remark}\nposition_mm = {found.world_mm}\n"
    words = "".join("\n".join([f"\n[configuration.{key}]", *lines, ""]) for key, lines in found.words.items())
    return gaps, _CONTROLLER.format(
        state=state, coupled=" + coupling @ q_deg" if coupling else "", controller=f'"{name}"', sign=found.sign,
        zero=found.zero_deg, coupling=coupling, world=world, words=words, flange=flange, pendant=pendant,
        names=", ".join(f'"{joint}"' for joint in found.joint_names),
    )  # fmt: skip


def _turn_between(joints: Sequence[Joint], flange: str) -> Array | None:
    """Return the rotation of the end of a chain in the flange frame; None without a flange. Shape (3, 3)."""
    if flange == joints[-1].child:
        return np.eye(3)
    turn = None
    for joint in joints:
        if joint.parent == flange:
            turn = np.eye(3)
        turn = None if turn is None else turn @ joint.placement[:3, :3]
    return turn


def _find_tip(urdf: Urdf) -> str:
    """Find the link moved by most joints; of several the last one of the longest chain."""
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


def _velocity(joint: Joint) -> float:
    return joint.velocity if np.isfinite(joint.velocity) else 1.0
