"""Fit the map from evidence to probability: `python -m benchmarks.calibrate_certainty ANSWERS SUITE..`.

A SUITE holds drawn campaigns (truth.json in each), ANSWERS the product's answers as benchmarks.diagnosis_score keeps
them. Penalised logistic regression with weights that cannot be negative, over every claim that was
weighed, named or not; the development suite is for this, reporting seeds are not. Claims of shapeless curves, which are
stated with one probability, are left out. Prints the constants of compplan/diagnose/certainty.py and how the map does
on claims left out in turn.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.answer_scores import is_known, judge, list_small
from benchmarks.contestants import read_truth
from benchmarks.diagnosis_score import list_cases, name_of
from compplan.diagnose.certainty import Evidence, features_of
from compplan.diagnose.verdict import SHAPELESS

Array = NDArray[np.float64]
#: Half the precision of the weights' normal prior, and folds of the check.
RIDGE, FOLDS = 2.0, 5


def read_claims(answers: Path, suites: Sequence[Path]) -> tuple[Array, Array]:
    """Collect features, shape (n, 6), and whether each claim is right, shape (n,)."""
    features, right = [], []
    for case in list_cases(suites):
        file = answers / f"{name_of(case)}.json"
        if not file.exists():
            continue
        truth, verdict = read_truth(case), json.loads(file.read_text()).get("verdict", {})
        known, small = [e for e in truth["effects"] if is_known(e)], list_small(truth)
        for claim in (*verdict.get("effects", []), *verdict.get("doubtful", [])):
            shown = claim.get("evidence")
            if shown and claim["probability"] != SHAPELESS:
                features.append(features_of(Evidence(**shown)))
                right.append(judge(claim, known, small).right)
    return np.array(features), np.array(right, float)


def fit_map(features: Array, right: Array) -> Array:
    """Return constant and weights. Shape (7,)."""

    def cost(weights: Array) -> float:
        odds = features @ weights[1:] + weights[0]
        return float(-np.sum(right * odds - np.logaddexp(0.0, odds)) + RIDGE * np.sum(weights[1:] ** 2))

    return np.asarray(minimize(cost, np.zeros(7), bounds=[(None, None)] + [(0.0, None)] * 6).x)


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
    print(f"CONSTANT, MARGIN, REPEATED, VALUES, IMITATED, LIKENESS, LIKENESS_BESIDE = {constants}")
    print(f"{len(right)} claims, left out in turn: {named.sum()} named, {right[named].mean():.3f} of them right")
    print(f"{sure.sum()} stated .8 and more, {1.0 - right[sure].mean():.3f} of them wrong")
    print(f"{int(right[~named].sum())} right ones withheld")


if __name__ == "__main__":
    main()
