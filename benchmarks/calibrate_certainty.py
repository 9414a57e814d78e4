"""Fit the map from evidence to probability: `python -m benchmarks.calibrate_certainty SUITE ANSWERS`.

SUITE holds drawn campaigns (truth.json in each), ANSWERS one diagnosis.json a campaign (ANSWERS/case/diagnosis.json, or
ANSWERS/case.json). Penalised logistic regression with weights that cannot be negative, over every claim that was
weighed, named or not; the development suite is for this, reporting seeds are not. Prints CONSTANT and WEIGHTS of
compplan/diagnose/certainty.py, and how a map fitted to campaigns of one parity does on those of the other.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.answer_scores import REAL, is_known, judge, size_of
from benchmarks.contestants import read_truth
from compplan.diagnose.certainty import Evidence, features_of

Array = NDArray[np.float64]
#: Half the precision of the weights' normal prior.
RIDGE = 1.0


def read_claims(suite: Path, answers: Path) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Collect features, shape (n, k), whether each claim is right and whether its seed is odd. Shapes (n,)."""
    features, right, odd = [], [], []
    for file in sorted(suite.glob("*/truth.json")):
        case = file.parent.name
        answer = next((f for f in (answers / case / "diagnosis.json", answers / f"{case}.json") if f.exists()), None)
        if answer is None:
            continue
        truth, verdict = read_truth(file.parent), json.loads(answer.read_text()).get("verdict", {})
        known = [e for e in truth["effects"] if is_known(e)]
        small = [b for b in truth.get("background", []) if size_of(b, truth.get("sigma_mm")) >= REAL]
        for claim in (*verdict.get("effects", []), *verdict.get("doubtful", [])):
            shown = claim.get("evidence")
            if shown:
                features.append(features_of(Evidence(**shown)))
                right.append(judge(claim, known, small).right)
                odd.append(int(truth["seed"]) % 2 == 1)
    return np.array(features), np.array(right, float), np.array(odd)


def fit_map(features: Array, right: Array) -> Array:
    """Return constant and weights. Shape (1 + k,)."""

    def cost(weights: Array) -> float:
        odds = features @ weights[1:] + weights[0]
        return float(-np.sum(right * odds - np.logaddexp(0.0, odds)) + RIDGE * np.sum(weights[1:] ** 2))

    count = features.shape[1]
    bounds = [(None, None)] + [(0.0, None)] * count
    return np.asarray(minimize(cost, np.zeros(1 + count), bounds=bounds).x)


def main() -> None:
    """Fit and check."""
    features, right, odd = read_claims(Path(sys.argv[1]), Path(sys.argv[2]))
    stated = np.zeros(len(right))
    for half in (odd, ~odd):
        weights = fit_map(features[half], right[half])
        stated[~half] = expit(features[~half] @ weights[1:] + weights[0])
    named, sure = stated >= 0.5, stated >= 0.8
    constant, *weights = fit_map(features, right)
    print(f"CONSTANT, WEIGHTS = {constant:.2f}, ({', '.join(f'{w:.2f}' for w in weights)})")
    print(f"{len(right)} claims, each by the map of the other half:")
    print(f"{named.sum()} named, {right[named].mean():.3f} of them right")
    print(f"{sure.sum()} stated .8 and more, {1.0 - right[sure].mean():.3f} of them wrong")
    print(f"{int(right[~named].sum())} right ones withheld")


if __name__ == "__main__":
    main()
