"""Spurious-fit probability: small for a true cause, uniform for errors that no effect makes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis.evidence.normal_equations import project_out
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.search import Claim, Model
from compplan.diagnosis.search.state import Fit, Problem
from compplan.diagnosis.validation import probability
from compplan.diagnosis.validation.probability import (
    Evidence,
    calibrate_probability,
    draw_errors,
    explain_squares,
    rate_spurious_fits,
)
from compplan.diagnosis.validation.unmodelled import RevisedProbabilities
from compplan.effects import Effect

CAUSE = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 3e-7})


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    robot = write_small_robot(Path(tmp_path_factory.mktemp("small")))
    campaign = measure(robot, replace(plan_rows(robot, 5, poses=16, loads=1), time=None), [CAUSE], 5, orientation=False)
    return fit_effects(Problem(robot, campaign), None)


def rate(fit: Fit, claim: Claim, observed: np.ndarray | None = None) -> float:
    """Rate one claim of a fit, its observations replaced by others."""
    search = fit.search
    if observed is not None:
        equations = search.equations
        design = equations.designs[0].reshape(-1, equations.p)
        total = equations.channels[0].total
        total = replace(total, against=design.T @ observed, square=float(observed @ observed))
        channels = (replace(equations.channels[0], total=total),)
        search = replace(search, equations=replace(equations, channels=channels), cache={})
    revised = RevisedProbabilities(search, Model((claim,), fit.model.posterior, 0.0), (), ())
    return rate_spurious_fits(fit, revised)[claim]


def test_a_true_cause_is_hardly_a_spurious_fit(fit: Fit) -> None:
    (claim,) = fit.model.claims
    assert fit.search.equations.signatures[claim.signature].place == CAUSE.place
    assert rate(fit, claim) < 0.05


def test_the_best_fits_of_errors_outside_the_vocabulary_have_uniform_probabilities(
    fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probability, "SEED", 77)
    monkeypatch.setattr(probability, "SAMPLE", 24)
    unknown = 30.0 * draw_errors(fit)
    monkeypatch.undo()
    design = fit.search.equations.designs[0].reshape(-1, fit.search.equations.p)

    def left(number: int, observed: np.ndarray) -> float:
        columns = design[:, fit.search.equations.columns(number)]
        return float(np.sum((observed - columns @ np.linalg.lstsq(columns, observed, rcond=1e-4)[0]) ** 2))

    best = [min(fit.search.candidates, key=lambda n, y=observed: left(n, y)) for observed in unknown.T]
    rated = np.array([rate(fit, Claim(n, 1.0), y) for n, y in zip(best, unknown.T, strict=True)])
    # of 24, 12 +- 2.4 lie below a half, 2.4 +- 1.5 below a tenth
    assert 5 <= np.sum(rated < 0.5) <= 19
    assert np.sum(rated < 0.1) <= 7


def test_explained_squares_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(1)
    both = rng.normal(size=(30, 10))
    both /= np.linalg.norm(both, axis=0)
    left = project_out(both.T @ both, np.array([0, 1]))
    blocks, errors = [np.array([2]), np.array([3, 4, 5])], np.arange(6, 10)
    explained = explain_squares(left, blocks, errors)
    for k, block in enumerate(blocks):
        together = both[:, [0, 1, *block]]
        rest = both[:, errors] - together @ np.linalg.lstsq(together, both[:, errors], rcond=None)[0]
        assert np.allclose(np.diag(left)[errors] - explained[k], np.sum(rest**2, axis=0), atol=1e-6)


def test_a_higher_spurious_fit_probability_lowers_that_of_the_claim() -> None:
    def state(spurious: float) -> float:
        return calibrate_probability(Evidence(30.0, spurious, 1.0))

    assert state(0.15) < state(0.05) < state(0.02)
    assert state(0.9) == state(0.15)
    assert state(0.001) == state(0.02)
