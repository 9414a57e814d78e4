"""The three answers of a diagnosis in a sentence each: where, which, how far; and what no effect explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from compplan.diagnosis.data.conventions import name_counting
from compplan.diagnosis.results.shares import CALIBRATION, UNEXPLAINED, WEIGHT, Share, SmallErrors, kind_of
from compplan.diagnosis.results.verdict import CALIBRATED, FLOORS_LEFT
from compplan.diagnosis.validation.unmodelled import describe_unmodelled
from compplan.io.quantities import format_length, format_number, format_percent
from compplan.reporting.effect_text import describe_change, describe_effect, name_effect

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.where import Split


def describe_where(verdict: Mapping[str, Any], split: Split, *, taken_up: bool = False) -> str:
    """Answer where the gap lies, in a sentence; `taken_up`: whether a calibration takes up what has no name."""
    shares = split.shares
    gap = f"Where: the nominal model leaves {format_length(split.spread.rms)} rms"
    parts: list[str] = []
    if verdict["status"] == CALIBRATED and split.small_errors is not None:
        return f"{gap}; {_describe_places(split.small_errors)}."
    if verdict["status"] == "none":
        return f"{gap}, and no place is named that carries a part of it: it is no more than noise."
    for carrier in shares.carriers[:3]:
        if carrier.share.share >= 0.05 or not parts:
            sure = f"probability {carrier.probability:.2f}, {_describe_interval(carrier.share)} if so"
            how = carrier.effect.replace("_", " ")
            carries = "carry" if carrier.place == "links" else "carries"
            parts.append(f"{carrier.place} {carries} {format_percent(carrier.share.share)} by {how} ({sure})")
    rest = {
        "small errors everywhere (calibration) carry": (shares.by_place[CALIBRATION], _describe_beside_names(split)),
        "what has no name carries" if taken_up else "no model explains": (shares.by_place[UNEXPLAINED], ""),
    }
    parts += [f"{what} {format_percent(share.share)} ({_describe_interval(share)}{more})"
              for what, (share, more) in rest.items() if share.share >= 0.02]  # fmt: skip
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
    told = [
        f"{kind} of {place} {format_percent(share.share)}"
        for place, kind, share in split.small_errors.groups
        if share.share >= 0.05 and (place, kind) not in named and (kind != WEIGHT or ("links", WEIGHT) not in named)
    ][:3]
    return f"; {', '.join(told)} in the updated robot" if told else ""


def _describe_places(errors: SmallErrors) -> str:
    """Say where the small errors of a robot that was not calibrated sit."""
    order = sorted(errors.by_place.items(), key=lambda item: (item[0] == UNEXPLAINED, -item[1].share))
    parts = [
        f"{'no model explains' if name == UNEXPLAINED else name + ' carries'} {format_percent(share.share)} "
        f"({_describe_interval(share)})"
        for name, share in order if share.share >= 0.02
    ]  # fmt: skip
    return "; ".join(parts)


def _describe_interval(share: Share) -> str:
    return f"95 %: {format_percent(share.low)} to {format_percent(share.high)}"


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
        return describe_small_errors(split.small_errors)
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
    if len(effects) > 3:
        text += f"; and {len(effects) - 3} more"
    for effect in effects[:3]:
        rivals = [name_effect(rival) for rival in effect.get("ambiguous_with", [])]
        if rivals:
            text += f"; these measurements fit {name_effect(effect)} as well as {' or '.join(rivals[:3])}"
    if status == "partly_explained":
        text += "; the rest has no name" if taken_up else "; structure is left that none of them explains"
        text += ", and the calibration of the updated robot takes it up to the noise" if taken_up else ""
    left = f" {structure[0]}" if structure and status == "partly_explained" else ""
    return f"{text}.{left}"


def describe_small_errors(errors: SmallErrors) -> str:
    """Say what a robot that was not calibrated has small errors of, and where."""
    kinds = [
        f"{kind} {format_percent(share.share)} ({_describe_interval(share)})"
        for kind, share in sorted(errors.by_kind.items(), key=lambda item: -item[1].share)
        if share.share >= 0.02 and kind != UNEXPLAINED
    ]
    text = f"Which: no single cause; small errors make the gap: {', '.join(kinds)}"
    groups = [f"{kind} of {place}, {format_percent(share.share)}" for place, kind, share in errors.groups[:3]]
    return f"{text}. The largest: {'; '.join(groups)}." if groups else f"{text}."


def describe_how_far(gap: Mapping[str, float | None]) -> str:
    """Answer how far the gap shrinks, in a sentence."""
    before, after = gap.get("held_out_before_rms_mm"), gap.get("held_out_after_rms_mm")
    floor = gap.get("noise_floor_mm")
    if before is None or after is None:
        return "How far: too few rows to leave some out, so no figure can be given."
    text = f"How far: on rows that had no part in the choice the deviation goes from {format_length(1e-3 * before)} "
    text += f"to {format_length(1e-3 * after)} rms"
    if floor:
        text += f", {format_number(after / floor, 3)} times the noise floor of {format_length(1e-3 * floor)}"
    return f"{text}."


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


def describe_counting(diagnosis: Diagnosis) -> str:
    """Say whose way of counting the named conventions are; "" where there are none, or they are nobody's."""
    name = name_counting(diagnosis.robot, [finding.effect for finding in diagnosis.verdict.findings])
    return f"The joints of the log are counted as a {name} counts them." if name else ""
