"""How the teach pendant counts tools on a robot, in words that can be checked by jogging."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from compplan.cli.doctor.remarks import Remark
from compplan.controllers.writers.joint_convention import from_controller, load_controller, locate_link
from compplan.controllers.writers.pendant import locate_pendant
from compplan.robot import Array, Robot
from compplan.robot.mounting import mounted_tool, name_axis

#: Angle between the TCP's z and the flange's outward axis from which on the folder's own tool is asked about. [deg]
ASIDE = 60.0


def zero_posture(robot: Robot) -> Array:
    """Return the posture in which the pendant shows 0 for every axis, or the nearest within limits. Shape (nq,)."""
    q = from_controller(load_controller(robot), np.zeros((1, robot.nq)))[0]
    return np.asarray(np.clip(q, robot.lower, robot.upper))


def check_pendant(robot: Robot) -> Iterator[Remark]:
    """Say how tool data of the pendant are counted, and how to check it."""
    found, flange = locate_pendant(robot), robot.flange
    if found is None:
        advice = "write [pendant] with x and z in controller.toml, or give tools in the URDF's flange frame"
        yield Remark("note", "pendant", "the tool frame of the teach pendant is unknown", advice)
        return
    x, z = (name_axis(found.pose[:3, k]) for k in (0, 2))
    said = f"tool data of the teach pendant: x points along {x} and z along {z} of {flange!r} ({found.source})"
    if found.confirmed:
        yield Remark("fine", "pendant", said)
    else:
        why = "taken from the URDF" if not found.stated else "where x points is not confirmed"
        yield Remark("note", "pendant", f"{said}; {why}", "jog along +x of tool 0 before the first cut")
    yield Remark("fine", "jog check", _describe_jog(robot, found.pose))
    yield from _look_at_mounted(robot, found.pose)


def _describe_jog(robot: Robot, pendant: Array) -> str:
    """Say where the flange goes when one jogs along the tool's axes with every axis at 0."""
    q = zero_posture(robot)
    counting = load_controller(robot)
    at_zero = np.allclose(q, from_controller(counting, np.zeros((1, robot.nq)))[0])
    flange = locate_link(robot, q[None], robot.flange)[0] @ pendant
    seen = counting.world[:3, :3].T @ flange[:3, :3]
    x, z = (name_axis(np.where(np.abs(seen[:, k]) < 1e-6, 0.0, seen[:, k])) for k in (0, 2))
    pose = "with every axis at 0" if at_zero else "with every axis as near to 0 as its limits allow"
    return f"{pose}, tool 0 jogs along +x towards {x} and along +z towards {z} of the base frame"


def _look_at_mounted(robot: Robot, pendant: Array) -> Iterator[Remark]:
    """Ask about the folder's own TCP where it leaves the flange sideways."""
    tool = mounted_tool(robot)
    cosine = float(np.clip(tool[:3, 2] @ pendant[:3, 2], -1.0, 1.0))
    angle = float(np.degrees(np.arccos(cosine)))
    if angle > ASIDE:
        yield Remark("odd", "tcp", f"z of {robot.tcp!r} points {angle:.3g} deg away from the flange's outward axis",
                     "z of the TCP frame has to point out of the tool")  # fmt: skip
