"""base_compliance: the base plate tilts under load in the world frame."""

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
words = "the base tilts under load about {at}"
sits, follows = "base", "load"
#: Compliance of a bolted base plate over the usual one of the robot's joints (assumed).
SHARE = 0.25
KEY = "compliance_rad_per_Nm"


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a tilt about each base axis through the base origin."""
    for axis in ("rx", "ry", "rz"):
        load = at.joint_load("base", axis)
        if np.any(np.abs(load) > 1e-9):
            twist = (at.twist("base", axis) * load[:, None])[:, :, None]
            yield Signature(name, None, axis, "", (KEY,), np.array([SHARE * at.usual_compliance]), twist, positive=True)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the tilt compliance to the model of a robot without a spring at its base."""
    tilt = model.tilt.copy()
    tilt["xyz".index(str(effect.axis)[1])] += float(effect.parameters[KEY])
    return replace(model, tilt=tilt)


def fold(robot: Robot, effect: Effect) -> Robot | None:
    """Write the compliance into a spring of the fixed joint at the base origin, if there is one."""
    joint = base_joint(robot)
    return None if joint is None else add_compliance(robot, joint, str(effect.axis), float(effect.parameters[KEY]))
