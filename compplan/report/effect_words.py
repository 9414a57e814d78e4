"""Effects in words, for sentences and tables that an engineer reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from compplan.report.style import format_number

#: What an effect says; {at} is its place.
SENTENCES = {
    "joint_stiffness": "the compliance of {at} differs from the model",
    "link_compliance": "the link behind {at} bends where the model holds it rigid",
    "base_compliance": "the base tilts under load about {at}",
    "stiffness_nonlinearity": "the deflection of {at} is not proportional to its torque",
    "gravity_sag": "link weights bend the arm and the model leaves them out",
    "payload": "the mass of tool or payload, or its centre, differs",
    "gravity_compensator": "a balancing spring or cylinder loads {at}",
    "joint_offset": "the zero of {at} is off",
    "link_geometry": "a length or direction at {at} differs",
    "tool_frame": "the tool centre point differs",
    "base_frame": "measurement frame and robot base are misaligned",
    "backlash": "{at} has lost motion (backlash)",
    "transmission_error": "{at} has an error periodic in its angle",
    "thermal_drift": "the links grow as the robot warms up",
    "wrench_bias": "the force sensor reads with a constant offset",
    "wrench_scale": "the force sensor reads with a wrong gain",
    "tracking_lag": "{at} lags behind the command in motion",
    "frame_shift": "base or measuring instrument moved during the campaign",
    "tool_shift": "tool or target moved on the flange during the campaign",
    "joint_coupling": "the reading of {at} contains another joint's motion, or counts against the model",
    "time_skew": "joint readings and positions were not taken at the same instant",
}
UNITS = {
    "rad_per_Nm": "rad/(N m)", "Nm_per_rad": "N m/rad", "m_per_N": "m/N", "rad_per_N": "rad/N",
    "mm_per_K": "mm/K", "per_K": "1/K",
    "mm_s": "mm/s", "mm": "mm", "um": "um", "m": "m", "deg": "deg", "mrad": "mrad", "urad": "urad", "rad": "rad",
    "Nm": "N m", "N": "N", "kg": "kg", "s": "s", "ms": "ms", "K": "K", "C": "°C", "kgm": "kg m", "kg_m": "kg m",
}  # fmt: skip


def name_place(effect: Mapping[str, Any]) -> str:
    """Name the place of an effect: its joint, its axis, or both; "all joints" where it has none."""
    joint, axis = effect.get("joint"), effect.get("axis")
    if joint and axis:
        return f"{joint} ({axis})"
    return str(joint or axis or "all joints")


def name_effect(effect: Mapping[str, Any]) -> str:
    """Name an effect and its place in a few words, for tables."""
    words = str(effect["effect"]).replace("_", " ")
    place = [str(effect[key]) for key in ("joint", "axis") if effect.get(key)]
    return f"{words}, {' '.join(place)}" if place else words


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Say what an effect is, as a clause."""
    name = str(effect["effect"])
    return SENTENCES.get(name, name.replace("_", " ") + " at {at}").format(at=name_place(effect))


def describe_parameters(parameters: Mapping[str, Any]) -> str:
    """List parameters with their units; the unit is the end of the key."""
    parts = []
    for key, value in parameters.items():
        unit = next((unit for unit in sorted(UNITS, key=len, reverse=True) if key.endswith(f"_{unit}")), "")
        name = (key[: -len(unit) - 1] if unit else key).replace("_", " ")
        parts.append(f"{name} {_show(value)} {UNITS.get(unit, '')}".rstrip())
    return "; ".join(parts)


def _show(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, int | float):
        return format_number(value)
    if isinstance(value, list | tuple):
        shown = [_show(item) for item in value[:6]]
        return f"[{', '.join(shown)}{', …' if len(value) > 6 else ''}]"
    return str(value)
