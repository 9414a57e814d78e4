"""payload: the mass of tool or payload, or its centre, differs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.folding import add_payload
from compplan.effects.forward_model import ForwardModel, payload_wrench
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array, Robot

name = "payload"
words = "the mass of tool or payload, or its centre, differs"
sits, follows = "tool", "gravity"
KEYS = ("mass_kg", "first_moment_kg_m#0", "first_moment_kg_m#1", "first_moment_kg_m#2")
#: Assumed: a tenth of a heavy robot's payload, a quarter of a metre off.
SCALE = np.array([20.0, 5.0, 5.0, 5.0])


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a further mass on the flange, alone or with its centre, if it loads springs."""
    if not at.attained.chain.n_springs:
        return
    wrench = np.stack([payload_wrench(at.robot, at.attained.frames, unit) for unit in np.eye(4)], axis=-1)
    twist, encoder = at.wrench_response(wrench)
    unbound = -np.inf
    least = (-float(carried_payload(at.robot)[0]), unbound, unbound, unbound)  # the total mass is not negative
    yield Signature(name, None, None, "", KEYS, SCALE, twist, encoder, least=least)


def carried_payload(robot: Robot) -> Array:
    """Return mass and first moments of the modelled load on the flange. Shape (4,). [kg, kg m]"""
    parts = [body.mass * np.append(1.0, body.centre) for body in robot.bodies_on_flange()]
    return np.sum([np.zeros(4), *parts], axis=0)


def payload_values(effect: Effect) -> Array:
    """Return mass and first moments about the flange. Shape (4,). [kg, kg m]."""
    return np.array([effect.parameters["mass_kg"], *effect.parameters["first_moment_kg_m"]], float)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Add the mass to the flange of a robot without gravity in its model."""
    return replace(model, payload=model.payload + payload_values(effect))


def fold(robot: Robot, effect: Effect) -> Robot | None:
    """Write the mass into the flange link, if the robot models gravity."""
    return add_payload(robot, payload_values(effect))
