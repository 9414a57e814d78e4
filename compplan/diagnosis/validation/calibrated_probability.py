"""Certainty: from what the evidence of a claim shows to the probability that it is stated with."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.special import expit

from compplan.diagnosis.data.shared import NEGLIGIBLE
from compplan.robot import Array

#: No claim is surer than this (assumed: one campaign in a hundred holds what nobody thought of).
MOST_SURE = 0.99
#: Log odds are divided by this: evidence of real campaigns is less sharp than its model (assumed).
TEMPER = 2.0
#: The map from evidence to log odds, fitted by penalised logistic regression to the claims of development campaigns and
#: of parts of measured ones, where a claim is right as often as parts without a common pose weigh it, too (assumed: the
#: study of November 2026 is not kept): constant, margin (arsinh of it over its scale), share of halves that
#: repeat the claim, and logarithms with their signs turned: of the probability that a cause without a name would be
#: explained as fully, and of the likeness of what is left. No weight may be negative. The number of values of a form
#: does not stand here: the margin has paid for it.
CONSTANT, WEIGHTS = -4.04, np.array([0.57, 0.55, 0.69, 0.83])
#: Margins beyond this count by their logarithm alone (assumed).
MARGIN_SCALE = 5.0
#: Imitations more frequent than this tell no more: a larger cause stands beside the claim, and whether that has a name
#: says nothing about this one (assumed).
MOST_IMITATED = 0.15
#: Less than a tenth of a claim's own motion left along it says nothing, and neither does more than all of it (assumed).
LEAST_ALIKE = 0.1


@dataclass(frozen=True)
class Evidence:
    """What the probability of a claim rests on.

    Attributes:
        margin: Log posterior odds against the best model without it, errors that no effect makes allowed.
        plain: The same where nothing but effects and small errors is allowed.
        repeated: Share of the halves of the campaign that tell it, too.
        floors: Motion that it explains, in noise floors.
        part: Motion that it explains over the gap.
        left: What is left beyond the noise floor over the gap.
        imitated: Probability that a cause without a name would be explained as fully as what the other claims leave is
            by this one (compplan.diagnosis.validation.spurious_fit).
        likeness: What is left along the claim's own motion beyond chance, over that motion
            (compplan.diagnosis.validation.residual_similarity).
    """

    margin: float
    plain: float
    repeated: float
    floors: float
    part: float
    left: float
    imitated: float
    likeness: float

    def to_table(self) -> dict[str, float]:
        """Return what diagnosis.json holds."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return what the map weighs: margin, repetition, imitation, likeness. Shape (4,)."""
    margin = np.arcsinh(min(evidence.margin, evidence.plain) / MARGIN_SCALE)
    imitated = np.log(np.clip(evidence.imitated, NEGLIGIBLE, MOST_IMITATED))
    alike = np.log(np.clip(evidence.likeness, LEAST_ALIKE, 1.0))
    return np.array([margin, evidence.repeated, -imitated, -alike])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the probability that a claim is stated with.

    Args:
        evidence: What the claim shows.
    """
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MOST_SURE))
