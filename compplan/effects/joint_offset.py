"""joint_offset: the zero of a joint is off; motor-side and link-side encoders share the zero."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.folding import shift_zero
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot

name = "joint_offset"
words = "the zero of {at} is off"
follows = "posture"
#: Assumed: a zero found with a dial gauge.
SCALE = 1e-3


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every joint."""
    for index, joint in enumerate(at.robot.actuated):
        key = "offset_m" if joint.kind == "prismatic" else "offset_rad"
        yield Signature(name, joint.name, None, "", (key,), np.array([SCALE]), at.motion[:, :, index, None])


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the offset into the joint's origin."""
    return shift_zero(robot, str(effect.joint), float(next(iter(effect.parameters.values()))))
