"""Imitation: a true cause is hardly imitated, a cause without a name as often as chance says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.search import Claim, Model
from compplan.diagnosis.search.state import Fit, Problem
from compplan.diagnosis.validation import spurious_fit as imitation
from compplan.diagnosis.validation.calibrated_probability import Evidence, calibrate_probability
from compplan.diagnosis.validation.spurious_fit import draw_causes, explain_squares, rate_imitations, take_out
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.effects import Effect

CAUSE = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 3e-7})


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    robot = write_small_robot(Path(tmp_path_factory.mktemp("small")))
    campaign = measure(robot, replace(plan_rows(robot, 5, poses=16, loads=1), time=None), [CAUSE], 5, orientation=False)
    return fit_effects(Problem(robot, campaign), None)


def doubt_of(fit: Fit, claims: tuple[Claim, ...], observed: np.ndarray | None = None) -> RevisedProbabilities:
    """Claims of a fit, its observations replaced by others."""
    search = fit.search
    if observed is not None:
        ledger = search.ledger
        design = ledger.designs[0].reshape(-1, ledger.p)
        total = replace(ledger.channels[0].total, against=design.T @ observed, square=float(observed @ observed))
        search = replace(search, ledger=replace(ledger, channels=(replace(ledger.channels[0], total=total),)), cache={})
    return RevisedProbabilities(search, Model(claims, fit.model.posterior, 0.0), (), ())


def best_candidate(fit: Fit, observed: np.ndarray) -> Claim:
    """The candidate that explains most of some observations."""
    ledger = fit.search.ledger
    design = ledger.designs[0].reshape(-1, ledger.p)

    def left(number: int) -> float:
        columns = design[:, ledger.columns(number)]
        return float(np.sum((observed - columns @ np.linalg.lstsq(columns, observed, rcond=1e-4)[0]) ** 2))

    return Claim(min(fit.search.candidates, key=left), 1.0)


def test_a_true_cause_is_hardly_imitated(fit: Fit) -> None:
    (claim,) = fit.model.claims
    assert fit.search.ledger.signatures[claim.signature].place == CAUSE.place
    assert rate_imitations(fit, doubt_of(fit, (claim,)))[claim] < 0.05


def test_causes_without_a_name_are_imitated_as_often_as_others_like_them(
    fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imitation, "SEED", 77)
    monkeypatch.setattr(imitation, "SAMPLE", 24)
    unknown = 30.0 * draw_causes(fit)
    monkeypatch.undo()
    rated = []
    for observed in unknown.T:
        claim = best_candidate(fit, observed)
        rated += rate_imitations(fit, doubt_of(fit, (claim,), observed)).values()
    # uniform between 0 and 1: of 24, 12 +- 2.4 lie below a half, 2.4 +- 1.5 below a tenth
    assert 5 <= np.sum(np.array(rated) < 0.5) <= 19
    assert np.sum(np.array(rated) < 0.1) <= 7


def test_what_columns_explain_is_least_squares(fit: Fit) -> None:
    rng = np.random.default_rng(1)
    design, causes = rng.normal(size=(30, 6)), rng.normal(size=(30, 4))
    gram, against = design.T @ design, design.T @ causes
    squares = np.sum(causes**2, axis=0)
    left, product, rest = take_out(gram, against, squares, np.array([0, 1]))
    explained = explain_squares(left, product, [np.array([2]), np.array([3, 4, 5])])
    for k, columns in enumerate(([2], [3, 4, 5])):
        together = design[:, [0, 1, *columns]]
        whole = causes - together @ np.linalg.lstsq(together, causes, rcond=None)[0]
        assert np.allclose(rest - explained[k], np.sum(whole**2, axis=0))


def test_a_claim_that_a_nameless_cause_would_bring_as_well_is_stated_less_surely() -> None:
    def rate(imitated: float) -> float:
        return calibrate_probability(Evidence(30.0, 30.0, 1.0, 4.0, 0.9, 0.1, imitated, 1.0))

    assert rate(0.15) < rate(0.05) < rate(0.02)
    assert rate(0.9) == rate(0.15)
    assert rate(0.001) == rate(0.02)
