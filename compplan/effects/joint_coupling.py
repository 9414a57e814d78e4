"""joint_coupling: a reading contains another joint's motion, or has the opposite sense of the model."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature

name = "joint_coupling"
words = "the reading of {at} contains another joint's motion, or counts against the model"
follows = "posture"
#: Assumed: a gear that drags its neighbour by a thousandth.
SCALE = 1e-3
#: Greatest distance of coupled joints: hollow wrists and parallelogram arms couple an axis with the next two (theory).
REACH = 2


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return couplings of neighbours of the same kind."""
    q = np.nan_to_num(at.campaign.q)
    for index, joint in enumerate(at.robot.actuated):
        for other, source in enumerate(at.robot.actuated):
            near = 0 < abs(other - index) <= REACH
            if not near or source.kind != joint.kind or float(np.ptp(q[:, other])) < 0.05:
                continue
            twist = at.motion[:, :, index, None] * q[:, None, other, None]
            form, fixed = f"of {source.name}", {"other": source.name}
            yield Signature(name, joint.name, None, form, ("ratio",), np.array([SCALE]), twist, fixed=fixed)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the other joint's share, reverse the joint, or shift its zero far."""
    index, values = model.joint_index(effect.joint), effect.parameters
    q = np.nan_to_num(model.campaign.q)
    shift = np.full(len(q), float(values.get("zero_rad", values.get("zero_m", 0.0))))
    if "other" in values:
        shift += float(values["ratio"]) * q[:, model.joint_index(values["other"])]
    if values.get("reversed", False):
        shift -= 2.0 * q[:, index]
    return model.add_to_joint("zero", index, shift)
