"""Candidates: the signatures that a search selects from at one linearization, their priors, and re-evaluation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from compplan.diagnosis.evidence.evidence import EVIDENCE, Prior
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.effects import EFFECTS, frame_shift, tool_shift
from compplan.effects.base_frame import base_twists
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.effects.stiffness_nonlinearity import linear_in_disguise
from compplan.effects.transmission_error import series_at, waves_at
from compplan.measurement.registration import CONTACTS
from compplan.robot import Array

CLASSES = ("zeros", "lengths", "compliances", "bending", "waves", "hysteresis", "warm-up")
#: Class and scale of the background of each effect, in units of the signature's scale (assumed).
BACKGROUND: dict[str, tuple[str, float]] = {
    "joint_offset": ("zeros", 0.05),
    "link_geometry": ("lengths", 0.1),
    "tool_frame": ("lengths", 0.05),
    "joint_stiffness": ("compliances", 0.3),
    "link_compliance": ("bending", 0.1),
    "base_compliance": ("bending", 0.1),
    "transmission_error": ("waves", 0.15),
    "backlash": ("hysteresis", 0.1),
    "thermal_drift": ("warm-up", 0.15),
}
#: Noise floors by which an error of a well calibrated robot moves the target: scale of the classes; the campaign
#: determines their size (assumed).
NO_CAUSE = 0.5
#: Probability that an effect of the vocabulary is present at all (assumed alike for all of them).
PRESENT = 0.06
#: Factor of that probability for effects that few robots can have: an arm with a balancer has it in the maker's model
#: (assumed).
RARE = {"gravity_compensator": 0.15}


REGISTRATION = "registration"
#: Scale of frames without a prior: their standard deviation is then a metre, or a radian (theory: as good as free).
#: [m, rad]
REGISTRATION_SCALE = float(np.sqrt(1.0 / EVIDENCE.free_variance))
Key = tuple[str, str | None, str | None, str]


def key_of(signature: Signature) -> Key:
    """Return place and form of a signature."""
    return (*signature.place, signature.form)


def offered_signatures(at: Linearization, register: Sequence[str], excluded: Sequence[str]) -> Iterator[Signature]:
    """List every signature without an unknown row or period: registration and effects."""
    yield from registration_signatures(at, register)
    # a nonlinear stiffness with a linear part contains a joint's stiffness
    plain = "joint_stiffness" in excluded
    for name, model in EFFECTS.items():
        if name not in excluded:
            for signature in model.signatures(at):
                if not (plain and name == "stiffness_nonlinearity" and linear_in_disguise(signature.keys)):
                    yield signature


def registration_signatures(at: Linearization, parts: Sequence[str]) -> list[Signature]:
    """Return the columns of frames without a prior: the base, and the tool of each target."""
    found = []
    scale = np.full(6, REGISTRATION_SCALE)
    keys = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")
    if "base" in parts:
        twists = base_twists(at)
        if at.campaign.observations is not None:
            twists = twists * ~at.campaign.observations.observed[:, None, None]
        found.append(Signature(REGISTRATION, None, None, "base", keys, scale, twists))
    if "tool" in parts and at.scene.registration is not None:
        R = at.attained.frames.tcp_rotation @ at.scene.registration.tool[at.campaign.target_index, :3, :3]
        for number in range(len(at.campaign.target_names)):
            of_target = (at.campaign.target_index == number)[:, None, None]
            twist = np.zeros((len(R), 6, 6))
            twist[:, :3, :3], twist[:, 3:, 3:] = R * of_target, R * of_target
            found.append(Signature(REGISTRATION, None, None, f"tool {number}", keys, scale, twist))
    return found + (_contact_signatures(at) if CONTACTS in parts else [])


def _contact_signatures(at: Linearization) -> list[Signature]:
    """Return the columns of contact places; a shift of a place moves the measured point in the opposite direction."""
    observations, frames = at.campaign.observations, at.scene.registration
    if observations is None or frames is None:
        return []
    slopes, between = observations.place_slopes(), observations.known.slopes(frames.places)
    scale, keys = np.full(3, REGISTRATION_SCALE), ("tx_m", "ty_m", "tz_m")
    found = []
    for number in range(len(observations.names)):
        twist = np.concatenate([-slopes[:, :, number], np.zeros_like(slopes[:, :, number])], axis=1)
        form = f"{CONTACTS} {number}"
        found.append(Signature(REGISTRATION, None, None, form, keys, scale, twist, between=between[:, None, number]))
    return found


def proposed_signatures(signatures: Sequence[Signature]) -> list[Signature]:
    """Return the signatures whose row or period was found in the residuals of a model."""
    return [s for s in signatures if s.tried > 1]


def propose_again(at: Linearization, proposals: list[Signature], wanted: set[Key]) -> list[Signature]:
    """Recompute earlier proposals with keys in `wanted` at a new linearization."""
    found: list[Signature] = []
    for old in proposals:
        if key_of(old) not in wanted:
            continue
        if old.name in ("frame_shift", "tool_shift"):
            model = frame_shift if old.name == "frame_shift" else tool_shift
            found += [s for s in model.shift_at(at, int(old.fixed["row"]), old.tried) if s.form == old.form]
        else:
            index = at.robot.joint_names.index(str(old.joint))
            cycles = old.fixed.get("cycles_per_turn", old.fixed.get("cycles_per_m", ()))
            series = old.form.startswith("series")
            found.append(
                series_at(at, index, cycles[0], old.tried) if series else waves_at(at, index, cycles, old.tried)
            )
    return found


def in_background(signature: Signature) -> bool:
    """Check whether a signature is part of the background, which contains one form of each place."""
    if signature.name not in BACKGROUND:
        return False
    if signature.name == "link_geometry":
        return signature.axis is not None
    if signature.name == "tool_frame":
        return signature.form == "offset"
    if signature.name == "transmission_error":
        return signature.form.startswith("waves") and signature.tried == 1 and len(signature.keys) == 2
    if signature.name == "thermal_drift":
        return signature.form in ("alike", "alike 3000 s")
    return True


def build_prior(equations: NormalEquations, free: Sequence[int], excluded: Sequence[str] = ()) -> Prior:
    """Assign the background class and scale to every column."""
    classes, spread, unbound = np.full(equations.p, -1), np.zeros(equations.p), np.zeros(equations.p, bool)
    for number, signature in enumerate(equations.signatures):
        columns = equations.columns(number)
        if number in free:
            unbound[columns] = True
        elif signature.name not in excluded and in_background(signature):
            label, scale = BACKGROUND[signature.name]
            motion = np.sqrt(np.mean(np.sum(equations.designs[0][..., columns] ** 2, axis=1), axis=0))
            small = np.sqrt(3.0) * NO_CAUSE / np.maximum(motion, 1e-12)
            classes[columns], spread[columns] = CLASSES.index(label), np.minimum(scale, small)
    return Prior(classes, spread, unbound, np.zeros(equations.p))


def log_priors(signatures: Sequence[Signature]) -> Array:
    """Return the log prior odds of each signature: an effect's odds, shared by its places, then by their forms."""
    places = Counter(name for name, _, _ in {s.place for s in signatures})
    forms = Counter(s.place for s in signatures if s.tried == 1)
    forms.update({s.place: 1 for s in signatures if s.tried > 1})
    odds = np.array([np.log(p / (1.0 - p)) for p in (PRESENT * RARE.get(s.name, 1.0) for s in signatures)])
    chances = [np.log(float(places[s.name] * forms[s.place] * s.tried)) for s in signatures]
    return np.asarray(odds - np.array(chances))
