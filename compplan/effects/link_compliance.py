"""link_compliance: a link or bearing bends about (or along) an axis that the model holds rigid."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.folding import add_compliance, find_joint
from compplan.effects.linearization import AXES, Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot
from compplan.robot.springs import own_sign

name = "link_compliance"
words = "the link behind {at} bends where the model holds it rigid"
follows = "load"
#: Compliance of links and bearings over the usual one of the joints: about an axis, and along an axis at a lever of
#: half a metre (assumed). [-, m^2]
SHARE = {"r": 1.0, "t": 0.25}
KEYS = {"r": "compliance_rad_per_Nm", "t": "compliance_m_per_N"}


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every loaded axis of every moving link except the joint axis."""
    for joint in at.robot.actuated:
        for axis in AXES:
            if own_sign(joint, axis):
                continue
            load = at.joint_load(joint.name, axis)
            if not np.any(np.abs(load) > 1e-9):
                continue
            twist = (at.twist(joint.name, axis) * load[:, None])[:, :, None]
            scale = np.array([SHARE[axis[0]] * at.usual_compliance])
            yield Signature(name, joint.name, axis, "", (KEYS[axis[0]],), scale, twist, positive=True)


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the compliance into a spring of the joint's child link."""
    joint = find_joint(robot, effect.joint)
    return add_compliance(robot, joint.name, str(effect.axis), float(next(iter(effect.parameters.values()))))
