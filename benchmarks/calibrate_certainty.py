"""Fit the map from evidence to probability: `python -m benchmarks.calibrate_certainty ANSWERS SUITE..`.

A SUITE holds drawn campaigns or parts of real ones (truth.json in each), ANSWERS the product's answers as
benchmarks.diagnosis_score keeps them. Penalised logistic regression with weights that cannot be negative, over every
claim that was weighed, named or not; the development suite is for this, reporting seeds are not. A claim of a drawn
campaign is right by its truth; one of a real part is right as often as the parts that share no pose with it (`disjoint`
in its truth.json) weigh it, too. Claims of shapeless curves, which are stated with one probability, are left out.
Prints the constants of compplan/diagnosis/validation/calibrated_probability.py and how the map does on claims left out
in turn.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.answer_scores import is_known, judge, list_small
from benchmarks.contestants import read_truth
from benchmarks.diagnosis_score import list_cases, name_of
from compplan.diagnosis.results.verdict import SHAPELESS
from compplan.diagnosis.validation.calibrated_probability import Evidence, features_of

Array = NDArray[np.float64]
#: Half the precision of the weights' normal prior, and folds of the check.
RIDGE, FOLDS = 2.0, 5


def read_claims(answers: Path, suites: Sequence[Path]) -> tuple[Array, Array]:
    """Collect features, shape (n, 4), and how far each claim is right, shape (n,)."""
    features, right = [], []
    for case in list_cases(suites):
        file = answers / f"{name_of(case)}.json"
        if not file.exists():
            continue
        truth = read_truth(case)
        known, small = [e for e in truth["effects"] if is_known(e)], list_small(truth)
        others = [answers / f"{case.parent.name}__{name}.json" for name in truth.get("disjoint", [])]
        weighed = [[(c["effect"], c["joint"]) for c in list_weighed(other)] for other in others if other.exists()]
        if truth["kind"] == "real" and not weighed:
            continue
        for claim in list_weighed(file):
            features.append(features_of(Evidence(**claim["evidence"])))
            if weighed:
                right.append(float(np.mean([(claim["effect"], claim["joint"]) in other for other in weighed])))
            else:
                right.append(float(judge(claim, known, small).right))
    return np.array(features), np.array(right)


def list_weighed(file: Path) -> list[dict[str, Any]]:
    """List the claims of an answer that the map weighs: named or not, of a lawful form and size."""
    verdict = json.loads(file.read_text()).get("verdict", {})
    claims = [*verdict.get("effects", []), *verdict.get("doubtful", [])]
    return [c for c in claims if c.get("evidence") and c["probability"] != SHAPELESS]


def fit_map(features: Array, right: Array) -> Array:
    """Return constant and weights. Shape (5,)."""

    def cost(weights: Array) -> float:
        odds = features @ weights[1:] + weights[0]
        return float(-np.sum(right * odds - np.logaddexp(0.0, odds)) + RIDGE * np.sum(weights[1:] ** 2))

    return np.asarray(minimize(cost, np.zeros(5), bounds=[(None, None)] + [(0.0, None)] * 4).x)


def main() -> None:
    """Fit and check."""
    features, right = read_claims(Path(sys.argv[1]), [Path(name).resolve() for name in sys.argv[2:]])
    fold = np.random.default_rng(0).permutation(len(right)) % FOLDS
    stated = np.zeros(len(right))
    for number in range(FOLDS):
        weights = fit_map(features[fold != number], right[fold != number])
        stated[fold == number] = expit(features[fold == number] @ weights[1:] + weights[0])
    named, sure = stated >= 0.5, stated >= 0.8
    constants = ", ".join(f"{w:.2f}" for w in fit_map(features, right))
    print(f"CONSTANT, MARGIN, REPEATED, IMITATED, LIKENESS = {constants}")
    print(f"{len(right)} claims, left out in turn: {named.sum()} named, {right[named].mean():.3f} of them right")
    print(f"{sure.sum()} stated .8 and more, {1.0 - right[sure].mean():.3f} of them wrong")
    print(f"{int(right[~named].sum())} right ones withheld")


if __name__ == "__main__":
    main()
