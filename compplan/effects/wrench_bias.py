"""wrench_bias: the force sensor reads with a constant offset, in sensor (TCP) or in base axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.statics.chain import build_chain, locate_frames

name = "wrench_bias"
words = "the force sensor reads with a constant offset"
sits, follows = "force sensor", "load"
of_instrument = True
#: Number of rows with a wrench of exactly zero that excludes an offset of the sensor (assumed).
ZERO_ROWS = 3
KEYS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Assumed: a tool whose weight was not tared.
SCALE = np.array([50.0, 50.0, 50.0, 10.0, 10.0, 10.0])


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return an offset of force and moment, or of the force alone, in base and in TCP axes."""
    tared = (at.campaign.wrench[at.campaign.usable] == 0.0).all(axis=1)
    if not at.campaign.load_varies or not at.attained.chain.n_springs or tared.sum() >= ZERO_ROWS:
        return
    n = len(at.point)
    base = np.broadcast_to(-np.eye(6), (n, 6, 6))
    R = at.attained.frames.tcp_rotation
    sensor = np.zeros((n, 6, 6))
    sensor[:, :3, :3] = sensor[:, 3:, 3:] = -R
    for axes, wrench in (("base", base), ("sensor", sensor)):
        twist, encoder = at.wrench_response(wrench)
        fixed, columns = {"axes": axes}, tuple(f"{axes} {key}" for key in KEYS)
        both = Signature(name, None, None, axes, KEYS, SCALE, twist, encoder, fixed, columns=columns)
        yield from (both, both.part(f"{axes}, force", slice(3)))


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Subtract the offset from the sensor readings."""
    bias = np.array([float(effect.parameters.get(key, 0.0)) for key in KEYS])
    if effect.parameters["axes"] == "sensor":
        q = np.nan_to_num(model.campaign.q) + model.zero + model.drive
        R = locate_frames(build_chain(model.robot), q).tcp_rotation
        bias = np.concatenate([R @ bias[:3], R @ bias[3:]], axis=1)
    return replace(model, wrench=model.wrench - bias)
