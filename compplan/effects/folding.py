"""Changes of URDF and springs: zeros, origins, compliances, masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import own_springs
from compplan.robot import Array, Body, Joint, Robot, Spring
from compplan.robot.pose import move_joint


def change_joint(robot: Robot, joint: str, **changes: object) -> Robot:
    """Return the robot with one joint changed."""
    joints = tuple(replace(j, **changes) if j.name == joint else j for j in robot.joints)  # type: ignore[arg-type]
    return replace(robot, joints=joints)


def find_joint(robot: Robot, joint: str | None) -> Joint:
    """Return a joint of the chain by name."""
    return next(j for j in robot.joints if j.name == joint)


def shift_zero(robot: Robot, joint: str, offset: float) -> Robot:
    """Add a constant to a joint's position by turning (or moving) its origin about (or along) the joint axis.

    Mimic joints follow the true position, so their origins turn by their share.
    """
    for follower in robot.joints:
        if follower.mimic is not None and follower.mimic.joint == joint:
            robot = _shift_own(robot, follower.name, offset * follower.mimic.multiplier)
    return _shift_own(robot, joint, offset)


def _shift_own(robot: Robot, joint: str, offset: float) -> Robot:
    old = find_joint(robot, joint)
    return change_joint(robot, joint, placement=old.placement @ move_joint(old, offset))


def add_own_compliance(robot: Robot, joint: str, change: float) -> Robot:
    """Add to the compliance about a joint axis (at least 0); a rigid joint gets a spring."""
    index = robot.joint_names.index(joint)
    own = own_springs(robot)
    if index in own:
        number = own[index].spring
        springs = list(robot.springs)
        springs[number] = replace(springs[number], compliance=max(springs[number].compliance + change, 0.0))
        return replace(robot, springs=tuple(springs))
    spring = Spring(joint, "own", max(change, 0.0), actuator=True)
    first = next((k for k, s in enumerate(robot.springs) if s.joint == joint), len(robot.springs))
    return replace(robot, springs=(*robot.springs[:first], spring, *robot.springs[first:]))


def add_compliance(robot: Robot, joint: str, axis: str, change: float) -> Robot:
    """Add to the compliance of a joint's child link about an axis of its frame; a rigid link gets a spring."""
    springs = list(robot.springs)
    for number, spring in enumerate(springs):
        if spring.joint == joint and spring.axis == axis and not np.any(spring.offset):
            springs[number] = replace(spring, compliance=max(spring.compliance + change, 0.0))
            return replace(robot, springs=tuple(springs))
    return replace(robot, springs=(*springs, Spring(joint, axis, max(change, 0.0), actuator=False)))


def add_payload(robot: Robot, payload: Array) -> Robot | None:
    """Add a mass to the flange link; None if the URDF cannot express it.

    payload: mass and first moments about the flange, flange axes, (4,). [kg, kg m]
    """
    present = [body for body in robot.bodies if body.link == robot.flange]
    if robot.gravity is None or len(present) > 1:
        return None
    mass = sum(body.mass for body in present)
    moment = sum((body.mass * body.centre for body in present), np.zeros(3)) + payload[1:]
    total = mass + float(payload[0])
    if total < 0.01:
        return None
    body = Body(robot.flange, total, moment / total)
    return replace(robot, bodies=(*(b for b in robot.bodies if b.link != robot.flange), body))


def base_joint(robot: Robot) -> str | None:
    """Return the fixed joint at the base origin for springs of the base plate, or None."""
    first = robot.joints[0] if robot.joints else None
    if first is None or first.kind != "fixed" or not np.allclose(first.placement, np.eye(4), rtol=0, atol=1e-12):
        return None
    return first.name
