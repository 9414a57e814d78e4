"""Probability of a claim: rises with its margin, falls with its likeness to the residual and with effects alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis.results.verdict import compare_sets
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.state import Fit, Problem
from compplan.diagnosis.validation.bounds import find_breach
from compplan.diagnosis.validation.probability import (
    AlternativeEffect,
    Evidence,
    calibrate_probability,
    find_alternatives,
)
from compplan.effects import Effect

CAUSE = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 3e-7})


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    robot = write_small_robot(Path(tmp_path_factory.mktemp("small")))
    campaign = measure(robot, replace(plan_rows(robot, 5, poses=16, loads=1), time=None), [CAUSE], 5, orientation=False)
    return fit_effects(Problem(robot, campaign), None)


def test_probability_rises_with_the_margin_and_falls_with_the_similarity() -> None:
    def state(margin: float, similarity: float) -> float:
        return calibrate_probability(Evidence(margin, similarity))

    assert 1.0 > state(np.inf, 0.0) > state(10.0, 0.0) > state(5.0, 0.0) > state(5.0, 0.5)
    assert state(5.0, 1.0) == state(5.0, 2.0)


def test_effects_alike_compete_if_they_differ_by_more_than_chance() -> None:
    place = ("joint_stiffness", "joint_1", None)
    assert AlternativeEffect(place, 0.99, 5.0).competes
    assert not AlternativeEffect(place, 0.99, 3.0).competes
    assert not AlternativeEffect(place, 0.5, 50.0).competes


def test_effects_alike_share_the_probability_and_others_lower_the_margin(fit: Fit) -> None:
    (claim,) = fit.model.claims
    hyper, rivals = fit.model.posterior.hyper, find_alternatives(fit, claim.signature)

    def compare(share: float, difference: float) -> tuple[float, float]:
        others = [replace(rival, share=share, difference=difference) for rival in rivals]
        return compare_sets(fit.search, [claim], hyper, claim, others)

    same, competing, others = compare(1.0, 0.0), compare(1.0, 100.0), compare(0.0, 100.0)
    assert same[1] == 1.0 == others[1] > competing[1]
    assert same[0] == competing[0] > others[0]


@pytest.mark.parametrize("name", ["frame_shift", "tool_shift"])
def test_a_shift_needs_a_few_poses_on_either_side(fit: Fit, name: str) -> None:
    rows = len(fit.problem.campaign)

    def reason(row: int) -> str:
        return find_breach(fit, Effect(name, None, None, {"row": row, "tx_m": 1e-4}), 1e-4, 1e-4)

    assert "before row 3" in reason(3) and "after row" in reason(rows - 3)
    assert not reason(rows // 2)
