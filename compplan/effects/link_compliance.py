"""link_compliance: a link or bearing bends about (or along) an axis that the model holds rigid."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.folding import add_compliance, find_joint
from compplan.effects.linearization import AXES, Linearization
from compplan.effects.scene import Scene, own_sign
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot

name = "link_compliance"
#: What it says; {at} is its place.
words = "the link behind {at} bends where the model holds it rigid"
#: What its error follows.
follows = "load"
#: Assumed: bearings and links of industrial arms, about and along an axis.
SCALE = {"r": 4e-7, "t": 1e-7}
KEYS = {"r": "compliance_rad_per_Nm", "t": "compliance_m_per_N"}


def signatures(at: Linearization) -> Iterable[Signature]:
    """Offer every axis of every moving link but the joint's own axis, where it is loaded."""
    for joint in at.robot.actuated:
        for axis in AXES:
            if own_sign(joint.axis, axis, joint.kind == "prismatic"):
                continue
            load = at.joint_load(joint.name, axis)
            if not np.any(np.abs(load) > 1e-9):
                continue
            twist = (at.twist(joint.name, axis) * load[:, None])[:, :, None]
            yield Signature(
                name, joint.name, axis, "", (KEYS[axis[0]],), np.array([SCALE[axis[0]]]), twist, positive=True
            )


def apply(scene: Scene, effect: Effect) -> Scene:
    """Let the link bend."""
    return replace(scene, robot=fold(scene.robot, effect))


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the compliance into a spring of the joint's child link."""
    joint = find_joint(robot, effect.joint)
    return add_compliance(robot, joint.name, str(effect.axis), float(next(iter(effect.parameters.values()))))
