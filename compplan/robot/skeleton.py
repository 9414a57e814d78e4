"""A robot folder to fill in, from a URDF alone: what compplan needs besides, each key explained."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.files.tables import read_text
from compplan.robot.model import Joint
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


def write_skeleton(file: Path, tcp: str | None = None) -> dict[str, str]:
    """Write the texts of a robot folder for a URDF.

    Args:
        file: The URDF.
        tcp: Its frame of the tool centre point; left out: the link at the end of the longest chain.

    Returns:
        Text by file name: robot.urdf and elasticity.toml.

    Raises:
        InputError: If the URDF is none, or has no such frame.

    """
    text = read_text(file)
    urdf = read_urdf(text, file)
    if tcp is not None and tcp not in urdf.links:
        raise UnknownNameError("frame", tcp, list(urdf.links), file=file)
    tcp = tcp if tcp is not None else _find_tip(urdf)
    joints, _ = urdf.chain_to(tcp)
    moving = [joint for joint in joints if joint.actuated]
    weighs = any(body.mass > 0.0 for body in urdf.bodies([joints[0].parent, *(joint.child for joint in joints)]))
    head = _HEAD.format(
        tcp=tcp,
        parent=joints[-1].parent,
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
    return {"robot.urdf": text, "elasticity.toml": head + "".join(springs)}


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
