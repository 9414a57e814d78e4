"""tracking_lag: the axes lag behind the command in motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

name = "tracking_lag"
words = "{at} lags behind the command in motion"
sits, follows = "drives", "speed"
#: Assumed: one or two interpolation cycles.
SCALE = 0.01


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every joint that moves on a path, and all of them together."""
    speed = at.campaign.speed * ~at.campaign.link_controlled[:, None]
    moving = [k for k in range(at.robot.nq) if np.abs(speed[:, k]).max(initial=0.0) > 1e-6]
    if not moving:
        return
    for joints, label in [(moving, None), *(([k], at.robot.joint_names[k]) for k in moving)]:
        twist = -np.einsum("nij,nj->ni", at.motion[:, :, joints], speed[:, joints])[:, :, None]
        encoder = np.zeros((len(speed), at.robot.nq, 1))
        encoder[:, joints, 0] = -speed[:, joints]
        scale = np.array([SCALE])
        yield Signature(name, label, None, "", ("lag_s",), scale, twist, encoder, positive=True)


def lagged_speed(campaign: Campaign, lag: float) -> Array:
    """Return the lag distance of each joint per second of lag: the speed, smoothed by the lag.

    Motion is steady at the first row of each path run. Shape (n, nq). [rad/s or m/s]
    """
    result = np.zeros_like(campaign.q)
    if campaign.time is None or lag == 0.0:
        return campaign.speed
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero(campaign.run_index == number)
        steps = np.diff(campaign.time[rows])
        if len(rows) < 3 or not (steps > 0).all():
            continue
        speed = np.diff(campaign.q[rows], axis=0) / steps[:, None]
        keep = np.exp(-steps / abs(lag))
        behind = speed[0]
        result[rows[0]] = behind
        for k, row in enumerate(rows[1:]):
            behind = speed[k] + (behind - speed[k]) * keep[k]
            result[row] = behind
    return result


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Delay the joint, or all joints, by lag times speed."""
    lag = float(effect.parameters["lag_s"])
    behind = -lag * lagged_speed(model.campaign, lag)
    drive = model.drive.copy()
    joints = slice(None) if effect.joint is None else model.joint_index(effect.joint)
    drive[:, joints] += behind[:, joints]
    return replace(model, drive=drive)
