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
#: The map from evidence to log odds, fitted by penalised logistic regression to the claims of development campaigns
#: (study: python -m benchmarks.calibrate_certainty): constant, margin (arsinh of it over its scale), share of halves
#: that repeat the claim, and logarithms with their signs turned: of the number of values of its simplest form, of the
#: probability that a cause without a name would be explained as fully, and of the likeness of what is left, without and
#: with errors that have no name. No weight may be negative.
CONSTANT, MARGIN, REPEATED, VALUES, IMITATED, LIKENESS, LIKENESS_BESIDE = -1.9, 0.41, 0.66, 0.97, 0.90, 1.14, 0.86
#: Margins beyond the first count by their logarithm alone; those below the second tell no more (assumed).
MARGIN_SCALE, LEAST_MARGIN = 5.0, -20.0
#: Neither do imitations rarer or more frequent than these: the first is what the causes drawn can tell; beyond the
#: second a larger cause stands beside the claim, and whether that has a name says nothing about this one (assumed).
LEAST_IMITATED, MOST_IMITATED = 0.02, 0.15
#: What chance leaves along a claim's own motion says nothing, and neither does more than this many times as much
#: (assumed: by then it is plain).
MOST_ALIKE = 5.0


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
        values: Number of values of the simplest lawful form of its place that explains as well.
        imitated: Probability that a cause without a name would be explained as fully as what the other claims leave is
            by this one (compplan.diagnose.imitation).
        likeness: What is left along the claim's own motion over what lies across it, in units of the most that chance
            leaves there (compplan.diagnose.likeness).
        likeness_beside: The same of what errors without a name leave besides.
    """

    margin: float
    plain: float
    repeated: float
    floors: float
    part: float
    left: float
    values: int
    imitated: float
    likeness: float
    likeness_beside: float

    def to_table(self) -> dict[str, float]:
        """Return what diagnosis.json holds."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return what the map weighs: margin, repetition, values, imitation, both likenesses. Shape (6,)."""
    margin = np.arcsinh(max(min(evidence.margin, evidence.plain), LEAST_MARGIN) / MARGIN_SCALE)
    imitated = np.log(np.clip(evidence.imitated, LEAST_IMITATED, MOST_IMITATED))
    alike = np.log(np.clip([evidence.likeness, evidence.likeness_beside], 1.0, MOST_ALIKE))
    return np.array([margin, evidence.repeated, -np.log(evidence.values), -imitated, *-alike])


def rate_certainty(evidence: Evidence) -> float:
    """Return the probability that a claim is stated with.

    Args:
        evidence: What the claim shows.
    """
    weights = np.array([MARGIN, REPEATED, VALUES, IMITATED, LIKENESS, LIKENESS_BESIDE])
    odds = CONSTANT + weights @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MOST_SURE))
