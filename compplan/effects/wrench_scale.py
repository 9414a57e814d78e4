"""wrench_scale: the force sensor reads with a wrong gain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot

name = "wrench_scale"
#: What it says; {at} is its place.
words = "the force sensor reads with a wrong gain"
#: Where it sits and what its error follows.
sits, follows = "force sensor", "load"
#: It is no part of where the tool goes: the instrument, a sensor or a clock has it.
of_instrument = True
KEY = "gain_error_ratio"
#: Assumed: a sensor out of calibration.
SCALE = 0.1


def signatures(at: Linearization) -> Iterable[Signature]:
    """Offer one gain error for force and moment: reported = (1 + gain error) true."""
    if not at.campaign.load_varies or not at.attained.chain.n_springs:
        return
    twist, encoder = at.wrench_response(-at.scene.wrench[:, :, None])
    yield Signature(name, None, None, "", (KEY,), np.array([SCALE]), twist, encoder)


def apply(scene: ForwardModel, effect: Effect) -> ForwardModel:
    """Divide the gain out of what the sensor reports."""
    gain = max(1.0 + float(effect.parameters[KEY]), 0.1)
    return replace(scene, wrench=scene.wrench / gain)


def fold(robot: Robot, effect: Effect) -> Robot | None:
    """It is no property of the robot."""
    return None
