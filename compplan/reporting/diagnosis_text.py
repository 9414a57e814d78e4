"""Text of a diagnosis: effects, next step, unexplained part of the gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from compplan.diagnosis.results.verdict import CALIBRATED, FLOORS_LEFT
from compplan.diagnosis.validation.unmodelled import describe_unmodelled
from compplan.effects import EFFECTS
from compplan.io.quantities import format_length, format_mm, format_number

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis

#: Displayed units by the unit suffix of parameter keys.
UNITS = {
    "rad_per_Nm": "rad/(N m)", "Nm_per_rad": "N m/rad", "m_per_N": "m/N", "rad_per_N": "rad/N", "mm_per_K": "mm/K",
    "per_K": "1/K", "mm_s": "mm/s", "Nm": "N m", "C": "°C", "kgm": "kg m", "kg_m": "kg m",
} | {unit: unit for unit in ("mm", "um", "m", "deg", "mrad", "urad", "rad", "N", "kg", "s", "ms", "K")}  # fmt: skip

#: Descriptions of the outcomes of planted effects.
OUTCOMES = {"found": "found", "tied": "named as an effect that fits as well", "confused": "named as another effect",
            "missed": "not found"}  # fmt: skip


def name_effect(effect: Mapping[str, Any]) -> str:
    """Return the name of an effect with its joint and axis, for tables."""
    words = str(effect["effect"]).replace("_", " ")
    place = [str(effect[key]) for key in ("joint", "axis") if effect.get(key)]
    return f"{words}, {' '.join(place)}" if place else words


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Describe an effect as a clause with its joint, its axis, or both; "all joints" if it has neither."""
    name, joint, axis = str(effect["effect"]), effect.get("joint"), effect.get("axis")
    place = f"{joint} ({axis})" if joint and axis else str(joint or str(axis or "all joints").removeprefix("r"))
    words: str = EFFECTS[name].words if name in EFFECTS else name.replace("_", " ") + " at {at}"
    return words.format(at=place)


def describe_parameters(parameters: Mapping[str, Any], ends: Mapping[str, Any] | None = None) -> str:
    """Format parameters with units, m and rad as mm and mrad, and 95 % intervals if known; a key ends in its unit."""
    parts = []
    for key, value in parameters.items():
        unit = next((unit for unit in sorted(UNITS, key=len, reverse=True) if key.endswith(f"_{unit}")), "")
        name = (key[: -len(unit) - 1] if unit else key).replace("_", " ")
        size, label = (1e3, f"m{unit}") if unit in ("m", "rad") else (1, UNITS.get(unit, ""))
        low, high = (_show(end, size) for end in ends[key]) if ends and key in ends else ("", "")
        if name == "axes":
            parts.append(f"in {value} axes")
            continue
        parts.append(f"{name} {_show(value, size)} {label}".rstrip() + (f", 95 %: {low} to {high}" if low else ""))
    return "; ".join(parts)


def describe_change(effect: Mapping[str, Any]) -> str:
    """Format the change of a compliance in percent of the model value, with 95 % interval; "" for other effects."""
    if "change_percent" not in effect:
        return ""
    value, low, high = effect["change_percent"]
    half = 0.5 * (high - low)
    digits = 0 if half >= 0.95 else 1
    return f"{value:+.{digits}f} % ± {half:.{digits}f} %".replace("-", "−")


def list_effects(effects: Sequence[Mapping[str, Any]]) -> list[str]:
    """List named effects: probability, motion of the tip, size with unit and 95 % interval, ambiguous effects."""
    lines = []
    for effect in effects:
        place = " ".join(str(effect[key]) for key in ("effect", "joint", "axis") if effect.get(key))
        size = describe_change(effect)
        size = (
            f"compliance {size} (95 %)" if size else describe_parameters(effect["parameters"], effect.get("interval95"))
        )
        rivals = "; ".join(name_effect(rival) for rival in effect.get("ambiguous_with", [])[:3])
        lines.append(
            f"{place}: probability {effect['probability']:.2f}, moves the tip by "
            f"{format_mm(1e-3 * effect['explained_rms_mm'])} (rms); {size}"
            + (f"; causes that fit as well: {rivals}" if rivals else "")
        )
    return lines


def _show(value: Any, size: float = 1) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_show(item, size) for item in value[:6])}{', …' if len(value) > 6 else ''}]"
    return format_number(size * value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def reaches_noise(gap: Mapping[str, float | None], delivered: str) -> bool:
    """Return whether the folder is a calibration with an error on held-out rows of at most FLOORS_LEFT noise floors."""
    after, floor = gap.get("held_out_after_rms_mm"), gap.get("noise_floor_mm")
    return bool(delivered == "calibrated" and after and floor and after <= FLOORS_LEFT * floor)


def describe_next(table: Mapping[str, Any], delivered: str, where: str) -> str:
    """Describe the next step of diagnosis.json; `delivered`: kind of the robot folder; `where` its poses are listed."""
    verdict, listed = table["verdict"], any(step.get("poses") for step in table["next_measurement"])
    more = f"Measure more poses, {f'as listed {where}' if listed else 'other ones than in this log'}"
    todo = "Plan with the updated robot: compplan plan JOB --robot OUT/robot"
    if any(effect.get("ambiguous_with") for effect in verdict["effects"]):
        later = f" Until then: {todo[:1].lower()}{todo[1:]}" if delivered != "nominal" else ""
        return f"{more}: they separate the causes that fit as well.{later}"
    if any(effect["effect"] == "wrench_bias" for effect in verdict["effects"]):
        todo = f"Zero the force sensor before the next log. {todo}"
    if verdict["status"] == "none":
        return "Nothing to do now. Measure again after the next collision or service."
    same = "The robot model is delivered unchanged: no update predicts poses outside the fit better"
    return f"{same}. {more}." if delivered == "nominal" else todo


def describe_self_test(tested: Mapping[str, Any]) -> list[str]:
    """Summarise a self-test: outcomes of the planted effects, and share of correct effects by stated probability.

    tested: `self_test` of diagnosis.json.
    """
    planted = tested["planted"]
    if not planted:
        return ["self-test: ended before the first diagnosis was done"]
    by_outcome = {word: [one for one in planted if one["outcome"] == word] for word in OUTCOMES}
    counts = ", ".join(f"{len(own)} {OUTCOMES[word]}" for word, own in by_outcome.items())
    lines = [f"self-test, {len(planted)} of {tested['asked']} effects planted in these poses and this noise: {counts}"]
    for word in ("tied", "confused"):
        lines += [
            f"  {OUTCOMES[word]}: {name_effect(one)} as {' and '.join(name_effect(named) for named in one['named'])}"
            for one in by_outcome[word]
        ]
    missed = [f"{name_effect(one)} ({format_length(1e-3 * one['moved_rms_mm'])})" for one in by_outcome["missed"]]
    lines += [f"  {OUTCOMES['missed']} (motion of the target): {'; '.join(missed)}"] if missed else []
    stated = [
        f"{part['right']} of {part['named']} named with probability {part['from_probability']:g} and more"
        for part in tested["probabilities"]
    ]
    return [*lines, f"  right: {'; '.join(stated)}"]


def describe_structure(diagnosis: Diagnosis) -> list[str]:
    """Describe the unexplained part of the gap; empty if there is none, or if all is attributed to small errors."""
    structure, named = diagnosis.verdict.structure, bool(diagnosis.verdict.findings)
    if not structure.left or diagnosis.verdict.status == CALIBRATED:
        return []
    # effects opposed by small errors may move the target further than the gap: at most the gap is explained
    explained = format_length(min(structure.explained, structure.gap))
    against = f"; the named effects explain {explained}" if named else ""
    if structure.dependences:
        parts = [
            f"{describe_unmodelled(d.effect.joint, str(d.effect.axis))} ({format_length(d.explained)} rms)"
            for d in structure.dependences
        ]
        return [f"Not explained: {'; '.join(parts)}{against}."]
    return [
        f"Not explained: {format_length(structure.rms)} rms, repeatable at each pose; no known effect matches{against}."
    ]
