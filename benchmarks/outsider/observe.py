"""What the true robot does in a campaign, beside what the nominal folder predicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Sized
from benchmarks.outsider.everyday import Everyday
from benchmarks.outsider.robots import Robot
from benchmarks.outsider.statics import State, solve_statics
from benchmarks.outsider.turns import Array, rotation_vectors, transpose


class Seen(NamedTuple):
    """Gap (n, 6) [m, rad], true position (n, 3) and rotation (n, 3, 3), logged wrench (n, 6)."""

    gap: Array
    position: Array
    rotation: Array
    wrench: Array


def sags(causes: Sequence[Sized]) -> bool:
    """Whether the nominal folder leaves gravity out."""
    return any(c.cause.effect == "gravity_sag" for c in causes)


def make_true(
    robot: Robot,
    campaign: Campaign,
    causes: Sequence[Sized],
    everyday: Sequence[Everyday],
    scatter: Array | None = None,
    gravity: bool = True,
) -> State:
    """The true robot: masses of a sag, everyday errors, the other causes, then the scatter of the joints (n, count)."""
    state = State(robot, campaign.q, campaign.wrench, gravity)
    for cause, size in causes:
        if cause.effect == "gravity_sag":
            cause.apply(state, campaign, size)
    for error in everyday:
        error.apply(state, campaign, error.size)
    for cause, size in causes:
        if cause.effect != "gravity_sag":
            cause.apply(state, campaign, size)
    if scatter is not None:
        state.q += scatter
    return state


def observe(
    robot: Robot,
    campaign: Campaign,
    causes: Sequence[Sized],
    everyday: Sequence[Everyday],
    scatter: Array | None = None,
    without: int | None = None,
) -> Seen:
    """True pose minus the nominal prediction with the logged wrench; `without` leaves one cause out of the truth."""
    there = [c for i, c in enumerate(causes) if i != without]
    weightless = sags(causes) and not sags(there)
    true = solve_statics(make_true(robot, campaign, there, everyday, scatter, not weightless))
    wrench = campaign.wrench
    for cause, size in there:
        if cause.mislog:
            wrench = cause.mislog(campaign, wrench, size)
    nominal = solve_statics(State(robot, campaign.q, wrench, gravity=not sags(causes)))
    turn = rotation_vectors(true.rotation @ transpose(nominal.rotation))
    gap = np.concatenate([true.position - nominal.position, turn], 1)
    return Seen(gap, true.position, true.rotation, wrench)
