"""Ablation of what lowers the probability of a claim: `python -m benchmarks.ablation SUITE..`.

A SUITE is a folder of labelled campaigns (`python -m benchmarks outsider`). Each is fitted once; the claims are then
judged with every mechanism, and without each of them in turn. A term of the map from evidence to probability is
replaced by a fixed value near its mean over claims, so that the constant of the map need not be fitted again. Prints
the map that these claims lead to, and one row a mechanism: required effects that are named, false names, wrong ones
among those stated .8 and more, and campaigns of unknown causes that are called unknown or partly explained.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np
from scipy.optimize import minimize

from benchmarks.answer_scores import Score, score_answer, share
from benchmarks.contestants import frames_of, read_truth
from benchmarks.diagnosis import list_cases, name_of
from compplan.diagnosis.campaign_diagnosis import _register, find_conventions
from compplan.diagnosis.results import verdict as judged
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.state import Fit, Problem
from compplan.diagnosis.validation import probability, unmodelled
from compplan.effects import robot_effects
from compplan.errors import InputError
from compplan.measurement.pooling import pool_rows
from compplan.measurement.reading import read_campaign
from compplan.measurement.registration import fitted_parts
from compplan.robot import read_robot_folder

JUDGE, CAUSES, MAP = judged.__name__, unmodelled.__name__, probability.__name__
#: Margin and residual similarity, as the map weighs them, that stand for a term that is off (assumed: below the means
#: of named claims of labelled campaigns, 3.7 and 2.3, since doubtful ones count too).
MEAN = (2.4, 2.0)
#: What an infinite margin counts in a fit of the map (assumed: the largest finite ones).
LARGEST = 8.3
#: Weight of the squares of the standardised weights in a fit of the map (assumed).
PENALTY = 0.3
#: What replaces a name of a module where a mechanism is off.
Switch = tuple[str, Any]


def _without_term(place: int) -> Switch:
    features = probability.features_of

    def neutral(evidence: probability.Evidence) -> Any:
        found = features(evidence)
        found[place] = MEAN[place]
        return found

    return f"{MAP}.features_of", neutral


def _keep(search: Any, model: Any) -> Any:
    return model


#: Mechanisms, and what stands in their place where they are off. Those of unmodelled causes weigh the claims again.
MECHANISMS: dict[str, tuple[Switch, ...]] = {
    "everything on": (),
    "margin against the best other set": (_without_term(0),),
    "residual similarity": (_without_term(1),),
    "effects alike that share the probability": ((f"{MAP}.AlternativeEffect.competes", False),),
    "bounds": ((f"{JUDGE}.find_breach", lambda *found: ""),),
    "least motion over the noise floor": ((f"{JUDGE}.NAMING", replace(judged.NAMING, nameable=0.0)),),
    "unmodelled causes: removing and adding claims": ((f"{CAUSES}._search_again", _keep),),
    "unmodelled causes: adding claims": ((f"{CAUSES}.SEARCH", replace(unmodelled.SEARCH, least_gain=np.inf)),),
}


@contextmanager
def switched_off(switches: Sequence[Switch]) -> Iterator[None]:
    """Replace what a mechanism consists of."""
    if not switches:
        yield
        return
    name, value = switches[0]
    with patch(name, value, create=name.endswith(".min")), switched_off(switches[1:]):
        yield


def fit_case(case: Path) -> Fit:
    """Fit a campaign as the diagnosis does."""
    robot = read_robot_folder(case / "robot")
    campaign = pool_rows(read_campaign(case / "measurements.csv", robot))
    parts = fitted_parts(campaign, frames_of(read_truth(case)))
    conventions = find_conventions(robot, campaign, parts)
    problem = Problem(robot, campaign, parts, (), (*robot_effects(robot), *conventions))
    return fit_effects(problem, _register(problem, campaign)[0], lambda text: None)


def answer(fit: Fit, doubt: unmodelled.RevisedProbabilities) -> dict[str, Any]:
    """Return the verdict as a contestant's answer; effects known beforehand are left to the score as they are."""
    found = judged.reach_verdict(fit, doubt)
    effects = [
        {"effect": f.effect.name, "joint": f.effect.joint, "axis": f.effect.axis, "probability": f.probability}
        for f in found.findings
    ]  # fmt: skip
    return {"verdict": {"status": found.status, "effects": effects}}


def ablate_case(case: Path) -> tuple[dict[str, Score], list[tuple[Any, bool]]]:
    """Score the answers to one campaign, without each mechanism in turn, and list the evidence of its claims."""
    fit, truth = fit_case(case), read_truth(case)
    doubt = unmodelled.revise_probabilities(fit)
    similarity = judged.rate_similarities(fit, doubt)
    scores = {}
    for name, switches in MECHANISMS.items():
        again = any(where.startswith(CAUSES) for where, _ in switches)
        held: list[Switch] = [] if again else [(f"{JUDGE}.rate_similarities", lambda *claims: similarity)]
        with switched_off([*held, *switches]):
            own = unmodelled.revise_probabilities(fit) if again else doubt
            scores[name] = score_answer(name_of(case), truth, answer(fit, own))
    return scores, list_evidence(case, fit, doubt)


def list_evidence(case: Path, fit: Fit, doubt: unmodelled.RevisedProbabilities) -> list[tuple[Any, bool]]:
    """Return what the map weighs of every claim that a robot can have, named or not, and whether it is right."""
    found = judged.reach_verdict(fit, doubt)
    every = [f for f in (*found.findings, *found.doubtful, *found.minor) if f.evidence is not None and not f.beyond]
    said = [
        {"effect": f.effect.name, "joint": f.effect.joint, "axis": f.effect.axis, "probability": f.probability}
        for f in every
    ]  # fmt: skip
    score = score_answer(name_of(case), read_truth(case), {"verdict": {"status": found.status, "effects": said}})
    pairs = zip(every, score.claims, strict=True)
    return [(probability.features_of(f.evidence), c.right) for f, c in pairs if f.evidence is not None]


def fit_map(claims: Sequence[tuple[Any, bool]]) -> tuple[float, Any]:
    """Return constant and weights, none negative, of the penalised logistic regression of claims."""
    features, right = np.minimum([x for x, _ in claims], LARGEST), np.where([r for _, r in claims], 1.0, -1.0)
    mean, spread = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-9)
    scaled = (features - mean) / spread

    def cost(weights: Any) -> float:
        odds = weights[0] + scaled @ weights[1:]
        return float(np.sum(np.logaddexp(0.0, -right * odds)) + PENALTY * np.sum(weights[1:] ** 2))

    found = minimize(cost, np.zeros(1 + len(mean)), bounds=[(None, None)] + [(0.0, None)] * len(mean)).x
    return float(found[0] - found[1:] / spread @ mean), found[1:] / spread


def row_of(name: str, scores: Sequence[Score]) -> str:
    """Return one row of the table."""
    claims = [claim for score in scores for claim in score.claims]
    unknown = [s.status in ("unknown", "partly_explained") for s in scores if s.kind == "unknown"]
    parts = (
        share(placed for s in scores for placed in s.placed), share(not c.right for c in claims),
        share(not c.right for c in claims if c.probability >= 0.8), share(unknown),
    )  # fmt: skip
    return f"| {name} | " + " | ".join(f"{part['hits']} of {part['count']}" for part in parts) + " |"


@click.command()
@click.argument("suites", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
def main(suites: Sequence[Path]) -> None:
    """Print the table of the labelled campaigns in SUITES."""
    scores: dict[str, list[Score]] = {name: [] for name in MECHANISMS}
    claims: list[tuple[Any, bool]] = []
    with click.progressbar(list_cases(suites), file=sys.stderr) as cases:
        for case in cases:
            try:
                own, evidence = ablate_case(case)
            except InputError as error:
                print(f"{case.name} is refused: {error}", file=sys.stderr)
                continue
            claims += evidence
            for name, score in own.items():
                scores[name].append(score)
    if claims:
        constant, weights = fit_map(claims)
        print(f"map of {len(claims)} claims: {constant:.2f}, {np.round(weights, 2).tolist()}\n")
    print("| without | effects named | false names | wrong at .8 and more | unknown said so |\n|---|---|---|---|---|")
    for name, found in scores.items():
        print(row_of(name, found))


if __name__ == "__main__":
    main()
