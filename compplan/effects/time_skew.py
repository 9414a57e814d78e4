"""time_skew: joint readings and positions were not taken at the same instant."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

name = "time_skew"
words = "joint readings and positions were not taken at the same instant"
sits, follows = "clock", "speed"
of_instrument = True
#: Assumed: a few milliseconds between clocks; readings late by 1e-4 of the move.
SKEW_SCALE, STALE_SCALE = 0.01, 2e-4


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a skew on paths, different encoder clocks, and readings before the arm settled."""
    campaign = at.campaign
    if np.abs(campaign.speed).max(initial=0.0) > 1e-6:
        twist = -np.einsum("nij,nj->ni", at.motion, campaign.speed)[:, :, None]
        yield Signature(name, None, None, "skew", ("skew_s",), np.array([SKEW_SCALE]), twist)
        if campaign.link is not None:
            still, encoder, keys = np.zeros((len(campaign), 6, 1)), campaign.speed[:, :, None], ("encoder_skew_s",)
            yield Signature(name, None, None, "encoder skew", keys, np.array([SKEW_SCALE]), still, encoder)
    move = static_move(campaign)
    if (np.abs(move).max(axis=0, initial=0.0) > 1e-3).any():
        twist = np.einsum("nij,nj->ni", at.motion, move)[:, :, None]
        yield Signature(name, None, None, "stale", ("stale_ratio",), np.array([STALE_SCALE]), twist)


def static_move(campaign: Campaign) -> Array:
    """Return the last move of each joint at settled poses, zero on paths. Shape (n, nq). [rad or m].

    Zero for joints that rested during the last move.
    """
    stay = campaign.stay
    start = np.r_[True, np.diff(stay) > 0]
    source = np.maximum.accumulate(np.where(start, np.arange(len(stay)), 0))
    moves = np.diff(np.nan_to_num(campaign.q), axis=0, prepend=np.nan_to_num(campaign.q[:1]))
    moves[np.r_[True, np.diff(campaign.run_index) > 0]] = 0.0
    return np.asarray(np.where(campaign.on_path[:, None], 0.0, moves[source]))


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Use the joints at the time of the position measurement."""
    campaign, values = model.campaign, effect.parameters
    zero, encoder = model.zero.copy(), model.encoder
    if "skew_s" in values:
        zero += _earlier(campaign, float(values["skew_s"]))
    if "stale_ratio" in values:
        zero += float(values["stale_ratio"]) * static_move(campaign)
    if "encoder_skew_s" in values:
        encoder = encoder + float(values["encoder_skew_s"]) * campaign.speed
    return replace(model, zero=zero, encoder=encoder)


def _earlier(campaign: Campaign, skew: float) -> Array:
    """Return joint positions at an earlier time minus the current ones, on paths. Shape (n, nq). [rad or m]"""
    change = np.zeros_like(campaign.q)
    if campaign.time is None:
        return change
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero(campaign.run_index == number)
        t, q = campaign.time[rows], campaign.q[rows]
        if len(rows) < 3 or not (np.diff(t) > 0).all():
            continue
        at = t - skew
        inside = np.column_stack([np.interp(at, t, column) for column in q.T])
        slope = campaign.speed[rows]
        before, after = (at < t[0])[:, None], (at > t[-1])[:, None]
        inside = np.where(before, q[0] + (at - t[0])[:, None] * slope[0], inside)
        change[rows] = np.where(after, q[-1] + (at - t[-1])[:, None] * slope[-1], inside) - q
    return change
