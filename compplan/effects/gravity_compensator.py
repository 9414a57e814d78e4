"""gravity_compensator: a balancing spring or cylinder loads a joint."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array

name = "gravity_compensator"
words = "a balancing spring or cylinder loads {at}"
follows = "gravity"
#: Assumed: a balancer of a heavy robot.
SCALE = 1000.0
#: Second harmonics of a balancer over its first (assumed).
HIGHER = 0.5
#: Least load by weights of a joint with a balancer, over that of the most loaded joint.
WORTH_BALANCING = 0.2
#: Least mass of the links of an arm with a balancer (assumed). [kg]
LEAST_MASS = 60.0
FORMS = {
    "sine": ("sine_Nm", "cosine_Nm"),
    "sine+constant": ("sine_Nm", "cosine_Nm", "constant_Nm"),
    "two harmonics": ("sine_Nm", "cosine_Nm", "sine_2_Nm", "cosine_2_Nm"),
    "two harmonics+constant": ("sine_Nm", "cosine_Nm", "constant_Nm", "sine_2_Nm", "cosine_2_Nm"),
}


def shapes(angle: Array) -> dict[str, Array]:
    """Return the shapes of the load over the joint's angle."""
    return {
        "sine_Nm": np.sin(angle),
        "cosine_Nm": np.cos(angle),
        "constant_Nm": np.ones_like(angle),
        "sine_2_Nm": np.sin(2 * angle),
        "cosine_2_Nm": np.cos(2 * angle),
    }


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every sprung revolute joint of a heavy arm that weights load."""
    if sum(body.mass for body in at.robot.bodies) < LEAST_MASS:
        return
    weight = np.abs(at.own_weight_load).max(axis=0, initial=0.0)
    balanced = weight >= WORTH_BALANCING * weight.max(initial=0.0)
    motor_side = ~at.campaign.link_controlled
    for index, spring in at.own.items():
        joint = at.robot.actuated[index]
        if spring.compliance <= 0 or joint.kind != "revolute" or not balanced[index]:
            continue
        parts = shapes(np.nan_to_num(at.campaign.q[:, index]))
        for form, keys in FORMS.items():
            bent = spring.compliance * np.stack([parts[key] * motor_side for key in keys], axis=-1)
            twist, encoder = at.joint_response(index, bent, spring=True)
            scale = np.array([SCALE * (HIGHER if "_2_" in key else 1.0) for key in keys])
            yield Signature(name, joint.name, None, form, keys, scale, twist, encoder, columns=keys)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the load of the compensator to the spring of the joint."""
    index = model.joint_index(effect.joint)
    parts = shapes(np.nan_to_num(model.campaign.q[:, index]))
    loads = [float(value) * parts[key] for key, value in effect.parameters.items() if key in parts]
    return model.add_to_joint("joint_load", index, np.sum(loads, axis=0))
