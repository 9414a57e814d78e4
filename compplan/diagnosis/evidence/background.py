"""The background: what a sound, calibrated robot still has a little of everywhere, and each effect's prior odds.

A robot is never its model: zeros, lengths and compliances are slightly off, links bend a little, gears wave, friction
leaves some hysteresis, and it warms up. These errors are real but no cause of a gap; an effect has to stand out of
them. How large each class is, is fitted to the campaign; the scales here say what would be no surprise (all assumed).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from compplan.diagnosis.evidence.evidence import Prior
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.effects.signature import Signature
from compplan.robot import Array

CLASSES = ("zeros", "lengths", "compliances", "bending", "waves", "hysteresis", "warm-up")
#: Class and scale of the background of each effect, in units of the signature's own scale (assumed).
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
#: An error that moves the target by this many noise floors is what a robot has that is calibrated as well as it can be
#: measured: the scale of the classes; the campaign decides their size (assumed).
NO_CAUSE = 0.5
#: Probability that an effect of the vocabulary is present at all (assumed alike for all of them).
PRESENT = 0.06
#: Effects that fewer robots can have at all: an arm has a balancer or has none, and its maker's model then holds it
#: (assumed).
RARE = {"gravity_compensator": 0.15}


def in_background(signature: Signature) -> bool:
    """Tell whether a signature is part of the background: one form of each place is enough."""
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


def build_prior(ledger: NormalEquations, free: Sequence[int], excluded: Sequence[str] = ()) -> Prior:
    """Give every column its background.

    Args:
        ledger: The signatures and their columns.
        free: Signatures that every model fits freely (registration).
        excluded: Effects that are left out of the candidates and of the background.
    """
    classes, spread, unbound = np.full(ledger.p, -1), np.zeros(ledger.p), np.zeros(ledger.p, bool)
    for number, signature in enumerate(ledger.signatures):
        columns = ledger.columns(number)
        if number in free:
            unbound[columns] = True
        elif signature.name not in excluded and in_background(signature):
            label, scale = BACKGROUND[signature.name]
            motion = np.sqrt(np.mean(np.sum(ledger.designs[0][..., columns] ** 2, axis=1), axis=0))
            small = np.sqrt(3.0) * NO_CAUSE / np.maximum(motion, 1e-12)
            classes[columns], spread[columns] = CLASSES.index(label), np.minimum(scale, small)
    return Prior(classes, spread, unbound, np.zeros(ledger.p))


def log_priors(signatures: Sequence[Signature]) -> Array:
    """Return the log prior odds of each signature: an effect's odds, shared by its places, then by their forms."""
    places = Counter(name for name, _, _ in {s.place for s in signatures})
    forms = Counter(s.place for s in signatures if s.tried == 1)
    forms.update({s.place: 1 for s in signatures if s.tried > 1})
    odds = np.array([np.log(p / (1.0 - p)) for p in (PRESENT * RARE.get(s.name, 1.0) for s in signatures)])
    chances = [np.log(float(places[s.name] * forms[s.place] * s.tried)) for s in signatures]
    return np.asarray(odds - np.array(chances))
