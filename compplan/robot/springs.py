"""Names and possible places of springs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compplan.errors import InputError, UnknownNameError
from compplan.robot.model import SPRING_AXES, Joint, Robot, Spring


def missing_springs(robot: Robot) -> tuple[Spring, ...]:
    """List springs of compliance zero about (or along) the axes of the commanded joints that have none yet."""
    own = [spring for spring in robot.springs if is_own(robot, spring)]
    taken = {spring.joint for spring in own if spring.actuator or spring.axis != "own"}
    return tuple(Spring(joint.name, "own", 0.0, actuator=True) for joint in robot.actuated if joint.name not in taken)


def label_spring(spring: Spring) -> str:
    """Name a spring; a joint spring beyond the link-side encoder is "joint_3.link"."""
    return f"{spring.joint}.link" if spring.axis == "own" and not spring.actuator else spring.name


def link_springs(robot: Robot) -> tuple[Spring, ...]:
    """List springs of compliance zero about joint axes, beyond the link-side encoders [Klimchik2018, eq. 5]."""
    taken = {spring.joint for spring in robot.springs if is_own(robot, spring) and not spring.actuator}
    return tuple(Spring(j.name, "own", 0.0, actuator=False) for j in robot.actuated if j.name not in taken)


def is_own(robot: Robot, spring: Spring) -> bool:
    """Return whether a spring acts about or along the axis of its joint."""
    joint = next(joint for joint in robot.joints if joint.name == spring.joint)
    return own_sign(joint, spring.axis) != 0.0


def own_sign(joint: Joint, axis: str) -> float:
    """Return 1 or -1 if a spring axis is parallel to the joint axis and of its kind, otherwise 0."""
    if axis == "own":
        return 1.0
    if joint.kind == "fixed" or (joint.kind == "prismatic") != axis.startswith("t"):
        return 0.0
    cosine = float(joint.axis["xyz".index(axis[1])])
    return float(np.sign(cosine)) if abs(cosine) > 1 - 1e-6 else 0.0


def number_twins(names: Sequence[str]) -> list[str]:
    """Number repeated names: link_2, link_2 -> link_2#1, link_2#2."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(f"{name}#{seen[name]}" if names.count(name) > 1 else name)
    return result


def read_spring(robot: Robot, name: str) -> Spring:
    """Read "joint_3.rx" or "joint_3" (joint axis) as a spring of compliance zero.

    Raises:
        UnknownNameError: If the joint or axis does not exist.
        InputError: If the robot has that spring already.
    """
    joint, _, axis = name.rpartition(".") if name.rpartition(".")[2] in SPRING_AXES else (name, "", "own")
    joints = {entry.name: entry for entry in robot.joints}
    if joint not in joints:
        raise UnknownNameError("joint", joint, list(joints))
    if axis == "own" and joints[joint].kind == "fixed":
        raise InputError(f"fixed joint {joint!r} has no own axis, name one such as {joint}.rx")
    if any((spring.joint, spring.axis) == (joint, axis) for spring in robot.springs):
        raise InputError(f"spring {name!r} is to be added, but the robot has it already")
    return Spring(joint, axis, 0.0, actuator=axis == "own")
