"""Effects of the format's list in springs, weights and loads, shaped physically rather than by the plain formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, draw_sign, largest, leave_alone, pick_elastic
from benchmarks.outsider.robots import BASE, MOUNT, SCALE, Robot, Spring, joint_name
from benchmarks.outsider.statics import State
from benchmarks.outsider.turns import AXES, Array, Rng, repeat, rotate, unit

ADDED_MASS_KG = {"cobot": 8, "small": 6, "mid": 25, "heavy": 220, "scara": 4}
SENSOR_BIAS_N = {"cobot": 20.0, "small": 25, "mid": 80, "heavy": 400, "scara": 15}


def _tilt(rng: Rng, axis: Array, by: float) -> Array:
    """An axis a little off."""
    v = axis + by * rng.normal(size=3)
    return v / np.linalg.norm(v)


def _rounded(v: Array) -> list[float]:
    return [round(float(x), 4) for x in v]


def joint_stiffness(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint is softer or stiffer than the folder says."""
    k = pick_elastic(rng, robot, campaign, 0.5)
    i = robot.own[joint_name(k)]
    nominal = robot.springs[i].compliance

    def apply(state: State, _: Campaign, size: float) -> None:
        state.springs[i] = replace(state.springs[i], compliance=nominal * (1 + size))

    size = rng.choice([1, 1, 1, -0.5]) * 0.4
    return Cause(
        "joint_stiffness", joint_name(k), None, "relative change of the compliance", float(size), 0.04, 1.6, apply
    )


def link_compliance(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A link bends about an axis near one across its joint, at the joint or beside it."""
    k = int(rng.choice(robot.turning[: max(3, robot.count - 2)]))
    name = joint_name(k)
    axis = str(rng.choice(robot.across(k)))
    tilted = _tilt(rng, AXES[axis], 0.08)
    nominal = robot.springs[robot.own[name]].compliance if name in robot.own else robot.first_compliance
    offset = None if rng.random() < 0.5 else [float(x) for x in 0.1 * SCALE[robot.size] * rng.normal(size=3)]

    def apply(state: State, _: Campaign, size: float) -> None:
        state.springs.append(Spring(name, tilted, size, offset))

    params = {"tilted_axis": _rounded(tilted), "offset_m": offset}
    sizes = 0.5 * nominal, 0.05 * nominal, 2.5 * nominal
    return Cause("link_compliance", name, "r" + axis, "rad/(N m)", *sizes, apply, params)


def base_compliance(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The base plate gives way about an axis near x, y or z."""
    axis = str(rng.choice(["x", "y", "y", "z"] if campaign.design == "sensor" else ["x", "y"]))
    tilted, nominal = _tilt(rng, AXES[axis], 0.07), robot.first_compliance

    def apply(state: State, _: Campaign, size: float) -> None:
        state.springs.append(Spring(BASE, tilted, size))

    sizes = 0.3 * nominal, 0.03 * nominal, 3 * nominal
    params = {"tilted_axis": _rounded(tilted)}
    return Cause("base_compliance", None, "r" + axis, "rad/(N m)", *sizes, apply, params)


def stiffness_nonlinearity(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A joint hardens, softens, or is soft about zero torque."""
    k = pick_elastic(rng, robot, campaign, 0.8)
    i, top = robot.own[joint_name(k)], largest(campaign.torque(joint_name(k)))
    form = str(rng.choice(["hardening", "softening", "soft zone"]))
    zone, power = float(rng.uniform(0.08, 0.25)), float(rng.uniform(1.7, 3))

    def bend(x: Array) -> Array:
        if form == "soft zone":
            return 0.5 * np.tanh(x / zone)
        return np.sign(x) * np.abs(x) ** power / (1 + 0.15 * np.abs(x)) * (-1 if form == "hardening" else 1)

    def apply(state: State, _: Campaign, size: float) -> None:
        def law(torque: Array, compliance: float) -> Array:
            return compliance * (torque + size * top * bend(torque / top))

        state.springs[i] = replace(state.springs[i], law=law)

    told_in = "deflection beside the linear one, in parts of the deflection at the campaign's largest torque"
    highest = 0.9 if form == "hardening" else 2.0
    params = {"form": form, "x0": zone, "power": power}
    return Cause("stiffness_nonlinearity", joint_name(k), None, told_in, 0.5, 0.15, highest, apply, params)


def gravity_sag(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """Link weights load the springs and the folder leaves gravity out; the masses are somewhat off."""
    factors = [float(x) for x in np.round(rng.normal(1, 0.08, robot.count), 4)]

    def apply(state: State, _: Campaign, size: float) -> None:
        for k, factor in enumerate(factors):
            mass, com = state.masses[joint_name(k)]
            state.masses[joint_name(k)] = (mass * factor, com)

    return Cause("gravity_sag", None, None, "1", 1.0, 1.0, 1.0, apply, {"mass_factor": factors}, fixed=True)


def payload(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The tool carries a mass that the folder does not know."""
    com = robot.tool.com + 0.08 * SCALE[robot.size] * rng.normal(size=3)
    capacity = ADDED_MASS_KG[robot.size]

    def apply(state: State, _: Campaign, size: float) -> None:
        mass, centre = state.masses[MOUNT]
        state.masses[MOUNT] = (mass + size, (mass * centre + size * com) / (mass + size))

    sizes = 0.3 * capacity, 0.03 * capacity, 0.6 * capacity
    return Cause("payload", None, None, "kg", *sizes, apply, {"com_m": [float(x) for x in com]})


def gravity_compensator(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """A spring between column and arm pulls back to upright, with friction by the direction of the last move."""
    k = robot.leaning()[0]
    name, scale = joint_name(k), SCALE[robot.size]
    top = float(np.abs(campaign.torque(name)).max()) + 1.0
    a, b, phase = 0.2 * scale, 0.12 * scale, rng.normal(0, 0.15)
    friction, rate = rng.uniform(0.02, 0.07), rng.uniform(0.3, 1.5)

    def apply(state: State, on: Campaign, size: float) -> None:
        angle = on.q[:, k] + phase
        length = np.sqrt(a * a + b * b + 2 * a * b * np.cos(angle))
        lever = a * b * np.sin(angle) / length
        force = 1 + rate * (a + b - length) / b + friction * np.tanh(on.direction[:, k] * np.sign(lever))
        state.load_joint(name, -size * force * lever / b)

    params = {"lever_m": [a, b], "phase": phase, "rate": rate, "friction": friction}
    sizes = 0.6 * top, 0.1 * top, 1.5 * top
    return Cause("gravity_compensator", name, None, "N m (at a quarter turn, about)", *sizes, apply, params)


def wrench_bias(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The force sensor reads a constant too much, in its own axes or in those of the base."""
    frame, force = str(rng.choice(["sensor", "base"])), SENSOR_BIAS_N[robot.size]
    direction, moment = unit(rng), 0.05 * rng.normal(size=3)

    def mislog(on: Campaign, wrench: Array, size: float) -> Array:
        bias, turning = repeat(size * direction, len(wrench)), repeat(size * moment, len(wrench))
        if frame == "sensor":
            bias, turning = rotate(on.rotation, bias), rotate(on.rotation, turning)
        return wrench + np.hstack([bias, turning])

    params = {"frame": frame, "direction": direction.tolist(), "moment_m": moment.tolist()}
    sizes = force, 0.1 * force, 2 * force
    return Cause(
        "wrench_bias", None, None, "N along params.direction", *sizes, leave_alone, params=params, mislog=mislog
    )


def wrench_scale(rng: Rng, robot: Robot, campaign: Campaign) -> Cause:
    """The force sensor reads too much or too little, its six channels a little differently."""
    sign, uneven = draw_sign(rng), 0.03 * rng.normal(size=6)

    def mislog(_: Campaign, wrench: Array, size: float) -> Array:
        return wrench * (1 + sign * size + size * uneven)

    name = "relative gain error of the reading"
    return Cause("wrench_scale", None, None, name, 0.15, 0.03, 0.5, leave_alone, {"sign": sign}, mislog=mislog)
