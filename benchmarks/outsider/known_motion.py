"""Effects of the format's list in geometry, gears, frames and time, shaped physically."""

from __future__ import annotations

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, draw_sign, follow_play
from benchmarks.outsider.robots import Robot, joint_name
from benchmarks.outsider.statics import BaseMotion, State, TipMotion
from benchmarks.outsider.turns import AXES, DEGREE, Rng, unit

PER_TURN = (1, 1, 2, 2, 3, 4, 6, 8, 11, 17, 29, 40, 57.3, 81, 101)
LIGHT = ("cobot", "small", "scara")


def joint_offset(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint's zero is off."""
    k = int(rng.integers(1 if campaign.register else 0, robot.count))
    sign = draw_sign(rng)

    def apply(state: State, _: Campaign, size: float) -> None:
        state.turn_joint(k, size * sign)

    return Cause("joint_offset", joint_name(k), None, "rad or m", 1e-3, 8e-5, 8e-3, apply, {"sign": sign})


def link_geometry(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A link's origin is shifted or turned, nearly along one axis."""
    name = joint_name(int(rng.integers(1, robot.count)))
    axis = str(rng.choice(["tx", "ty", "tz", "rx", "ry", "rz"]))
    direction = AXES[axis[1]] * draw_sign(rng) + 0.06 * rng.normal(size=3)

    def apply(state: State, _: Campaign, size: float) -> None:
        (state.shift if axis[0] == "t" else state.turn)(name, size * direction)

    in_unit = "m" if axis[0] == "t" else "rad"
    return Cause(
        "link_geometry", name, axis, in_unit, 1e-3, 1e-4, 5e-3, apply, params={"direction": direction.tolist()}
    )


def tool_frame(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The measured point of the tool is elsewhere."""
    direction, turn = unit(rng), 0.3 * rng.normal(size=3)

    def apply(state: State, _: Campaign, size: float) -> None:
        state.tip.append(TipMotion(size * direction, size * turn))

    params = {"direction": direction.tolist(), "turn_rad_per_m": turn.tolist()}
    return Cause("tool_frame", None, None, "m along params.direction", 1e-3, 1e-4, 5e-3, apply, params)


def base_frame(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The robot's base is elsewhere in the measurement frame."""
    direction, turn = unit(rng), rng.normal(size=3) * 0.6 / robot.reach

    def apply(state: State, _: Campaign, size: float) -> None:
        state.base.append(BaseMotion(size * turn, size * direction, np.zeros(3)))

    params = {"translation": direction.tolist(), "rotation_rad_per_m": turn.tolist()}
    return Cause("base_frame", None, None, "m along params.translation", 1e-3, 1e-4, 6e-3, apply, params)


def backlash(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint's link lags its motor by a lost motion that is uneven over the turn and turns over softly."""
    k = int(rng.choice(robot.turning)) if rng.random() < 0.93 else int(rng.integers(robot.count))
    soft = rng.uniform(0.3, 1.5) * DEGREE * (0.3 if robot.prismatic[k] else 1)
    uneven, phase = rng.uniform(0, 0.35), rng.uniform(0, 6.3)

    def apply(state: State, on: Campaign, size: float) -> None:
        play = follow_play(on.q[:, k], on.start[k], size, soft)
        state.turn_joint(k, play * (1 + uneven * np.sin(2 * on.q[:, k] + phase)))

    highest, params = 2.5e-3 if robot.size in LIGHT else 1.5e-3, {"uneven": float(uneven), "soft": float(soft)}
    return Cause("backlash", joint_name(k), None, "rad or m, full width", 5e-4, 6e-5, highest, apply, params)


def transmission_error(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A gear runs ahead and behind, with three harmonics and an amplitude that varies over the turn."""
    k = int(rng.choice(robot.turning))
    rate, phases = float(rng.choice(PER_TURN)), rng.uniform(0, 6.3, 4)
    second, third, varies = rng.uniform(0.15, 0.5), rng.uniform(0.05, 0.25), rng.uniform(-0.15, 0.15)

    def apply(state: State, on: Campaign, size: float) -> None:
        q = on.q[:, k]
        wave = np.sin(rate * q + phases[0]) + second * np.sin(2 * rate * q + phases[1])
        wave += third * np.sin(3 * rate * q + phases[2])
        state.turn_joint(k, size * (1 + varies * np.sin(q + phases[3])) * wave)

    highest = 2.5e-3 if robot.size in LIGHT else 1.2e-3
    params = {"per_rev": rate, "phase": float(phases[0]), "second": float(second), "third": float(third)}
    return Cause("transmission_error", joint_name(k), None, "rad, amplitude", 4e-4, 5e-5, highest, apply, params)


def thermal_drift(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The links grow as the arm warms up, some more than others."""
    weights = rng.uniform(0.6, 1.4, len(robot.elements))
    weights[1] *= 1.3

    def apply(state: State, on: Campaign, size: float) -> None:
        for weight, e in zip(weights, robot.elements[1:], strict=False):
            state.shift(e.name, (size * weight * on.warmth)[:, None] * e.xyz)

    return Cause("thermal_drift", None, None, "1/K", 1.4e-5, 4e-6, 3e-5, apply, {"weights": weights.tolist()})


def tracking_lag(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """One joint, or all of them, follow their commands late on paths."""
    k = None if rng.random() < 0.4 else int(rng.choice(robot.turning[:4]))

    def apply(state: State, on: Campaign, size: float) -> None:
        for j in range(robot.count) if k is None else [k]:
            state.turn_joint(j, -size * on.speed[:, j] * (1 + 0.1 * np.sin(j) if k is None else 1))

    return Cause("tracking_lag", None if k is None else joint_name(k), None, "s", 0.01, 0.001, 0.08, apply)


def time_skew(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The clocks of controller and instrument differ."""
    sign = draw_sign(rng)

    def apply(state: State, on: Campaign, size: float) -> None:
        state.q += sign * size * on.speed + 0.5 * size * size * on.acceleration

    return Cause("time_skew", None, None, "s", 0.01, 0.001, 0.08, apply, {"sign": sign})


def frame_shift(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The base or the instrument is knocked during the campaign."""
    direction, turn = unit(rng), rng.normal(size=3) * 0.4 / robot.reach
    row = int(campaign.rows * rng.uniform(0.25, 0.75))

    def apply(state: State, on: Campaign, size: float) -> None:
        since = size * on.since(row)[:, None]
        state.base.append(BaseMotion(since * turn, since * direction, np.zeros(3)))

    params = {"row": row, "translation": direction.tolist(), "rotation_rad_per_m": turn.tolist()}
    return Cause("frame_shift", None, None, "m along params.translation", 1e-3, 1e-4, 8e-3, apply, params)


def tool_shift(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The tool or the target is knocked during the campaign."""
    direction = unit(rng)
    row = int(campaign.rows * rng.uniform(0.25, 0.75))
    turn = 0.5 * rng.normal(size=3)

    def apply(state: State, on: Campaign, size: float) -> None:
        since = size * on.since(row)[:, None]
        state.tip.append(TipMotion(since * direction, since * turn))

    params = {"row": row, "direction": direction.tolist()}
    return Cause("tool_shift", None, None, "m along params.direction", 8e-4, 1e-4, 5e-3, apply, params)


def joint_coupling(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint turns with another one, a little or one to one."""
    i = int(rng.integers(1, len(robot.turning)))
    k, other = robot.turning[i], robot.turning[i - 1]
    if rng.random() < 0.5 and i >= 2:
        other = robot.turning[i - 2]
    rate = float(draw_sign(rng) * (1.0 if rng.random() < 0.15 else rng.uniform(0.006, 0.05)))

    def apply(state: State, on: Campaign, size: float) -> None:
        state.turn_joint(k, size * on.q[:, other])

    sizes, params = (rate, abs(rate), abs(rate)), {"of": joint_name(other)}
    return Cause("joint_coupling", joint_name(k), None, "rad/rad", *sizes, apply, params, fixed=True)
