"""Rules of effects.toml: place, parameters and bounds of each effect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.effects.signature import Signature
from compplan.errors import InputError, UnknownNameError
from compplan.job.names import EFFECTS
from compplan.robot import Array, Robot
from compplan.robot.elasticity import SOFTEST

#: Kinds of parameters without numeric bounds: a row, a flag, a joint or joints of the robot, axes of a wrench.
ROW, FLAG, JOINT, JOINTS, AXES = "row", "flag", "joint", "joints", ("base", "sensor")
TURNS, SHIFTS = ("rx", "ry", "rz"), ("tx", "ty", "tz")
#: Greatest compliance [rad/(N m), m/N], step [m, rad], angle [rad] and load [N, N m].
SOFT, STEP, ANGLE, LOAD = 1e-2, 10.0, 2.0 * math.pi, 1e6
TWIST = {**{f"{axis}_m": STEP for axis in SHIFTS}, **{f"{axis}_rad": ANGLE for axis in TURNS}}
WAVES = (
    ("cycles_per_turn", "sine_rad", "cosine_rad"), ("cycles_per_m", "sine_m", "cosine_m"),
    ("height_rad", "centre_rad", "width_rad"), ("height_m", "centre_m", "width_m"), ("spline_rad", "knots_rad"),
    ("spline_m", "knots_m"),
)  # fmt: skip
WRENCH = {**{f"f{axis}_N": LOAD for axis in "xyz"}, **{f"m{axis}_Nm": LOAD for axis in "xyz"}}


@dataclass(frozen=True)
class Rule:
    """Schema of one effect: parameters, joint and axes."""

    #: Its parameters: greatest absolute value, or one of the kinds above.
    keys: Mapping[str, float | str | tuple[str, ...]]
    joint: str = "none"  #: Whether it has a joint: "needed", "free" or "none".
    axes: tuple[str, ...] = ()  #: Allowed axes.
    groups: tuple[tuple[str, ...], ...] = ()  #: Sets of keys of which one has to be complete.
    lists: tuple[tuple[str, ...], ...] = ()  #: Sets of keys that are lists of one length.


RULES: dict[str, Rule] = {
    "joint_stiffness": Rule(
        {"compliance_change_rad_per_Nm": SOFT, "compliance_change_m_per_N": SOFT}, "needed",
        groups=(("compliance_change_rad_per_Nm",), ("compliance_change_m_per_N",)),
    ),
    "link_compliance": Rule(
        {"compliance_rad_per_Nm": SOFT, "compliance_m_per_N": SOFT}, "needed", TURNS + SHIFTS,
        (("compliance_rad_per_Nm",), ("compliance_m_per_N",)),
    ),
    "base_compliance": Rule({"compliance_rad_per_Nm": SOFT}, "none", TURNS, (("compliance_rad_per_Nm",),)),
    "stiffness_nonlinearity": Rule(
        {"linear_ratio": 1e3, "quadratic_ratio": 1e3, "cubic_ratio": 1e3, "soft_zone_ratio": 1e3,
         "saturating_ratio": 1e3, "compliance": SOFT, "reference_load": LOAD, "zone_load": LOAD}, "needed",
        groups=(("compliance", "reference_load", "zone_load"),),
    ),
    "gravity_sag": Rule(
        {"gravity_m_s2": 20.0, "joints": JOINTS, "compliance_rad_per_Nm": SOFT},
        groups=(("gravity_m_s2",), ("joints", "compliance_rad_per_Nm")), lists=(("joints", "compliance_rad_per_Nm"),),
    ),
    "payload": Rule({"mass_kg": 1e5, "first_moment_kg_m": 1e6}, groups=(("mass_kg", "first_moment_kg_m"),),
                    lists=(("first_moment_kg_m",),)),
    "gravity_compensator": Rule(
        dict.fromkeys(("sine_Nm", "cosine_Nm", "constant_Nm", "sine_2_Nm", "cosine_2_Nm"), LOAD), "needed",
        groups=(("sine_Nm",), ("cosine_Nm",), ("constant_Nm",)),
    ),
    "joint_offset": Rule({"offset_rad": ANGLE, "offset_m": STEP}, "needed", groups=(("offset_rad",), ("offset_m",))),
    "link_geometry": Rule(TWIST, "needed", TURNS + SHIFTS, tuple((key,) for key in TWIST)),
    "tool_frame": Rule(TWIST, groups=tuple((key,) for key in TWIST)),
    "base_frame": Rule(TWIST, groups=tuple((key,) for key in TWIST)),
    "frame_shift": Rule({"row": ROW, **TWIST}, groups=(("row",),)),
    "tool_shift": Rule({"row": ROW, **TWIST}, groups=(("row",),)),
    "backlash": Rule({"width_rad": ANGLE, "width_m": STEP, "start_ratio": 1.0}, "needed",
                     groups=(("width_rad",), ("width_m",))),
    "transmission_error": Rule(
        {**{f"{part}_{unit}": STEP for part in ("sine", "cosine", "height", "spline") for unit in ("rad", "m")},
         **{f"{part}_{unit}": 1e3 for part in ("centre", "width", "knots") for unit in ("rad", "m")},
         "cycles_per_turn": 1e5, "cycles_per_m": 1e6}, "needed",
        groups=WAVES, lists=WAVES,
    ),
    "thermal_drift": Rule(
        {"time_constant_s": 1e7, "reference_temperature_C": 200.0, "growth_ratio": 0.1, "growth_per_K": 1e-2,
         "segment_growth_ratio": 0.1, "segment_growth_per_K": 1e-2},
        groups=(("time_constant_s",), ("reference_temperature_C",)),
        lists=(("segment_growth_ratio",), ("segment_growth_per_K",)),
    ),
    "wrench_bias": Rule({"axes": AXES, **WRENCH}, groups=(("axes",),)),
    "wrench_scale": Rule({"gain_error_ratio": 10.0}, groups=(("gain_error_ratio",),)),
    "tracking_lag": Rule({"lag_s": 10.0}, "free", groups=(("lag_s",),)),
    "joint_coupling": Rule(
        {"other": JOINT, "ratio": 100.0, "reversed": FLAG, "zero_rad": ANGLE, "zero_m": STEP}, "needed",
        groups=(("other", "ratio"), ("reversed",), ("zero_rad",), ("zero_m",)),
    ),
    "time_skew": Rule(
        {"skew_s": 100.0, "encoder_skew_s": 100.0, "stale_ratio": 10.0},
        groups=(("skew_s",), ("encoder_skew_s",), ("stale_ratio",)),
    ),
}  # fmt: skip
#: Parameters that have to be positive.
POSITIVE = ("time_constant_s", "reference_load", "cycles_per_turn", "cycles_per_m")


def check_effect(table: Mapping[str, Any], robot: Robot, file: Path | None, where: str) -> None:
    """Refuse an entry of effects.toml with a wrong place or parameters; its effect and joint are known to exist.

    An effect without a rule in `RULES` or its module is only checked for finite numbers.

    Raises:
        InputError: With file and key.
    """
    parameters = table["parameters"]
    for key, value in parameters.items():
        numbers = value if isinstance(value, list) else [value]
        if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
            at = f"{where}.parameters.{key}"
            raise InputError(f"is {value!r}, expected a finite number", file=file, where=at)
    name = str(table["effect"])
    rule: Rule | None = RULES.get(name) or getattr(EFFECTS.get(name), "rule", None)
    if rule is None:
        return
    _check_place(table, rule, robot, file, where)
    for key, value in parameters.items():
        at = f"{where}.parameters.{key}"
        if key not in rule.keys:
            raise InputError(f"unknown key, choose from {list(rule.keys)}", file=file, where=at)
        _check_value(value, rule, key, robot, file, at)
    if rule.groups and not any(set(group) <= set(parameters) for group in rule.groups):
        wanted = " or ".join(" and ".join(group) for group in rule.groups)
        raise InputError(f"missing key, expected {wanted}", file=file, where=f"{where}.parameters")
    for key in ("compliance_rad_per_Nm", "compliance_m_per_N"):
        if isinstance(value := parameters.get(key), float) and value < 0.0:
            message = f"is {value:g}, expected 0 or more"
            raise InputError(message, file=file, where=f"{where}.parameters.{key}")
    _check_lengths(parameters, rule, robot, file, f"{where}.parameters")


def limit_sizes(robot: Robot, signature: Signature, sizes: Array) -> Array:
    """Limit parameters, (k,) [SI], of an effect that is added to a robot to the bounds of its folder."""
    rule: Rule | None = RULES.get(signature.name) or getattr(EFFECTS.get(signature.name), "rule", None)
    most = np.full(len(sizes), np.inf)
    for number, key in enumerate(signature.keys):
        name, _, item = key.partition("#")
        bound = None if rule is None else rule.keys.get(name)
        if isinstance(bound, int | float):
            most[number] = bound
        if name.startswith("compliance"):
            joint = signature.fixed[JOINTS][int(item)] if item and JOINTS in signature.fixed else signature.joint
            axis = signature.axis or "own"
            held = sum(s.compliance for s in robot.springs if (s.joint, s.axis) == (joint, axis))
            softest = SOFTEST["t" if "m_per_N" in name and "Nm" not in name else "r"]
            most[number] = min(most[number], (1.0 - 1e-9) * max(softest - held, 0.0))
    return np.clip(sizes, -most, most)


def _check_place(table: Mapping[str, Any], rule: Rule, robot: Robot, file: Path | None, where: str) -> None:
    name, joint, axis = table["effect"], table.get("joint"), table.get("axis")
    if rule.joint == "needed" and joint is None:
        raise InputError(f"{name} needs a joint, choose from {_places(name, robot)}", file=file, where=f"{where}.joint")
    if joint is not None and joint not in _places(name, robot):
        raise UnknownNameError("joint that moves", str(joint), _places(name, robot), file=file, where=f"{where}.joint")
    if rule.joint == "none" and joint is not None:
        raise InputError(f"{name} takes no joint; remove this key", file=file, where=f"{where}.joint")
    if axis is not None and axis not in rule.axes:
        allowed = f"choose from {list(rule.axes)}" if rule.axes else "leave it out"
        raise InputError(f"{name} has no axis {axis!r}, {allowed}", file=file, where=f"{where}.axis")
    if name in ("link_compliance", "base_compliance") and axis is None:
        raise InputError(f"{name} needs an axis, choose from {list(rule.axes)}", file=file, where=f"{where}.axis")


def _places(name: str, robot: Robot) -> list[str]:
    fixed_too = name in ("link_compliance", "link_geometry")
    return [joint.name for joint in robot.joints] if fixed_too else list(robot.joint_names)


def _check_value(value: Any, rule: Rule, key: str, robot: Robot, file: Path | None, at: str) -> None:
    """Refuse a parameter of the wrong type or size."""
    kind = rule.keys[key]
    if kind == ROW:
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise InputError(f"is {value!r}, expected a row counted from 0", file=file, where=at)
    elif kind == FLAG:
        if not isinstance(value, bool):
            raise InputError(f"is {value!r}, expected true or false", file=file, where=at)
    elif kind in (JOINT, JOINTS):
        for name in value if kind == JOINTS and isinstance(value, list) else [value]:
            if name not in robot.joint_names:
                raise UnknownNameError("joint", str(name), list(robot.joint_names), file=file, where=at)
    elif isinstance(kind, tuple):
        if value not in kind:
            raise InputError(f"is {value!r}, choose from {list(kind)}", file=file, where=at)
    else:
        bound, listed = float(kind), any(key in keys for keys in rule.lists)
        for number in value if listed and isinstance(value, list) else [value]:
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise InputError(f"is {value!r}, expected a number", file=file, where=at)
            if abs(number) > bound or (key in POSITIVE and number <= 0.0):
                least = "more than 0 and " if key in POSITIVE else ""
                raise InputError(f"is {number:g}, expected {least}at most {bound:g} in size", file=file, where=at)


def _check_lengths(parameters: Mapping[str, Any], rule: Rule, robot: Robot, file: Path | None, where: str) -> None:
    """Refuse lists of different lengths, and numbers in place of lists; a spline has 4 knots more than numbers."""
    due = {"first_moment_kg_m": (3, "three numbers")}
    growth = robot.nq + 1, f"{robot.nq + 1} numbers, one before each joint and the flange"
    due |= dict.fromkeys(("segment_growth_ratio", "segment_growth_per_K"), growth)
    for keys in rule.lists:
        values = [parameters.get(key) for key in keys]
        if all(value is None for value in values) or (keys[0] == JOINTS and JOINTS not in parameters):
            continue
        count, wanted = due.get(keys[0], (None, "lists of equal length"))
        if keys[-1].startswith("knots"):
            wanted = "a spline of n numbers, which needs n + 4 knots"
        lengths = {
            len(value) - 4 * key.startswith("knots") if isinstance(value, list) else -1
            for key, value in zip(keys, values, strict=True)
        }
        if len(lengths) > 1 or -1 in lengths or count not in (None, *lengths):
            raise InputError(f"{', '.join(keys)}: expected {wanted}", file=file, where=where)
