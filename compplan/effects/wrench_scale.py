"""wrench_scale: the force sensor reads with a wrong gain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature

name = "wrench_scale"
words = "the force sensor reads with a wrong gain"
sits, follows = "force sensor", "load"
of_instrument = True
KEY = "gain_error_ratio"
#: Assumed: a sensor out of calibration.
SCALE = 0.1


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return one gain error for force and moment: reported = (1 + gain error) true."""
    if not at.campaign.load_varies or not at.attained.chain.n_springs:
        return
    twist, encoder = at.wrench_response(-at.scene.wrench[:, :, None])
    yield Signature(name, None, None, "", (KEY,), np.array([SCALE]), twist, encoder)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Divide the sensor readings by the gain."""
    gain = max(1.0 + float(effect.parameters[KEY]), 0.1)
    return replace(model, wrench=model.wrench / gain)
