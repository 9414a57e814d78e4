"""A diagnosis in words: its effects, the three answers (where, which, how far), the next step, what is unexplained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from compplan.diagnosis.results.shares import CALIBRATION, UNEXPLAINED, WEIGHT, Share, SmallErrors, kind_of
from compplan.diagnosis.results.verdict import CALIBRATED, FLOORS_LEFT
from compplan.diagnosis.validation.unmodelled import describe_unmodelled
from compplan.effects import EFFECTS
from compplan.io.quantities import format_length, format_number, format_percent
from compplan.reporting.page import join_names

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.where import Split

#: Units that keys of parameters end in, where they are written otherwise.
UNITS = {
    "rad_per_Nm": "rad/(N m)", "Nm_per_rad": "N m/rad", "m_per_N": "m/N", "rad_per_N": "rad/N", "mm_per_K": "mm/K",
    "per_K": "1/K", "mm_s": "mm/s", "Nm": "N m", "C": "°C", "kgm": "kg m", "kg_m": "kg m",
} | {unit: unit for unit in ("mm", "um", "m", "deg", "mrad", "urad", "rad", "N", "kg", "s", "ms", "K")}  # fmt: skip


def name_effect(effect: Mapping[str, Any]) -> str:
    """Name an effect and its place in a few words, for tables."""
    words = str(effect["effect"]).replace("_", " ")
    place = [str(effect[key]) for key in ("joint", "axis") if effect.get(key)]
    return f"{words}, {' '.join(place)}" if place else words


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Say what an effect is, as a clause that names its joint, its axis, or both; "all joints" where it has none."""
    name, joint, axis = str(effect["effect"]), effect.get("joint"), effect.get("axis")
    place = f"{joint} ({axis})" if joint and axis else str(joint or str(axis or "all joints").removeprefix("r"))
    words: str = EFFECTS[name].words if name in EFFECTS else name.replace("_", " ") + " at {at}"
    return words.format(at=place)


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
    if isinstance(value, list | tuple):
        return f"[{', '.join(_show(item) for item in value[:6])}{', …' if len(value) > 6 else ''}]"
    return format_number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def describe_where(verdict: Mapping[str, Any], split: Split, *, taken_up: bool = False) -> str:
    """Answer where the gap lies, in a sentence; `taken_up`: whether a calibration takes up what has no name."""
    shares, status = split.shares, verdict["status"]
    gap = f"Where: the nominal model leaves {format_length(split.spread.rms)} rms"
    if status == CALIBRATED and split.small_errors is not None:
        places = sorted(split.small_errors.by_place.items(), key=lambda item: (item[0] == UNEXPLAINED, -item[1].share))
        carried = [
            f"{'no model explains' if name == UNEXPLAINED else name + ' carries'} {_describe_share(share)}"
            for name, share in places if share.share >= 0.02
        ]  # fmt: skip
        return f"{gap}; {'; '.join(carried)}."
    if status == "none":
        return f"{gap}, and no place is named that carries a part of it: it is no more than noise."
    parts: list[str] = []
    for carrier in shares.carriers[:3]:
        if carrier.share.share >= 0.05 or not parts:
            sure = f"probability {carrier.probability:.2f}, {_describe_interval(carrier.share)} if so"
            carries = "carry" if carrier.place == "links" else "carries"
            share, how = format_percent(carrier.share.share), carrier.effect.replace("_", " ")
            parts.append(f"{carrier.place} {carries} {share} by {how} ({sure})")
    rest = {
        "small errors everywhere (calibration) carry": (shares.by_place[CALIBRATION], _describe_beside_names(split)),
        "what has no name carries" if taken_up else "no model explains": (shares.by_place[UNEXPLAINED], ""),
    }
    parts += [f"{what} {_describe_share(share, more)}" for what, (share, more) in rest.items() if share.share >= 0.02]
    if shares.noise >= 0.02:
        parts.append(f"noise is {format_percent(shares.noise)}")
    if not shares.carriers:
        parts.insert(0, "no joint, frame, sensor or load is named that carries a part of it")
    return f"{gap}; {'; '.join(parts)}."


def _describe_beside_names(split: Split) -> str:
    """Say which kinds of small errors, each at one joint, are the largest beside the named effects."""
    if split.small_errors is None:
        return ""
    named = {(c.place, kind_of(c.effect, loaded)) for c in split.shares.carriers for loaded in (False, True)}
    largest = [
        f"{kind} of {place} {format_percent(share.share)}"
        for place, kind, share in split.small_errors.groups
        if share.share >= 0.05 and (place, kind) not in named and (kind != WEIGHT or ("links", WEIGHT) not in named)
    ][:3]
    return f"; {', '.join(largest)} in the updated robot" if largest else ""


def _describe_interval(share: Share) -> str:
    return f"95 %: {format_percent(share.low)} to {format_percent(share.high)}"


def _describe_share(share: Share, more: str = "") -> str:
    return f"{format_percent(share.share)} ({_describe_interval(share)}{more})"


def reaches_noise(gap: Mapping[str, float | None], delivered: str) -> bool:
    """Tell whether a calibration goes out that takes what has no name up to the noise of rows left out."""
    after, floor = gap.get("held_out_after_rms_mm"), gap.get("noise_floor_mm")
    return bool(delivered == "calibrated" and after and floor and after <= FLOORS_LEFT * floor)


def describe_which(
    verdict: Mapping[str, Any], structure: Sequence[str], split: Split, *, taken_up: bool = False
) -> str:  # fmt: skip
    """Answer which effect causes the gap, in a sentence; `taken_up`: whether a calibration takes the rest up."""
    status, effects = verdict["status"], verdict["effects"]
    if status == "none":
        return "Which: none; the residual is noise."
    if status == CALIBRATED and split.small_errors is not None:
        return _describe_small_errors(split.small_errors)
    if not effects:
        if taken_up:
            return "Which: unknown; no single effect makes it, and the calibration of the updated robot takes it up."
        text = " ".join(structure[:1])
        return f"Which: unknown; there is structure in the residual and no effect explains it. {text}".rstrip()
    parts = [
        f"{describe_effect(effect)} ({change + ', ' if (change := describe_change(effect)) else ''}"
        f"probability {effect['probability']:.2f})"
        for effect in effects[:3]
    ]
    text = f"Which: {'; '.join(parts)}"
    text += f"; and {len(effects) - 3} more" if len(effects) > 3 else ""
    for effect in effects[:3]:
        rivals = [name_effect(rival) for rival in effect.get("ambiguous_with", [])]
        if rivals:
            text += f"; these measurements fit {name_effect(effect)} as well as {' or '.join(rivals[:3])}"
    if status != "partly_explained":
        return f"{text}."
    text += "; the rest has no name" if taken_up else "; structure is left that none of them explains"
    text += ", and the calibration of the updated robot takes it up to the noise" if taken_up else ""
    return " ".join([f"{text}.", *structure[:1]])


def _describe_small_errors(errors: SmallErrors) -> str:
    """Say what a robot that was not calibrated has small errors of, and where."""
    kinds = [
        f"{kind} {_describe_share(share)}"
        for kind, share in sorted(errors.by_kind.items(), key=lambda item: -item[1].share)
        if share.share >= 0.02 and kind != UNEXPLAINED
    ]
    text = f"Which: no single cause; small errors make the gap: {', '.join(kinds)}"
    groups = [f"{kind} of {place}, {format_percent(share.share)}" for place, kind, share in errors.groups[:3]]
    return f"{text}. The largest: {'; '.join(groups)}." if groups else f"{text}."


def describe_how_far(gap: Mapping[str, float | None]) -> str:
    """Answer how far the gap shrinks, in a sentence."""
    before, after = gap.get("held_out_before_rms_mm"), gap.get("held_out_after_rms_mm")
    if before is None or after is None:
        return "How far: too few rows to leave some out, so no figure can be given."
    text = f"How far: on rows that had no part in the choice the deviation goes from {format_length(1e-3 * before)} "
    text += f"to {format_length(1e-3 * after)} rms"
    if floor := gap.get("noise_floor_mm"):
        text += f", {format_number(after / floor, 3)} times the noise floor of {format_length(1e-3 * floor)}"
    return f"{text}."


def describe_next(verdict: Mapping[str, Any], delivered: str, poses: str) -> str:
    """Say what to do next; `delivered`: kind of the robot folder; `poses`: which to measure (`list_poses`)."""
    doubtful = [effect for effect in verdict["effects"] if effect.get("ambiguous_with")]
    todo, more = "Plan with the updated robot: compplan plan JOB --robot OUT/robot.", f"Measure more poses, {poses}"
    if doubtful:
        rivals = join_names([name_effect(rival) for rival in doubtful[0]["ambiguous_with"][:2]])
        later = f" Until then: {todo[:1].lower()}{todo[1:]}" if delivered != "nominal" else ""
        return f"{more}: {rivals} would explain the measurements as well.{later}"
    if verdict["status"] == "none":
        return "Nothing has to be done. Measure again after the next crash or service."
    return f"Nothing predicts better than the robot folder as it was. {more}." if delivered == "nominal" else todo


def list_poses(table: Mapping[str, Any], where: str) -> str:
    """Say which poses to measure next: those of diagnosis.json, which stand `where`, or other ones."""
    listed = any(step.get("poses") for step in table["next_measurement"])
    return f"as listed {where}" if listed else "other ones than these"


def describe_structure(diagnosis: Diagnosis) -> list[str]:
    """Say what is left that no effect explains; nothing where small errors everywhere are said to make the gap."""
    structure, named = diagnosis.verdict.structure, bool(diagnosis.verdict.findings)
    if not structure.left or diagnosis.verdict.status == CALIBRATED:
        return []
    # claims may move the target further than the gap, against small errors: they explain no more than there is
    explained = format_length(min(structure.explained, structure.gap))
    against = f", against {explained} that the named effects explain" if named else ""
    if structure.dependences:
        parts = [
            f"{describe_unmodelled(d.effect.joint, str(d.effect.axis))} ({format_length(d.explained)} rms)"
            for d in structure.dependences
        ]
        beyond = "Beyond the named effects there is" if named else "No effect explains"
        return [f"{beyond} {'; '.join(parts)}{against}."]
    return [
        f"An error of {format_length(structure.rms)} rms is constant while the robot stands still and matches "
        f"no effect of the vocabulary{against}."
    ]
