"""What may be asked of a diagnosis: how visible each cause is, and which other answers are acceptable for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Cause, Key, Sized
from benchmarks.outsider.everyday import Everyday
from benchmarks.outsider.observe import observe
from benchmarks.outsider.robots import Robot
from benchmarks.outsider.settings import Settings
from benchmarks.outsider.signatures import Signatures, linearize
from benchmarks.outsider.turns import Array
from benchmarks.outsider.weighing import Imitation, Instrument, Scale, best_second, imitate, register, rms

VISIBLE = 4.5  # a known effect must stand out by this many standard deviations, or the case is drawn again
ACCEPTED_DISTANCE, ACCEPTED_R2 = 2.0, 0.98  # a rival this near is an acceptable answer
TEXTBOOK_R2 = 0.7  # the plain formula must explain this much of the true motion
# An unknown cause must keep this distance from one effect of the list and from two, and be explained by at most this.
UNLIKE_ONE, UNLIKE_TWO, UNLIKE_R2 = 5.0, 3.0, 0.93
PARAMETERS: Mapping[str, int] = {
    "stiffness_nonlinearity": 2,
    "gravity_compensator": 2,
    "payload": 4,
    "transmission_error": 3,
    "frame_shift": 7,
    "tool_shift": 4,
    "wrench_bias": 6,
    "base_frame": 6,
    "tool_frame": 3,
    "thermal_drift": 2,
}


@dataclass(frozen=True)
class Bench:
    """What a case is weighed with: robot, given campaign, settings, instrument, everyday errors, signatures."""

    robot: Robot
    campaign: Campaign
    settings: Settings
    instrument: Instrument
    everyday: Sequence[Everyday]
    signatures: Signatures

    def scale(self, frames: Array, leave: Key | None = None, free: Sequence[Array] = (), bare: bool = False) -> Scale:
        """The space of noise and everyday errors, one place left out of these; `bare` is noise alone."""
        there = [] if bare else [b.columns for b in self.everyday if b.key != leave and b.columns is not None]
        return Scale(self.campaign, self.settings, self.instrument, frames, there, free)


@dataclass(frozen=True)
class Weighed:
    """A cause's motion as it is seen; its imitations beside everyday errors, in noise alone, beside other causes."""

    y: Array
    visible: float
    visible_beside_others: float
    beside_errors: Mapping[Key, Imitation]
    in_noise: Mapping[Key, Imitation]
    beside_others: Mapping[Key, Imitation]


def label_causes(bench: Bench, causes: Sequence[Sized]) -> tuple[list[dict[str, Any]], Array] | None:
    """Label every cause of a case.

    From a sag on, signatures and frames are those of the nominal folder, which has no gravity.

    Returns:
        The labels and the columns of unknown frames; None if the case asks for what nobody could say.
    """
    robot, campaign, signatures = bench.robot, bench.campaign, bench.signatures
    whole = observe(robot, campaign, causes, bench.everyday).gap
    parts = [whole - observe(robot, campaign, causes, bench.everyday, without=i).gap for i in range(len(causes))]
    bare = bench.scale(bench.signatures.frames, bare=True)
    frames, labels = bench.signatures.frames, []
    for i, sized in enumerate(causes):
        signatures = bench.signatures
        if sized.cause.effect == "gravity_sag":
            signatures = linearize(robot, campaign, bench.settings, gravity=False)
            frames = signatures.frames
        others = [part for j, part in enumerate(parts) if j != i]
        weighed = _weigh(bench, sized.cause, parts[i], others, signatures, frames, bare)
        label = _label(bench, sized, parts[i], weighed, signatures, frames)
        if label is None:
            return None
        labels.append(label)
    return labels, frames


def _weigh(
    bench: Bench,
    cause: Cause,
    part: Array,
    others: Sequence[Array],
    signatures: Signatures,
    frames: Array,
    bare: Scale,
) -> Weighed:
    y, beside_errors = imitate(bench.scale(frames, cause.key), part, signatures)
    in_noise = imitate(bare, part, signatures)[1]
    y_others: Array = y
    beside_others: dict[Key, Imitation] = {}
    if others:
        y_others, beside_others = imitate(bench.scale(frames, cause.key, others), part, signatures)
    visible, beside = float(np.linalg.norm(y)), float(np.linalg.norm(y_others))
    return Weighed(y, visible, beside, beside_errors, in_noise, beside_others)


def _label(
    bench: Bench, sized: Sized, part: Array, weighed: Weighed, signatures: Signatures, frames: Array
) -> dict[str, Any] | None:
    """The label of one cause; None where it is not to be seen, not like its formula, or not unknown enough."""
    cause, known = sized.cause, sized.cause.effect != "unknown"
    if weighed.visible < VISIBLE or (known and weighed.visible_beside_others < VISIBLE):
        return None
    rivals = sorted(_list_rivals(cause, weighed), key=lambda rival: rival["distance"])
    textbook = weighed.in_noise[cause.key].explained if cause.key in weighed.in_noise else None
    if known and (textbook is None or textbook < TEXTBOOK_R2):
        return None
    label: dict[str, Any] = {
        "effect": cause.effect,
        "joint": cause.joint,
        "axis": cause.axis,
        "size": sized.size,
        "params": cause.params,
        "unit": cause.unit,
    }
    acceptable = [rival for rival in rivals if "why" in rival]
    if not known:
        pair = _best_pair(bench, cause, weighed, signatures, frames)
        if acceptable or pair is None:
            return None
        label |= {"kind": cause.kind, "note": cause.note, "in_vocabulary": False, "best_pair": pair}
    return label | {
        **_gaps(bench, part, frames),
        "parameters": PARAMETERS.get(cause.effect, 1) if known else None,
        "visible": round(weighed.visible, 2),
        "visible_beside_others": round(weighed.visible_beside_others, 2),
        "required": weighed.visible >= VISIBLE,
        "textbook_r2": None if textbook is None else round(textbook, 5),
        "acceptable": acceptable,
        "nearest_rivals": rivals[:5],
    }


def _list_rivals(cause: Cause, weighed: Weighed) -> list[dict[str, Any]]:
    """How near every other effect and place comes; `why` says what makes it an acceptable answer."""
    rivals = []
    for key, near in weighed.beside_errors.items():
        if key == cause.key:
            continue
        r2 = weighed.in_noise[key].explained if key in weighed.in_noise else 0
        rival: dict[str, Any] = dict(zip(("effect", "joint", "axis"), key, strict=True))
        rival |= {"r2": round(r2, 5), "r2_weighed": round(near.explained, 5), "distance": round(near.distance, 2)}
        rival["parameters"] = PARAMETERS.get(key[0], 1)
        why = ["distance"] if near.distance < ACCEPTED_DISTANCE else []
        if r2 >= ACCEPTED_R2:
            why.append("R2")
        if key in weighed.beside_others:
            beside = weighed.beside_others[key].distance
            rival["distance_beside_others"] = round(beside, 2)
            if beside < ACCEPTED_DISTANCE:
                why.append("distance beside the other effects")
        rivals.append(rival | ({"why": ", ".join(why)} if why else {}))
    return rivals


def _best_pair(
    bench: Bench, cause: Cause, weighed: Weighed, signatures: Signatures, frames: Array
) -> dict[str, Any] | None:
    """How near one effect of the list and then a second come to an unknown cause; None if they come too near."""
    first = min(weighed.beside_errors, key=lambda key: weighed.beside_errors[key].distance)
    near = weighed.beside_errors[first]
    if near.distance < UNLIKE_ONE or near.explained > UNLIKE_R2:
        return None
    left, second = best_second(bench.scale(frames, cause.key), weighed.y, near.basis, signatures)
    distance = float(np.sqrt(max(left, 0)))
    if distance < UNLIKE_TWO or second is None:
        return None
    return {
        "first": list(first),
        "r2_first": round(near.explained, 4),
        "second": list(second),
        "r2_both": round(1 - left / float(weighed.y @ weighed.y), 4),
        "distance_both": round(distance, 2),
    }


def _gaps(bench: Bench, part: Array, frames: Array) -> dict[str, Any]:
    """Size of a cause's motion as it is and registered, beside the instrument's noise."""
    campaign = bench.campaign
    whole, registered = rms(part[:, :3]), rms(register(part[:, :3], frames))
    moving = np.logical_not(campaign.static)
    seen = registered if campaign.register else whole
    return {
        "gap_rms_mm": whole * 1e3,
        "gap_registered_rms_mm": registered * 1e3,
        "gap_static_rms_mm": rms(part[campaign.static, :3]) * 1e3,
        "gap_path_rms_mm": rms(part[moving, :3]) * 1e3 if moving.any() else None,
        "parts": [],
        "over_sigma": round(seen / bench.instrument.sigma_rms(campaign), 3),
    }
