"""Every effect, said twice: as MuJoCo's robot has it, and as the product's folder states it, by the contracts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain, cycle

import numpy as np
from drawn_campaigns import REFERENCE_C, lay_out_rows, rail_arm, turned_arm

from benchmarks.campaigns.description import Array, RobotDescription, Spring, rotation_from_rpy
from benchmarks.campaigns.effects import Effect as Cause
from benchmarks.campaigns.effects import apply_effect
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario
from compplan.effects import EFFECTS, Effect

#: Agreement with MuJoCo where nothing is rounded or linear. [m, rad]
SAME = 1e-8
STEP = np.array([0.7, -0.4, 0.5, 0.3, 0.45, -0.25])
AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
KEYS = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")
WRENCH_KEYS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
BIAS = np.array([60.0, -40.0, 75.0, 12.0, -9.0, 7.0])
#: A row in the midst of a stay; a row at which the arm has moved.
MID_STAY, NEXT_STAY = 29, 30
Change = Callable[[Scenario], Scenario]
#: Robot, effect, what is told apart.
Place = tuple[str, str, str]


@dataclass(frozen=True, eq=False)
class Case:
    """One effect, said twice."""

    label: str  #: What is told apart.
    real: Change  #: Puts it into MuJoCo's robot.
    effect: Effect  #: The same for the product.
    fit: bool = False  #: Whether the product has to find it in its log.
    base: RobotDescription | None = None  #: The nominal robot, where it is not one of `ROBOTS`.
    same: float = SAME  #: How closely both have to agree. [m, rad]


def caused(name: str, joint: str | None = None, axis: str | None = None, size: float = 1.0, **shape: object) -> Change:
    """Return what puts an effect of the independent vocabulary into a scenario."""
    return lambda scenario: apply_effect(Cause(name, joint, axis, size, params=shape), scenario)


def named(keys: tuple[str, ...], values: Array) -> dict[str, float]:
    return {key: float(value) for key, value in zip(keys, values, strict=True)}


# --- springs and loads -------------------------------------------------------------------------------------------


def spring_cases(robot: RobotDescription) -> list[Case]:
    own, soft = nominal_scenario(robot), "compliance_change_rad_per_Nm"
    cases = []
    for joint, share in (("joint_2", 0.4), ("joint_3", -0.3), ("joint_5", 0.5)):
        change = share * own.compliance[own.own_springs(joint)[0]]
        effect = Effect("joint_stiffness", joint, None, {soft: float(change)})
        cases.append(Case(joint, caused("joint_stiffness", joint, size=share), effect, joint == "joint_3"))
    if robot.joint_names[0] == "rail":
        effect = Effect("joint_stiffness", "rail", None, {"compliance_change_m_per_N": 6e-8})
        cases.append(Case("rail", caused("joint_stiffness", "rail", size=3.0), effect))
    else:
        stiff = robot_without_spring(robot, "joint_4")
        real = add_spring(Spring("joint_4", "own", 3e-6, actuator=True))
        cases.append(Case("rigid joint", real, Effect("joint_stiffness", "joint_4", None, {soft: 3e-6}), base=stiff))
    for joint, axis in (("joint_1", "rx"), ("joint_2", "tz"), ("joint_3", "rx"), ("joint_5", "rz"), ("joint_4", "ty")):
        size = 2e-7 if axis[0] == "t" else 8e-7
        key = "compliance_m_per_N" if axis[0] == "t" else "compliance_rad_per_Nm"
        effect = Effect("link_compliance", joint, axis, {key: size})
        cases.append(Case(joint + axis, caused("link_compliance", joint, axis, size), effect, joint == "joint_3"))
    for axis in ("rx", "ry", "rz"):
        effect = Effect("base_compliance", None, axis, {"compliance_rad_per_Nm": 2e-7})
        cases.append(Case(axis, caused("base_compliance", None, axis, 2e-7), effect, axis == "ry"))
    return cases


def robot_without_spring(robot: RobotDescription, joint: str) -> RobotDescription:
    return replace(robot, springs=tuple(s for s in robot.springs if s.joint != joint))


def add_spring(spring: Spring) -> Change:
    return lambda scenario: scenario.add_spring(spring)


def law_cases(robot: RobotDescription) -> list[Case]:
    """Deflections beyond c tau, as functions of the torque tau about the joint's axis."""
    joint, own = "joint_3", nominal_scenario(robot)
    k = own.own_springs(joint)[0]
    c, edge, reference = float(own.compliance[k]), 400.0, 2000.0
    shapes = {
        "linear_ratio": lambda tau: tau,
        "quadratic_ratio": lambda tau: tau * np.abs(tau) / reference,
        "cubic_ratio": lambda tau: tau**3 / reference**2,
    }
    cases = []
    for number, (key, shape) in enumerate(shapes.items()):
        law = (k, lambda tau, shape=shape: 0.3 * c * shape(tau))
        values = {"compliance": c, "reference_load": reference, "zone_load": edge, key: 0.3}
        real = lambda scenario, law=law: replace(scenario, laws=(*scenario.laws, law))  # noqa: E731
        effect = Effect("stiffness_nonlinearity", joint, None, values)
        cases.append(Case(key, real, effect, number == 1, same=1e-7))
    soft = {"compliance": c, "reference_load": reference, "zone_load": edge}
    for shape, key, size in (("zone", "soft_zone_ratio", 0.6), ("softening", "saturating_ratio", 0.5)):
        real = caused("stiffness_nonlinearity", joint, size=size, shape=shape, reference_Nm=edge, zone_Nm=edge)
        cases.append(Case(shape, real, Effect("stiffness_nonlinearity", joint, None, {**soft, key: size})))
    # a joint that hardens, theta (1 + s (theta / c t)^2) = c tau, yields less than c tau by c s tau^3 / t^2, to first
    # order in s
    real = caused("stiffness_nonlinearity", joint, size=0.005, shape="hardening", reference_Nm=reference)
    hard = {"compliance": c, "reference_load": reference, "zone_load": edge, "cubic_ratio": -0.005}
    cases.append(Case("hardening", real, Effect("stiffness_nonlinearity", joint, None, hard), same=5e-6))
    return cases


def weight_cases(robot: RobotDescription) -> list[Case]:
    weightless = replace(robot, gravity=None)
    sag = Effect("gravity_sag", None, None, {"gravity_m_s2": 9.81})
    soft = {"joint_2": 4e-7, "joint_3": 6e-7}
    bending = [{"joint": joint, "compliance": size} for joint, size in soft.items()]
    values = {"joints": list(soft), "compliance_rad_per_Nm": list(soft.values())}
    bent = Effect("gravity_sag", None, None, values)
    flange = robot.segments[-2]
    mass, com = 14.0, np.array([0.05, 0.08, -0.06])
    moment = (flange.mass + mass) * (np.array(flange.com) + com) - flange.mass * np.array(flange.com)
    heavier = Effect("payload", None, None, {"mass_kg": mass, "first_moment_kg_m": moment.tolist()})
    real = caused("payload", mass_kg=mass, centre_shift_m=com.tolist())
    hanging = Effect("payload", None, None, {"mass_kg": 12.0, "first_moment_kg_m": [1.2, -0.9, 1.5]})
    cases = [
        Case("weights", caused("gravity_sag"), sag, True, weightless),
        Case("rigid", caused("gravity_sag", springs=bending), bent, base=replace(weightless, springs=())),
        Case("in the folder", real, heavier, True),
        Case("no gravity", hang(robot, 12.0, np.array([0.1, -0.075, 0.125])), hanging, base=weightless),
    ]
    # a gas spring of force F at distances a << b pulls with -F a b sin(x) / l, l^2 = a^2 + b^2 - 2 a b cos x, that is
    # -F a (sin x + a/(2b) sin 2x) about the spring's axis, x = q + x0, but for terms of (a/b)^2
    force, a, b, zero = 1e6, 2e-3, 1.0, 0.6
    about = own_sense(robot, "joint_2")
    waves = (
        -about * force * a * np.r_[np.cos(zero), np.sin(zero), 0.5 * a / b * np.r_[np.cos(2 * zero), np.sin(2 * zero)]]
    )
    real = caused("gravity_compensator", "joint_2", size=force, a_m=a, b_m=b, angle_at_zero_rad=zero, rate_per_m=0.0)
    values = named(("sine_Nm", "cosine_Nm", "sine_2_Nm", "cosine_2_Nm"), waves)
    cases.append(Case("gas spring", real, Effect("gravity_compensator", "joint_2", None, values), True))
    return cases


def own_sense(robot: RobotDescription, joint: str) -> float:
    """Return 1 where the joint's own spring is written about the joint's axis, -1 where about the opposite one."""
    spring = robot.springs[nominal_scenario(robot).own_springs(joint)[0]]
    axis = robot.segments[robot.index_of(joint)].axis
    return 1.0 if spring.axis == "own" else float(axis["xyz".index(spring.axis[1])])


def hang(robot: RobotDescription, mass: float, centre: Array) -> Change:
    """Hang a mass on the flange, centre in flange axes; the robot's other weights were there from the beginning."""
    tip = robot.segments[-1]
    R_flange_tcp, p_flange_tcp = rotation_from_rpy(tip.rpy), np.array(tip.xyz)

    def weight(rows: Rows, position: Array, rotation: Array) -> Array:
        arm = rotation @ R_flange_tcp.T @ (centre - p_flange_tcp)
        force = np.tile([0.0, 0.0, -9.81 * mass], (len(position), 1))
        return np.hstack([force, np.cross(arm, force)])

    return lambda scenario: replace(scenario, loads=(*scenario.loads, weight))


# --- geometry and frames -----------------------------------------------------------------------------------------


def geometry_cases(robot: RobotDescription) -> list[Case]:
    cases = []
    for joint, size in (("joint_1", -4e-4), ("joint_3", 6e-4), ("joint_6", 1e-3)):
        effect = Effect("joint_offset", joint, None, {"offset_rad": size})
        cases.append(Case(joint, caused("joint_offset", joint, size=size), effect, joint == "joint_3"))
    if robot.joint_names[0] == "rail":
        effect = Effect("joint_offset", "rail", None, {"offset_m": 8e-4})
        cases.append(Case("rail", caused("joint_offset", "rail", size=8e-4), effect))
    for joint, axis in (("joint_2", "tx"), ("joint_3", "tz"), ("joint_3", "rz"), ("joint_4", "ry"), ("joint_5", "ty")):
        unit = np.eye(6)[AXES.index(axis)]
        effect = Effect("link_geometry", joint, axis, {KEYS[AXES.index(axis)]: -5e-4})
        real = caused("link_geometry", joint, axis, -5e-4, direction=unit.tolist())
        cases.append(Case(joint + axis, real, effect, joint == "joint_4"))
    whole = Effect("link_geometry", "joint_5", None, named(KEYS, 1e-3 * STEP))
    cases.append(Case("all", caused("link_geometry", "joint_5", size=1e-3, direction=STEP.tolist()), whole))
    # the product counts a step of the TCP frame along and about the frame's own axes, MuJoCo's along the flange's
    R_flange_tcp = rotation_from_rpy(robot.segments[-1].rpy)
    turned = np.r_[R_flange_tcp @ STEP[:3], R_flange_tcp @ STEP[3:]]
    frame = Effect("tool_frame", None, None, named(KEYS, 1e-3 * STEP))
    cases.append(Case("tcp axes", caused("tool_frame", size=1e-3, direction=turned.tolist()), frame, True))
    base = Effect("base_frame", None, None, named(KEYS, 1e-3 * STEP))
    cases.append(Case("base axes", caused("base_frame", size=1e-3, direction=STEP.tolist()), base, True))
    return cases


def shift_cases(robot: RobotDescription) -> list[Case]:
    """A shift holds from its row on; rows count from 0."""
    time = lay_out_rows(robot, 7).time
    cases = []
    for name in ("frame_shift", "tool_shift"):
        for row in (MID_STAY, NEXT_STAY):
            real = caused(name, size=1e-3, row=row, time_s=float(time[row]), direction=STEP.tolist())
            effect = Effect(name, None, None, {"row": row, **named(KEYS, 1e-3 * STEP)})
            cases.append(Case(f"row {row}", real, effect, row == NEXT_STAY))
    return cases


# --- between motor and link --------------------------------------------------------------------------------------


def drive(robot: RobotDescription, joint: str, error: Callable[[Array], Array]) -> Change:
    """Let a joint's gear stand off by a function of its reading, as a link-side encoder sees it."""
    index = robot.joint_names.index(joint)

    def change(rows: Rows, q: Array) -> Array:
        return q + np.eye(q.shape[1])[index] * error(rows.q[:, index])[:, None]

    return lambda scenario: replace(scenario, transmission=(*scenario.transmission, change))


def drive_cases(robot: RobotDescription) -> list[Case]:
    cases = []
    for joint, width, start in (("joint_2", 6e-4, -0.5), ("joint_3", 4e-4, 0.5), ("joint_5", -5e-4, -0.5)):
        values = {"width_rad": width, "start_ratio": start}
        real = caused("backlash", joint, size=width, start=start)
        cases.append(Case(joint, real, Effect("backlash", joint, None, values), joint == "joint_2"))
    for joint, cycles, phase in (("joint_1", 2.0, 0.7), ("joint_4", 1.0, -2.0), ("joint_3", 11.0, 0.3)):
        real = drive(robot, joint, lambda q, n=cycles, f=phase: 4e-4 * np.sin(n * q + f))
        sine, cosine = 4e-4 * np.cos(phase), 4e-4 * np.sin(phase)  # A sin(n q + f) = A cos f sin n q + A sin f cos n q
        values = {"cycles_per_turn": [cycles], "sine_rad": [float(sine)], "cosine_rad": [float(cosine)]}
        cases.append(Case(joint, real, Effect("transmission_error", joint, None, values), joint == "joint_1"))
    if robot.joint_names[0] == "rail":  # q in metres: 1.5 waves a metre
        real = drive(robot, "rail", lambda q: 3e-4 * np.sin(2 * np.pi * 1.5 * q + 0.4))
        values = {"cycles_per_m": [1.5], "sine_m": [3e-4 * np.cos(0.4)], "cosine_m": [3e-4 * np.sin(0.4)]}
        cases.append(Case("rail", real, Effect("transmission_error", "rail", None, values)))
    else:
        centre = float(np.median(lay_out_rows(robot, 7).q[:, 1]))
        real = caused("transmission_error", "joint_2", size=-5e-4, shape="bump", centre=centre, width=0.15)
        values = {"height_rad": [-5e-4], "centre_rad": [centre], "width_rad": [0.15]}
        cases.append(Case("bump", real, Effect("transmission_error", "joint_2", None, values)))
    for joint, lag in (("joint_1", 0.02), ("joint_3", 0.05), (None, 0.03)):
        effect = Effect("tracking_lag", joint, None, {"lag_s": lag})
        cases.append(Case(str(joint), caused("tracking_lag", joint, size=lag), effect, joint == "joint_3"))
    for skew in (0.02, -0.03):
        effect = Effect("time_skew", None, None, {"skew_s": skew})
        cases.append(Case(f"{skew} s", caused("time_skew", size=skew), effect, skew > 0))
    for joint, other, ratio in (("joint_3", "joint_2", -0.02), ("joint_6", "joint_4", 0.5)):
        effect = Effect("joint_coupling", joint, None, {"other": other, "ratio": ratio})
        real = caused("joint_coupling", joint, size=ratio, kind="other_joint", other=other)
        cases.append(Case(joint, real, effect, joint == "joint_3"))
    effect = Effect("joint_coupling", "joint_5", None, {"reversed": True, "zero_rad": 0.3})
    cases.append(Case("reversed", caused("joint_coupling", "joint_5", kind="reversed", zero=0.3), effect))
    effect = Effect("joint_coupling", "joint_4", None, {"zero_rad": -0.5})
    cases.append(Case("zero", caused("joint_coupling", "joint_4", size=-0.5, kind="zero"), effect))
    return cases


# --- sensors and temperature -------------------------------------------------------------------------------------


def sensor_cases(robot: RobotDescription) -> list[Case]:
    cases = []
    for axes in ("sensor", "base"):
        effect = Effect("wrench_bias", None, None, {"axes": axes, **named(WRENCH_KEYS, BIAS)})
        # the product turns the sensor with the unloaded arm, a milliradian off
        real = caused("wrench_bias", direction=BIAS.tolist(), axes=axes)
        cases.append(Case(axes, real, effect, True, same=2e-6 if axes == "sensor" else SAME))
    for gain in (0.3, -0.2):  # reported = (1 + gain error) true
        effect = Effect("wrench_scale", None, None, {"gain_error_ratio": gain})
        cases.append(Case(f"{gain}", caused("wrench_scale", size=gain), effect, gain > 0, same=1e-7))
    grown = 2e-5 * np.linspace(0.4, 1.6, len(robot.joint_names) + 1)
    known = {"reference_temperature_C": REFERENCE_C}
    alike = Effect("thermal_drift", None, None, {**known, "growth_per_K": 2e-5})
    each = Effect("thermal_drift", None, None, {**known, "segment_growth_per_K": grown.tolist()})
    real = caused("thermal_drift", size=2e-5, weights=[1.0] * len(grown))  # the log holds hundredths of a degree
    cases.append(Case("alike", real, alike, True, same=5e-7))
    cases.append(Case("each", caused("thermal_drift", weights=grown.tolist()), each, same=5e-7))
    return cases


ROBOTS = {"turned": turned_arm(), "rail": rail_arm()}
MAKERS = (spring_cases, law_cases, weight_cases, geometry_cases, shift_cases, drive_cases, sensor_cases)
CASES = {
    (key, case.effect.name, case.label): case
    for key, robot in ROBOTS.items()
    for case in chain.from_iterable(make(robot) for make in MAKERS)
}
#: Where the size is looked for: one of the robots an effect, in turn.
TURN = dict(zip(EFFECTS, cycle(ROBOTS), strict=False))
FITTED = [place for place, case in CASES.items() if case.fit and TURN[case.effect.name] == place[0]]
