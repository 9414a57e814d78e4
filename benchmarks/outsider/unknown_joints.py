"""Causes without a name in the format's list: controller, gears, brakes and zeros."""

from __future__ import annotations

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, elastic_joints, largest, name_unknown
from benchmarks.outsider.robots import Robot, joint_name
from benchmarks.outsider.statics import State
from benchmarks.outsider.turns import Rng


def controller_rounding(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Joint targets are rounded to a coarse grid."""
    coarse = rng.uniform(0.4, 1.0, robot.count)
    coarse[robot.prismatic] *= 0.3
    phase = rng.uniform(0, 1, robot.count)

    def apply(state: State, on: Campaign, size: float) -> None:
        grid = size * coarse
        state.q += grid * (np.round(on.q / grid + phase) - phase) - on.q

    note = "the controller rounds the target of every joint to a coarse grid (rad, largest step)"
    return name_unknown("controller_rounding", note, apply, 8e-4, 1e-4, 2.5e-3)


def belt_tooth_load(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Belt teeth climb in their grooves with the torque."""
    columns, share = elastic_joints(robot, campaign)
    k = int(columns[int(np.argmax(share))]) if rng.random() < 0.6 else int(rng.choice(columns))
    rate, phase = rng.uniform(9, 40), rng.uniform(0, 6.3)
    name = joint_name(k)
    top = largest(campaign.torque(name))

    def apply(state: State, on: Campaign, size: float) -> None:
        q = on.q[:, k]
        state.turn_joint(k, size * on.torque(name) / top * (np.sin(rate * q + phase) + 0.5 * np.sin(2.5 * rate * q)))

    note = "belt teeth climb in their grooves: a tooth error that grows with the torque and turns with its sign (rad)"
    return name_unknown("belt_tooth_load", note, apply, 8e-4, params={"per_rev": rate}, joint=name)


def stale_labels(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Some poses were touched up and the log carries the joint values of before."""
    share, spread = rng.uniform(0.15, 0.3), rng.uniform(0.5, 1, robot.count) * np.where(robot.prismatic, 0.3, 1)

    def apply(state: State, on: Campaign, size: float) -> None:
        hand, stays = np.random.default_rng(on.seed + 5), on.visit[-1] + 1
        touched = hand.random(stays) < share
        moves = size * spread * touched[:, None] * hand.normal(size=(stays, robot.count))
        state.q += moves[on.visit]

    note = "some poses were touched up by hand and the log still carries the labels (joint values) of the old programme"
    return name_unknown("stale_labels", note + " (rad)", apply, 1e-3, needs=("static",))


def brake_drop(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """After a longer wait the brakes fall in and every joint drops."""
    columns, _ = elastic_joints(robot, campaign)
    limit = np.quantile(np.diff(campaign.time), rng.uniform(0.45, 0.65))
    drops = {k: rng.uniform(0.5, 1) for k in columns}

    def apply(state: State, on: Campaign, size: float) -> None:
        braked = np.r_[False, np.diff(on.time) > limit]
        for k, drop in drops.items():
            name = joint_name(k)
            state.turn_joint(k, size * drop * braked * np.tanh(3 * on.torque(name) / largest(campaign.torque(name))))

    note = "after a longer wait the brakes fall in and every joint drops a little the way its torque pulls (rad)"
    return name_unknown("brake_drop", note, apply, 4e-4, needs=("static",))


def geartrain_crosstalk(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The torque of one joint twists another through the common gear train."""
    columns, share = elastic_joints(robot, campaign)
    k = columns[-1] if rng.random() < 0.5 else columns[-2]
    source = joint_name(columns[int(np.argmax(np.where(np.array(columns) == k, 0, share)))])
    name, nominal = joint_name(k), robot.springs[robot.own[source]].compliance

    def apply(state: State, _: Campaign, size: float) -> None:
        state.crosstalk.append((name, source, size))

    note = f"the torque of {source} twists {name} through the common gear train (rad/(N m))"
    return name_unknown("geartrain_crosstalk", note, apply, 4 * nominal, 0.2 * nominal, 60 * nominal, joint=name)


def region_compensation(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The controller takes sag away in one work zone only."""
    first, columns = robot.column_1, elastic_joints(robot, campaign)[0]
    edge = np.quantile(campaign.q[:, first], rng.uniform(0.35, 0.65))

    def apply(state: State, on: Campaign, size: float) -> None:
        q = on.q[:, first]
        inside = (q > edge) * (1.0 + 0.2 * np.sin(3 * q))
        for k in columns:
            state.turn_joint(k, -size * inside * on.nominal.deflection[robot.own[joint_name(k)]])

    note = "the controller's own sag compensation is switched on in one work zone only (part of the sag taken away)"
    return name_unknown("region_compensation", note, apply, 0.5, 0.03, 1.5)


def cardan_wrist(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Universal joints in the wrist's shafts run unevenly."""
    turning = robot.turning
    last = turning[-1]
    before = turning[-2] if len(turning) > 3 else turning[0]
    third = turning[-3] if len(turning) > 4 else turning[1]
    phases = rng.uniform(0, 6.3, 2)

    def apply(state: State, on: Campaign, size: float) -> None:
        angle = 2 * on.q[:, third]
        state.turn_joint(last, size * np.sin(angle + phases[0]))
        state.turn_joint(before, size * 0.8 * np.sin(angle + phases[1]) * np.cos(on.q[:, last]))

    pair = f"{joint_name(last)} and {joint_name(before)}"
    note = f"universal joints in the wrist's shafts: {pair} run ahead and behind with twice the angle of "
    return name_unknown("cardan_wrist", note + f"{joint_name(third)} (rad)", apply, 1.5e-3, 1e-4, 8e-3)


def zero_jump(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A power cut leaves two joints with another zero."""
    turning = robot.turning
    k = turning[int(rng.integers(1, len(turning)))]
    row = int(campaign.rows * rng.uniform(0.3, 0.7))
    other = turning[int(rng.integers(0, len(turning)))]

    def apply(state: State, on: Campaign, size: float) -> None:
        state.turn_joint(k, size * on.since(row))
        state.turn_joint(other, -0.6 * size * on.since(row))

    pair = f"{joint_name(k)} and {joint_name(other)}"
    note = f"a power cut in the middle of the run: {pair} come back with another zero (rad)"
    return name_unknown("zero_jump", note, apply, 1e-3, params={"row": row})
