"""base_frame: measurement frame and robot base are misaligned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import AXES, Linearization
from compplan.effects.signature import Effect, Signature
from compplan.effects.tool_frame import KEYS, twist_values
from compplan.robot import Array

name = "base_frame"
words = "measurement frame and robot base are misaligned"
sits, follows = "base", "posture"
of_instrument = True
#: Assumed: an instrument set up over a few target points.
SCALE = np.array([1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4])


def base_twists(at: Linearization) -> Array:
    """Return the motion of the target per motion of the base frame along and about its axes. Shape (n, 6, 6)."""
    return np.stack([at.twist("base", axis) for axis in AXES], axis=-1)


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return the complete frame, its origin alone, and its directions alone."""
    frame = Signature(name, None, None, "frame", KEYS, SCALE, base_twists(at), columns=KEYS)
    yield from (frame, frame.part("origin", slice(3)), frame.part("directions", slice(3, None)))


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Displace the robot in the measurement frame."""
    return replace(model, base_twist=model.base_twist + twist_values(effect))
