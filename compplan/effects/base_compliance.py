"""base_compliance: the base plate tilts under load, seen from the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.folding import add_compliance, base_joint
from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot

name = "base_compliance"
#: What it says; {at} is its place.
words = "the base tilts under load about {at}"
#: Where it sits and what its error follows.
sits, follows = "base", "load"
#: A bolted base plate over what is usual for the robot's joints (assumed).
SHARE = 0.25
KEY = "compliance_rad_per_Nm"


def signatures(at: Linearization) -> Iterable[Signature]:
    """Offer a tilt about each base axis through the base origin."""
    for axis in ("rx", "ry", "rz"):
        load = at.joint_load("base", axis)
        if np.any(np.abs(load) > 1e-9):
            twist = (at.twist("base", axis) * load[:, None])[:, :, None]
            yield Signature(name, None, axis, "", (KEY,), np.array([SHARE * at.usual_compliance]), twist, positive=True)


def apply(scene: ForwardModel, effect: Effect) -> ForwardModel:
    """Let the base tilt."""
    folded = fold(scene.robot, effect)
    if folded is not None:
        return replace(scene, robot=folded)
    tilt = scene.tilt.copy()
    tilt["xyz".index(str(effect.axis)[1])] += float(effect.parameters[KEY])
    return replace(scene, tilt=tilt)


def fold(robot: Robot, effect: Effect) -> Robot | None:
    """Write the compliance into a spring of the fixed joint at the base origin, where there is one."""
    joint = base_joint(robot)
    return None if joint is None else add_compliance(robot, joint, str(effect.axis), float(effect.parameters[KEY]))
