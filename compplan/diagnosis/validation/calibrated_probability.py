"""Certainty: from what the evidence of a claim shows to the probability that it is stated with."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.special import expit

from compplan.robot import Array

#: No claim is surer than this (assumed: one campaign in a hundred holds what nobody thought of).
MOST_SURE = 0.99
#: Log odds are divided by this: evidence of real campaigns is less sharp than its model (assumed).
TEMPER = 2.0
#: The map from evidence to log odds, fitted by penalised logistic regression to the claims of drawn campaigns (study:
#: python -m benchmarks.ablation): constant, margin (arsinh of it over its scale), and logarithm of the likeness of what
#: is left with its sign turned. No weight may be negative. The number of values of a form does not stand here: the
#: margin has paid for it.
CONSTANT, WEIGHTS = -5.22, np.array([0.97, 2.32])
#: Margins beyond this count by their logarithm alone (assumed).
MARGIN_SCALE = 5.0
#: Less than a tenth of a claim's own motion left along it says nothing, and neither does more than all of it (assumed).
LEAST_ALIKE = 0.1


@dataclass(frozen=True)
class Evidence:
    """What the probability of a claim rests on.

    Attributes:
        margin: Log posterior odds against the best model without it, errors that no effect makes allowed.
        plain: The same where nothing but effects and small errors is allowed.
        floors: Motion that it explains, in noise floors.
        part: Motion that it explains over the gap.
        left: What is left beyond the noise floor over the gap.
        likeness: What is left along the claim's own motion beyond chance, over that motion
            (compplan.diagnosis.validation.residual_similarity).
    """

    margin: float
    plain: float
    floors: float
    part: float
    left: float
    likeness: float

    def to_table(self) -> dict[str, float]:
        """Return what diagnosis.json holds."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return what the map weighs: margin and likeness. Shape (2,)."""
    margin = np.arcsinh(min(evidence.margin, evidence.plain) / MARGIN_SCALE)
    return np.array([margin, -np.log(np.clip(evidence.likeness, LEAST_ALIKE, 1.0))])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the probability that a claim is stated with.

    Args:
        evidence: What the claim shows.
    """
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MOST_SURE))
