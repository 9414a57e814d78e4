"""Everyday errors: small ones everywhere, of which none is to be named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Apply, Key, follow_play
from benchmarks.outsider.robots import Robot, Spring, joint_name
from benchmarks.outsider.signatures import Signatures, axis_rows, grow_links, stack
from benchmarks.outsider.statics import BaseMotion, State, TipMotion, slide_by, solve_statics, turn_round
from benchmarks.outsider.turns import AXES, DEGREE, Array, Rng
from benchmarks.outsider.weighing import register, rms

# Share of each group in the level of everyday errors, size of its trial motion, largest factor on its sizes.
GROUPS: Mapping[str, tuple[float, float, float]] = {
    "geometry": (0.65, 0.3e-3, np.inf),
    "compliance": (0.35, 30e-3, 0.12),
    "off_axis": (0.2, 30e-3, 0.15),
    "gear": (0.25, 0.1e-3, np.inf),
    "hysteresis": (0.2, 0.1e-3, np.inf),
    "warm_up": (0.15, 3e-6, np.inf),
    "frames": (0.5, 0.2e-3, np.inf),
}


@dataclass(frozen=True)
class Everyday:
    """One small error: its standard deviation, its drawn size, and `columns`, the motion by one deviation (n, 6, m)."""

    group: str
    key: Key
    sd: float
    size: float
    apply: Apply
    params: Mapping[str, float] = field(default_factory=dict)
    columns: Array | None = None


def draw_everyday(rng: Rng, robot: Robot, campaign: Campaign, signatures: Signatures, level: float) -> list[Everyday]:
    """Draw everyday errors, each group scaled to its share of a level.

    Args:
        rng: Random numbers.
        robot: The robot.
        campaign: The given campaign.
        signatures: Its signatures.
        level: Motion that a share of 1 would make, registered where the campaign is. [m rms]
    """
    drafts = [*_joint_errors(rng, robot), *_gear_errors(rng, robot), _warm_up(rng, robot)]
    if not campaign.register:
        drafts += _frame_errors(rng, robot)
    scaled = []
    for group, (share, trial, largest) in GROUPS.items():
        members = [d for d in drafts if d.group == group]
        if not members:
            continue
        state = State(robot, campaign.q, campaign.wrench)
        for d in members:
            d.apply(state, campaign, trial * d.size)
        moved = solve_statics(state).position - campaign.position
        made = rms(register(moved, signatures.frames) if campaign.register else moved)
        factor = min(trial * level * share * rng.uniform(0.5, 1.3) / max(made, 1e-9), largest)
        for d in members:
            columns = _columns(d, robot, campaign, signatures)
            sd = d.sd * factor
            columns = None if columns is None else columns * sd
            scaled.append(replace(d, sd=float(sd), size=float(d.size * factor), columns=columns))
    return scaled


def _draw(rng: Rng, group: str, key: Key, sd: float, apply: Apply, **params: float) -> Everyday:
    return Everyday(group, key, sd, sd * rng.normal(), apply, params)


def _joint_errors(rng: Rng, robot: Robot) -> list[Everyday]:
    """Geometry, zero and compliance of every joint."""
    drafts, reach = [], robot.reach
    for k in range(robot.count):
        name = joint_name(k)
        for letter in "xyz" if k else "":
            shift, turn = _shift_origin(name, letter), _turn_origin(name, letter)
            drafts.append(_draw(rng, "geometry", ("link_geometry", name, "t" + letter), 1.0, shift))
            drafts.append(_draw(rng, "geometry", ("link_geometry", name, "r" + letter), 0.7 / reach, turn))
        sd = 0.6 if robot.prismatic[k] else 0.6 / reach
        drafts.append(_draw(rng, "geometry", ("joint_offset", name, None), sd, _offset(k)))
        if name in robot.own:
            i = robot.own[name]
            drafts.append(_draw(rng, "compliance", ("joint_stiffness", name, None), 1.0, _soften(i)))
            for letter in robot.across(k):
                sd = robot.springs[i].compliance
                key = ("link_compliance", name, "r" + letter)
                drafts.append(Everyday("off_axis", key, sd, sd * abs(rng.normal()), _bend(name, letter)))
    return drafts


def _shift_origin(name: str, letter: str) -> Apply:
    return lambda state, on, size: state.shift(name, size * AXES[letter])


def _turn_origin(name: str, letter: str) -> Apply:
    return lambda state, on, size: state.turn(name, size * AXES[letter])


def _offset(k: int) -> Apply:
    return lambda state, on, size: state.turn_joint(k, size)


def _soften(i: int) -> Apply:
    def apply(state: State, _: Campaign, size: float) -> None:
        state.springs[i] = replace(state.springs[i], compliance=state.springs[i].compliance * (1 + size))

    return apply


def _bend(name: str, letter: str) -> Apply:
    return lambda state, on, size: state.springs.append(Spring(name, "r" + letter, size))


def _gear_errors(rng: Rng, robot: Robot) -> list[Everyday]:
    """Gear waves and lost motion of three joints."""
    drafts = []
    for k in (int(k) for k in rng.choice(robot.turning, 3, replace=False)):
        rate, phase = float(rng.choice([1, 2, 13, 51, 77, 100])), rng.uniform(0, 6.3)
        key = ("transmission_error", joint_name(k), None)
        drafts.append(_draw(rng, "gear", key, 1.0, _wave(k, rate, phase), per_rev=rate, phase=phase))
        drafts.append(_draw(rng, "hysteresis", ("backlash", joint_name(k), None), 1.0, _play(k)))
    return drafts


def _wave(k: int, rate: float, phase: float) -> Apply:
    return lambda state, on, size: state.turn_joint(k, size * np.sin(rate * on.q[:, k] + phase))


def _play(k: int) -> Apply:
    return lambda state, on, size: state.turn_joint(k, follow_play(on.q[:, k], on.start[k], abs(size), DEGREE))


def _warm_up(rng: Rng, robot: Robot) -> Everyday:
    def apply(state: State, on: Campaign, size: float) -> None:
        for e in robot.elements[1:]:
            state.shift(e.name, (abs(size) * on.warmth)[:, None] * e.xyz)

    return _draw(rng, "warm_up", ("thermal_drift", None, None), 1.0, apply)


def _frame_errors(rng: Rng, robot: Robot) -> list[Everyday]:
    """Base and target, where they count as known."""
    shift, turn, target = rng.normal(size=3), 0.5 * rng.normal(size=3) / robot.reach, 0.5 * rng.normal(size=3)

    def move_base(state: State, _: Campaign, size: float) -> None:
        state.base.append(BaseMotion(size * turn, size * shift, np.zeros(3)))

    def move_target(state: State, _: Campaign, size: float) -> None:
        state.tip.append(TipMotion(size * target, np.zeros(3)))

    return [
        _draw(rng, "frames", ("base_frame", None, None), 1.0, move_base),
        _draw(rng, "frames", ("tool_frame", None, None), 1.0, move_target),
    ]


def _columns(error: Everyday, robot: Robot, campaign: Campaign, signatures: Signatures) -> Array | None:
    """Motion by a unit of an everyday error, all its phases or directions. Shape (n, 6, m); None if it makes none."""
    effect, joint, _ = error.key
    if effect == "transmission_error":
        k = robot.element[str(joint)].column
        angle, moves = error.params["per_rev"] * campaign.q[:, k], campaign.jacobian[k]
        return stack([moves * np.sin(angle)[:, None], moves * np.cos(angle)[:, None]]) / np.sqrt(2)
    if effect == "thermal_drift":
        return (grow_links(robot, campaign) * campaign.warmth[:, None])[:, :, None]
    if effect == "base_frame":
        axes = [axis_rows(i, campaign.rows) for i in range(3)]
        turns = [0.5 / robot.reach * turn_round(a, campaign.position) for a in axes]
        return stack([slide_by(a) for a in axes] + turns)
    variants = signatures.variants.get(error.key)
    if not variants:
        return None
    return 0.5 * variants[0][:, :, :3] if effect == "tool_frame" else variants[0][:, :, :1]
