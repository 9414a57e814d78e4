"""A cause: something that makes the true robot, or its log, differ from the nominal one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.robots import Robot, joint_name
from benchmarks.outsider.statics import State
from benchmarks.outsider.turns import Array, Rng

Apply = Callable[[State, Campaign, float], None]
Key = tuple[str, str | None, str | None]


@dataclass(frozen=True)
class Cause:
    """An effect at a place, with the range of its size.

    `apply(state, campaign, size)` changes the true robot; `mislog(campaign, wrench, size)` the logged wrench; `fixed`
    keeps the size; `needs` says what the campaign or robot must be for it.
    """

    effect: str
    joint: str | None
    axis: str | None
    unit: str
    size: float
    lowest: float
    highest: float
    apply: Apply
    params: Mapping[str, Any] = field(default_factory=dict)
    kind: str | None = None
    note: str | None = None
    mislog: Callable[[Campaign, Array, float], Array] | None = None
    needs: tuple[str, ...] = ()
    fixed: bool = False

    @property
    def key(self) -> Key:
        """Effect, joint and axis."""
        return self.effect, self.joint, self.axis


class Sized(NamedTuple):
    """A cause at a size."""

    cause: Cause
    size: float


Maker = Callable[[Rng, Robot, Campaign], Cause]


def leave_alone(state: State, campaign: Campaign, size: float) -> None:
    """Change nothing of the robot: the cause is in the log."""


def draw_sign(rng: Rng) -> int:
    """1 or -1."""
    return int(rng.choice([-1, 1]))


def follow_play(values: Array, start: float, width: float, soft: float) -> Array:
    """Where a link stands inside a lost motion, turning over within `soft` of a reversal.

    Args:
        values: Joint values in time order. Shape (n,). [rad or m]
        start: Place inside the lost motion at first: 1 the link is ahead, -1 behind.
        width: Full width of the lost motion. [rad or m]
        soft: Half the move that takes the link from one flank to the other. [rad or m]

    Returns:
        Link beside its command. Shape (n,). [rad or m]
    """
    place, x = np.zeros(len(values)), start
    for i in range(len(values)):
        if i:
            x = np.clip(x - (values[i] - values[i - 1]) / max(soft, 1e-9), -1, 1)
        place[i] = x
    return width / 2 * np.tanh(2.2 * place) / np.tanh(2.2)


def elastic_joints(robot: Robot, campaign: Campaign) -> tuple[list[int], Array]:
    """Columns of the joints with an own spring, and how much the deflection of each varies, as shares."""
    columns = [k for k in range(robot.count) if joint_name(k) in robot.own]
    places = [robot.own[joint_name(k)] for k in columns]
    varies = np.array([np.std(campaign.nominal.torque[i]) * robot.springs[i].compliance for i in places]) + 1e-12
    return columns, varies / varies.sum()


def pick_elastic(rng: Rng, robot: Robot, campaign: Campaign, power: float) -> int:
    """A joint with an own spring, rather one whose deflection varies."""
    columns, share = elastic_joints(robot, campaign)
    share = share**power + 1e-9
    return int(rng.choice(columns, p=share / share.sum()))


def largest(torque: Array) -> float:
    """Largest torque of a campaign. [N m]"""
    return float(np.abs(torque).max()) + 1e-9


def level_axis(rng: Rng) -> Array:
    """A nearly horizontal axis. Shape (3,)."""
    angle = rng.uniform(0, 6.28)
    return np.array([np.cos(angle), np.sin(angle), 0.15 * rng.normal()])


def name_unknown(
    kind: str,
    note: str,
    apply: Apply,
    size: float,
    lowest: float | None = None,
    highest: float | None = None,
    params: Mapping[str, Any] | None = None,
    needs: tuple[str, ...] = (),
    joint: str | None = None,
) -> Cause:
    """A cause without a name in the format's list; its kind and note say what it is, its note the unit."""
    lowest = size * 0.03 if lowest is None else lowest
    highest = size * 12 if highest is None else highest
    return Cause(
        "unknown", joint, None, "see note", size, lowest, highest, apply, params or {}, kind, note, needs=needs
    )
