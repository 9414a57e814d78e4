"""Effects in words, for sentences and tables that an engineer reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from compplan.effects import EFFECTS
from compplan.io.quantities import format_length, format_number

UNITS = {
    "rad_per_Nm": "rad/(N m)", "Nm_per_rad": "N m/rad", "m_per_N": "m/N", "rad_per_N": "rad/N",
    "mm_per_K": "mm/K", "per_K": "1/K",
    "mm_s": "mm/s", "mm": "mm", "um": "um", "m": "m", "deg": "deg", "mrad": "mrad", "urad": "urad", "rad": "rad",
    "Nm": "N m", "N": "N", "kg": "kg", "s": "s", "ms": "ms", "K": "K", "C": "°C", "kgm": "kg m", "kg_m": "kg m",
}  # fmt: skip


#: Units for small sizes of parameters, by the end of their key: factor on SI and unit.
SMALL = {
    "rad_per_Nm": (1e9, "nrad/(N m)"), "m_per_N": (1e9, "nm/N"), "rad_per_N": (1e9, "nrad/N"), "_rad": (1e6, "µrad"),
    "_m": (1e6, "µm"), "ratio": (1e2, "%"), "_N": (1.0, "N"), "_Nm": (1.0, "N m"), "_kg": (1.0, "kg"),
}  # fmt: skip


def show_size(key: str, value: float) -> str:
    """Write a size in the unit that its key ends with; one of unknown unit as it is."""
    end = key.split("#")[0]
    factor, unit = next((SMALL[name] for name in SMALL if end.endswith(name)), (1.0, ""))
    return f"{format_number(factor * value)}\u00a0{unit}".rstrip()


def name_place(effect: Mapping[str, Any]) -> str:
    """Name the place of an effect: its joint, its axis, or both; "all joints" where it has none."""
    joint, axis = effect.get("joint"), effect.get("axis")
    if joint and axis:
        return f"{joint} ({axis})"
    return str(joint or str(axis or "all joints").removeprefix("r"))


def name_effect(effect: Mapping[str, Any]) -> str:
    """Name an effect and its place in a few words, for tables."""
    words = str(effect["effect"]).replace("_", " ")
    place = [str(effect[key]) for key in ("joint", "axis") if effect.get(key)]
    return f"{words}, {' '.join(place)}" if place else words


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Say what an effect is, as a clause."""
    name = str(effect["effect"])
    words: str = EFFECTS[name].words if name in EFFECTS else name.replace("_", " ") + " at {at}"
    return words.format(at=name_place(effect))


def describe_parameters(parameters: Mapping[str, Any], ends: Mapping[str, Any] | None = None) -> str:
    """List parameters with their units, and their 95 % intervals where they are known; a key ends in its unit."""
    parts = []
    for key, value in parameters.items():
        unit = next((unit for unit in sorted(UNITS, key=len, reverse=True) if key.endswith(f"_{unit}")), "")
        name = (key[: -len(unit) - 1] if unit else key).replace("_", " ")
        between = f", 95 %: {_show(ends[key][0])} to {_show(ends[key][1])}" if ends and key in ends else ""
        parts.append(f"{name} {_show(value)} {UNITS.get(unit, '')}".rstrip() + between)
    return "; ".join(parts)


def describe_change(effect: Mapping[str, Any]) -> str:
    """Say by how much a compliance changes, in percent of the model's with its 95 % interval; "" of other effects."""
    if "change_percent" not in effect:
        return ""
    value, low, high = effect["change_percent"]
    half = 0.5 * (high - low)
    digits = 0 if half >= 0.95 else 1
    return f"{value:+.{digits}f} % ± {half:.{digits}f} %".replace("-", "−")


def list_effects(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """List named effects: probability, motion of the tip, size with unit and 95 % interval, and what fits as well."""
    lines = []
    for effect in effects:
        place = " ".join(str(effect[key]) for key in ("effect", "joint", "axis") if effect.get(key))
        size = describe_change(effect)
        size = f"{size} (95 %)" if size else describe_parameters(effect["parameters"], effect.get("interval95"))
        rivals = " or ".join(name_effect(rival) for rival in effect.get("ambiguous_with", [])[:3])
        lines.append(
            f"  {place}: probability {effect['probability']:.2f}, moves the tip "
            f"{format_length(1e-3 * effect['explained_rms_mm'])}; {size}"
            + (f"; fits as well: {rivals}" if rivals else "")
        )
    return lines


def _show(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, int | float):
        return format_number(value)
    if isinstance(value, list | tuple):
        shown = [_show(item) for item in value[:6]]
        return f"[{', '.join(shown)}{', …' if len(value) > 6 else ''}]"
    return str(value)
