"""A robot folder to fill in, from a URDF alone: what compplan needs besides, each key explained."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.io.tables import read_text
from compplan.robot.model import Array, Joint
from compplan.robot.urdf import Urdf, read_urdf

_HEAD = """\
# What bends in this robot. Fill in what you know; a number that nobody measured says "assumed" in its source.
# As it stands the robot is rigid: a plan corrects nothing, an identification or a diagnosis starts from it.

schema  = 1
grade   = "placeholder"             # placeholder | scaled | literature | identified
tcp     = "{tcp}"                   # URDF frame of the tool centre point, z out of the tool
# flange = "{parent}"               # frame that tools are mounted on; left out: the tcp's parent
{gravity}
acceleration_limits = [{accelerations}]  # rad/s^2 (m/s^2), assumed: full speed after half a second
# repeatability_mm  = 0.03          # one standard deviation an axis: the data sheet's value / 3.6 for isotropic scatter

[sources]
compliance    = "assumed: none known, rigid"
geometry      = "URDF: {file}"
masses        = "{masses}"
limits        = "URDF: {file}"
accelerations = "assumed: full speed after half a second"

# One block a spring; compliance in rad/(N m), or m/N for a slide. The robots that ship with compplan show the size to
# expect (robots/*/elasticity.toml); compplan identify or diagnose finds yours.
"""
_SPRING = """
# [[spring]]
# joint      = "{joint}"
# axis       = "own"
# compliance = {compliance}
"""


_CONTROLLER = """\
# How the controller of this robot counts joints, and its teach pendant tools. Nothing here is checked: fill it in,
# compare two postures with the display, then set checked = true. Until then programs say that they do not know it.
# controller_deg = sign * q_deg + zero_deg

schema      = 1
checked     = false
controller  = ""                    # such as "KUKA KRC4": programs of its brand are then written without asking
joint_names = [{names}]
sign        = [{signs}]
zero_deg    = [{zeros}]

# The flange frame from which the teach pendant counts tools (tool 0, all zero): its x and z in axes of {flange!r}.
{pendant}"""
_STATED = """\
[pendant]
x         = {x}
z         = {z}
confirmed = false
source    = "tool0 of {file}"
"""
_OPEN = """\
# [pendant]
# x         = [1.0, 0.0, 0.0]       # not known: jog along +x of tool 0 and see where the flange goes
# z         = {z}
# confirmed = false
# source    = "jogged on the machine"
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
#: Rotations that bring z of a frame to an axis: roll, pitch, yaw. [rad]
TURNS = {
    "x": "0 1.5707963267948966 0", "-x": "0 -1.5707963267948966 0", "y": "-1.5707963267948966 0 0",
    "-y": "1.5707963267948966 0 0", "z": "0 0 0", "-z": "3.141592653589793 0 0",
}  # fmt: skip
#: Greatest angle between tool0's z and the last joint's axis: there the tool leaves straight. [deg]
STRAIGHT = 5.0


def write_skeleton(file: Path, tcp: str | None = None, tool_axis: str | None = None) -> dict[str, str]:
    """Write the texts of a robot folder for a URDF.

    Args:
        file: The URDF.
        tcp: Its frame of the tool centre point; left out: the link at the end of the longest chain.
        tool_axis: Axis of that frame that points out of the tool: "x", "-x", .. "-z". Left out it has to be tool0,
            the all-zero tool of ROS-Industrial, whose z does.

    Returns:
        Text by file name: robot.urdf, elasticity.toml and controller.toml.

    Raises:
        InputError: If the URDF is none, has no such frame, or does not say which axis points out of the tool.

    """
    text = read_text(file)
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
    if axis != "z":
        text, parent, tcp = _add_tip(text, urdf, tcp, axis)
    moving = [joint for joint in joints if joint.actuated]
    weighs = any(body.mass > 0.0 for body in urdf.bodies([joints[0].parent, *(joint.child for joint in joints)]))
    head = _HEAD.format(
        tcp=tcp,
        parent=parent,
        file=file.name,
        gravity="gravity = [0.0, 0.0, -9.81]        # m/s^2, base frame; left out: weight is no load"
        if weighs
        else "# gravity = [0.0, 0.0, -9.81]      # m/s^2, base frame; no link of the URDF has a mass",
        masses=f"URDF: {file.name}" if weighs else "none in the URDF",
        accelerations=", ".join(f"{2.0 * _velocity(joint):.3g}" for joint in moving),
    )
    springs = [
        _SPRING.format(joint=joint.name, compliance="1e-8" if joint.kind == "prismatic" else "1e-6") for joint in moving
    ]
    controller = _write_controller(urdf, parent, axis if parent != joints[-1].parent else None, len(moving))
    return {"robot.urdf": text, "elasticity.toml": head + "".join(springs), "controller.toml": controller}


def find_tool_axis(urdf: Urdf, tcp: str) -> str | None:
    """Return the axis of a frame that points out of the tool, where the URDF says so; None where it does not.

    It does where the frame is called tool0 and its z lies along the last joint's axis: ee_link, link_6 and others have
    x, y or z out, as their authors liked it.
    """
    joints = urdf.chain_to(tcp)[0]
    turns = [k for k, joint in enumerate(joints) if joint.actuated and joint.kind != "prismatic"]
    if tcp != "tool0" or not turns:
        return None
    return "z" if abs(float(_last_axis(joints, turns[-1])[2])) > np.cos(np.radians(STRAIGHT)) else None


def ask_tool_axis(urdf: Urdf, tcp: str) -> str:
    """Say that the URDF does not tell which axis points out of the tool, and what the last joint turns about."""
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
    """Return the axis of a joint as the frame at the end of the chain sees it. Shape (3,)."""
    turn = np.eye(3)
    for joint in joints[last + 1 :]:
        turn = turn @ joint.placement[:3, :3]
    return np.asarray(turn.T @ joints[last].axis)


def _add_tip(text: str, urdf: Urdf, tcp: str, axis: str) -> tuple[str, str, str]:
    """Add a frame whose z points out of the tool; return the URDF, the frame that it stands on, and its name."""
    name = next(name for name in ("tool0", "tool_tip", "compplan_tip") if name not in urdf.links)
    head, end, rest = text.rpartition("</robot>")
    return f"{head}{_TIP.format(axis=axis, parent=tcp, name=name, rpy=TURNS[axis])}{end}{rest}", tcp, name


def _write_controller(urdf: Urdf, flange: str, axis: str | None, count: int) -> str:
    """Write controller.toml to be filled in."""
    stated = axis is None and "tool0" in urdf.links and flange in urdf.links
    turn = np.eye(3)
    if stated:
        for joint in urdf.chain_to("tool0")[0]:
            turn = joint.placement[:3, :3] if joint.parent == flange else turn @ joint.placement[:3, :3]
        x, z = ([round(float(value), 9) + 0.0 for value in turn[:, k]] for k in (0, 2))
        pendant = _STATED.format(x=x, z=z, file=urdf.file.name)
    else:
        out = np.zeros(3)
        out["xyz".index((axis or "z")[-1])] = -1.0 if (axis or "z")[0] == "-" else 1.0
        pendant = _OPEN.format(z=out.tolist())
    names = ", ".join(f'"J{number}"' for number in range(1, count + 1))
    signs, zeros = ", ".join(["1"] * count), ", ".join(["0.0"] * count)
    return _CONTROLLER.format(names=names, signs=signs, zeros=zeros, flange=flange, pendant=pendant)


def _find_tip(urdf: Urdf) -> str:
    """Find the link that most moving joints carry; of several the last one of the longest chain."""
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
