"""Causes without a name in the format's list: base, floor, rail and hall."""

from __future__ import annotations

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, level_axis, name_unknown
from benchmarks.outsider.robots import Robot
from benchmarks.outsider.statics import BaseMotion, State
from benchmarks.outsider.turns import AXES, Rng

NOWHERE = np.zeros(3)


def mount_creep(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The base plate creeps with the logarithm of time."""
    axis, tau = level_axis(rng), rng.uniform(60, 600)

    def apply(state: State, on: Campaign, size: float) -> None:
        leaning = 1 + 0.4 * np.sin(on.q[:, robot.column_1] + axis[1])
        by = size * np.log1p(on.later(4000) / tau) * leaning
        state.base.append(BaseMotion(by[:, None] * axis, NOWHERE, np.array([0.2, 0, 0])))

    note = "the plate of the base creeps with the logarithm of the time, more when the arm hangs over the loose side"
    return name_unknown("mount_creep", note + " (rad per e-fold)", apply, 2e-4, params={"tau_s": tau})


def tripod_drift(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The instrument's stand warps with the air conditioning."""
    slow, fast, phases = rng.uniform(900, 2400), rng.uniform(300, 700), rng.uniform(0, 6.3, 3)
    axis = level_axis(rng) + 0.7 * AXES["z"]

    def apply(state: State, on: Campaign, size: float) -> None:
        wave = np.sin(6.283 * on.time / slow + phases[0]) + 0.4 * np.sin(6.283 * on.time / fast + phases[1])
        state.base.append(BaseMotion((size * wave)[:, None] * axis, NOWHERE, on.tracker))

    note = "the tracker's tripod warps to and fro with the air conditioning (rad)"
    return name_unknown("tripod_drift", note, apply, 1.2e-4, 1e-5, 3.5e-4, {"period_s": [slow, fast]})


def floor_bending(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The floor yields to one side beyond a moment."""
    normal = level_axis(rng)
    normal[2] = 0
    moment = campaign.base_moment @ normal
    limit, scale = np.quantile(moment, rng.uniform(0.45, 0.7)), np.ptp(moment) + 1e-9
    axis = normal + 0.2 * rng.normal(size=3)
    edge = np.array([0.25 * robot.reach * normal[1], -0.25 * robot.reach * normal[0], 0])

    def apply(state: State, on: Campaign, size: float) -> None:
        by = (size * np.maximum(0, (on.base_moment @ normal - limit) / scale) ** 1.3)[:, None]
        state.base.append(BaseMotion(by * axis, -by * AXES["z"] * 0.15, edge))

    note = "the floor gives way on one side only, once the arm's moment passes what the slab carries (rad)"
    return name_unknown("floor_bending", note, apply, 8e-4)


def rail_waves(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The carriage of the rail rolls, yaws and wanders aside."""
    phases, length = rng.uniform(0, 6.3, 4), rng.uniform(0.7, 1.6)

    def apply(state: State, on: Campaign, size: float) -> None:
        x = on.q[:, 0]
        angle = 6.28 * x / length
        roll, yaw = 0.5 * np.sin(angle + phases[0]), 0.35 * np.sin(angle * 0.8 + phases[2])
        turn = np.stack([roll, 0.15 * np.sin(angle * 0.6 + phases[1]), yaw], 1)
        aside = np.stack([0 * x, np.sin(angle + phases[3]), 0.4 * np.cos(angle)], 1)
        state.base.append(BaseMotion(size * turn, size * 0.5 * aside, np.outer(x, AXES["x"])))

    note = "the rail is not straight: the carriage rolls, yaws and wanders aside along it (rad)"
    return name_unknown("rail_waves", note, apply, 5e-4, needs=("rail",))


def gantry_heat(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The beam that carries the robot bows with the hall's temperature."""
    phase = rng.uniform(0, 6.3)

    def apply(state: State, on: Campaign, size: float) -> None:
        x = on.q[:, 0] if robot.rail else on.position[:, 0]
        by, along = size * np.sin(6.283 * on.later(5000) / 7000.0 + phase), x - np.mean(x)
        turn, lift = (by * along)[:, None] * np.array([0, 1.0, 0.2]), (-0.5 * by * along**2)[:, None] * AXES["z"]
        state.base.append(BaseMotion(turn, lift, np.outer(x, AXES["x"])))

    note = "the beam that carries the robot bows as the hall warms and cools (rad per m at the hottest)"
    return name_unknown("gantry_heat", note, apply, 3e-4, needs=("rail",))


def mobile_base(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The truck under the robot tilts, with springs that stick."""
    scale, stick = np.std(campaign.base_moment[:, :2]) + 1e-9, rng.uniform(0.6, 1.2)

    def apply(state: State, on: Campaign, size: float) -> None:
        moment = on.base_moment[:, :2] / scale
        at, tilt = moment[0].copy(), np.zeros_like(moment)
        for i in range(len(moment)):
            pull = moment[i] - at
            length = np.linalg.norm(pull)
            if length > stick:
                at = at + pull * (1 - stick / length)
            tilt[i] = at
        turn = np.c_[np.tanh(tilt[:, 0]), np.tanh(0.6 * tilt[:, 1]), 0 * tilt[:, 0]]
        state.base.append(BaseMotion(size * turn, NOWHERE, NOWHERE))

    note = "the robot stands on a truck whose springs stick: the base tilts with the arm's moment, late and until the"
    return name_unknown("mobile_base", note + " stops (rad)", apply, 5e-4)
