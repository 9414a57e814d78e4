"""thermal_drift: links grow as the robot warms up (since the first row)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.measurement.campaign import Campaign
from compplan.robot import Array
from compplan.robot.mounting import mounted_tool

name = "thermal_drift"
words = "the links grow as the robot warms up"
sits, follows = "links", "temperature and time"
#: Assumed: expansion of steel and aluminium; without temperature, over ten kelvin.
SCALE_PER_K, SCALE = 1.5e-5, 1.5e-4
TIME_CONSTANTS = (900.0, 1300.0, 1800.0, 2300.0, 3000.0, 3900.0, 5000.0, 7000.0, 10000.0)
LINK_BY_LINK = (900.0, 3000.0, 10000.0)


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a growth of all links alike, and link by link, with temperature or, without one, with time."""
    arms = segments(at)
    for label, warming, fixed, key, scale in _warmings(at.campaign):
        if float(np.ptp(warming)) * scale < 1e-6:
            continue
        twist = np.zeros((len(arms), 6, arms.shape[1]))
        twist[:, :3] = np.swapaxes(arms, 1, 2) * warming[:, None, None]
        alike = twist.sum(axis=-1, keepdims=True)
        yield Signature(name, None, None, f"alike{label}", (key,), np.array([scale]), alike, fixed=fixed, positive=True)
        if "time_constant_s" in fixed and fixed["time_constant_s"] not in LINK_BY_LINK:
            continue
        keys = tuple(f"segment_{key}#{k}" for k in range(arms.shape[1]))
        yield Signature(
            name, None, None, f"links{label}", keys, np.full(len(keys), scale), twist, fixed=fixed, positive=True
        )


def segments(at: Linearization) -> Array:
    """Return the placement before each joint, and of the flange behind the last, base axes. Shape (n, nq + 1, 3). [m].

    Neither the travel of a slide nor the tool grows.
    """
    frames, chain = at.attained.frames, at.attained.chain
    origin, axis = frames.origin[:, chain.joint_elements], frames.axis[:, chain.joint_elements]
    travel = (at.attained.q * chain.translates[chain.joint_elements])[:, :, None] * axis
    T_flange_tcp = mounted_tool(at.robot)
    flange = frames.tcp_position - frames.tcp_rotation @ T_flange_tcp[:3, :3].T @ T_flange_tcp[:3, 3]
    starts = np.concatenate([np.zeros_like(origin[:, :1]), origin + travel], axis=1)
    return np.asarray(np.concatenate([origin, flange[:, None]], axis=1) - starts)


def _warmings(campaign: Campaign) -> list[tuple[str, Array, dict[str, Any], str, float]]:
    """Return the possible courses of the warm-up: label, course, settings, key, scale."""
    if campaign.warming is not None:
        fixed = {"reference_temperature_C": campaign.reference_temperature}
        return [("", campaign.warming, fixed, "growth_per_K", SCALE_PER_K)]
    if campaign.time is None:
        return []
    return [
        (f" {tau:.0f} s", warm_up(campaign, tau), {"time_constant_s": tau}, "growth_ratio", SCALE)
        for tau in TIME_CONSTANTS
    ]


def warm_up(campaign: Campaign, time_constant: float) -> Array:
    """Return 1 - exp(-t/tau) since the beginning. Shape (n,)."""
    if campaign.time is None:
        return np.zeros(len(campaign))
    return np.asarray(1.0 - np.exp(-np.maximum(np.nan_to_num(campaign.time), 0.0) / time_constant))


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Scale the placements by the growth."""
    values, campaign = effect.parameters, model.campaign
    if "time_constant_s" in values:
        course, key = warm_up(campaign, float(values["time_constant_s"])), "growth_ratio"
    elif campaign.temperature is None:
        return model
    else:
        change = campaign.reference_temperature - float(values["reference_temperature_C"])
        course = np.zeros(len(campaign)) if campaign.warming is None else campaign.warming + change
        key = "growth_per_K"
    sizes = np.zeros(model.growth.shape[1])
    if key in values:
        sizes = sizes + float(values[key])
    if f"segment_{key}" in values:
        sizes = sizes + np.array(values[f"segment_{key}"], float)
    return replace(model, growth=model.growth + course[:, None] * sizes)
