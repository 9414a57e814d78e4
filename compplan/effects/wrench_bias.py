"""wrench_bias: the force sensor reads with a constant offset, in sensor (TCP) or in base axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

name = "wrench_bias"
#: What it says; {at} is its place.
words = "the force sensor reads with a constant offset"
#: Where it sits and what its error follows.
sits, follows = "force sensor", "load"
#: It is no part of where the tool goes: the instrument, a sensor or a clock has it.
of_instrument = True
#: Rows that read exactly zero come from no sensor with an offset, nor from any sensor with noise; so many are no chance
#: (assumed).
ZERO_ROWS = 3
KEYS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Assumed: a tool whose weight was not tared.
SCALE = np.array([50.0, 50.0, 50.0, 10.0, 10.0, 10.0])


def signatures(at: Linearization) -> Iterable[Signature]:
    """Offer an offset of force and moment, or of the force alone, in base axes and in those of the TCP."""
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
        yield Signature(name, None, None, axes, KEYS, SCALE, twist, encoder, fixed, columns=columns)
        yield Signature(
            name,
            None,
            None,
            f"{axes}, force",
            KEYS[:3],
            SCALE[:3],
            twist[:, :, :3],
            encoder[:, :, :3],
            fixed,
            columns=columns[:3],
        )


def apply(scene: ForwardModel, effect: Effect) -> ForwardModel:
    """Take the offset off what the sensor reports."""
    bias = np.array([float(effect.parameters.get(key, 0.0)) for key in KEYS])
    return replace(scene, wrench=scene.wrench - _in_base_axes(scene, bias, str(effect.parameters["axes"])))


def _in_base_axes(scene: ForwardModel, bias: Array, axes: str) -> Array:
    if axes == "base":
        return np.broadcast_to(bias, scene.wrench.shape)
    q = np.nan_to_num(scene.campaign.q) + scene.zero + scene.drive
    R = locate_frames(build_chain(scene.robot), q).tcp_rotation
    return np.concatenate([R @ bias[:3], R @ bias[3:]], axis=1)


def fold(robot: Robot, effect: Effect) -> Robot | None:
    """It is no property of the robot."""
    return None
