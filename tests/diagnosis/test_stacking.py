"""The robot that goes out: a mixture of models, weighed by poses that none of them has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.results import delivery
from compplan.diagnosis.results.delivery import Delivery, deliver_folders
from compplan.diagnosis.results.shares import UNEXPLAINED
from compplan.diagnosis.results.small_errors import divide_small_errors
from compplan.diagnosis.results.verdict import Structure, Verdict, check_calibration
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import FitState
from compplan.diagnosis.validation.held_out import Folds, make_folds
from compplan.diagnosis.validation.options import PLAIN, Option, rate_chance, solve_option
from compplan.diagnosis.validation.stacking import (
    hold_out_stack,
    is_faithful,
    stack_options,
    stack_single,
    stack_weights,
)
from compplan.effects import Effect
from compplan.reporting.diagnosis_text import describe_small_errors
from compplan.reporting.summaries import open_diagnosis
from compplan.robot import Robot
from compplan.simulation.predict import predict_campaign

RANDOM = np.random.default_rng(7)
EVERYWHERE = [
    Effect(name, f"joint_{k}", axis, {key: float(RANDOM.normal(0.0, 1.5e-4))})
    for k in range(1, 7)
    for name, axis, key in (
        ("joint_offset", None, "offset_rad"),
        ("link_geometry", "tx", "tx_m"),
        ("link_geometry", "tz", "tz_m"),
        ("link_geometry", "rx", "rx_rad"),
    )
]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("robots") / "small")


@pytest.fixture(scope="module")
def diagnosis(robot: Robot) -> Diagnosis:
    return diagnose_campaign(robot, measure(robot, plan_rows(robot, 41, poses=24, loads=1), EVERYWHERE, 41))


def fold(diagnosis: Diagnosis) -> Folds:
    return Folds(diagnosis.fit, make_folds(diagnosis.fit.problem.campaign))


def test_models_that_err_apart_from_each_other_weigh_by_the_inverse_of_their_squares() -> None:
    apart = np.diag([1.0, 2.0, 4.0])
    assert stack_weights(apart) == pytest.approx(np.array([16.0, 4.0, 1.0]) / 21.0)
    assert stack_weights(1e-6 * apart) == pytest.approx(np.array([16.0, 4.0, 1.0]) / 21.0)


def test_a_model_that_errs_as_a_better_one_does_but_more_has_no_weight() -> None:
    better = np.random.default_rng(3).normal(size=50)
    assert stack_weights(np.array([better, 3.0 * better])) == pytest.approx([1.0, 0.0], abs=1e-9)


def test_a_mixture_of_one_model_is_that_model(diagnosis: Diagnosis) -> None:
    folds = fold(diagnosis)
    seen = np.ones(len(folds.pose), bool)
    option = Option("plain calibration", wide=True)
    blend = stack_options(folds, [option], seen)
    solved = solve_option(folds, option)
    p = diagnosis.fit.search.ledger.p
    assert blend.weights == pytest.approx([1.0])
    np.testing.assert_array_equal(blend.values(p), solved.posterior.values(p))
    fitted = blend.fitted(diagnosis.fit).model.posterior
    np.testing.assert_allclose(fitted.covariance, solved.posterior.covariance, rtol=1e-9, atol=1e-18)
    # errors are small: what is left to first order is what the exact model leaves
    exact = hold_out_stack(folds, blend)
    np.testing.assert_allclose(exact.residual, solved.residual, rtol=0, atol=5e-6)


def test_a_plain_calibration_goes_out_alone_where_the_mixture_predicts_worse(
    diagnosis: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    folds = fold(diagnosis)
    plain, fit = folds.hold_out([], background=False), diagnosis.fit
    nominal, good = FitState((), {}, None, fit.state.use), np.ones(len(fit.state.use), bool)

    def deliver() -> tuple[Delivery, ...]:
        return deliver_folders(folds, diagnosis.verdict, plain, nominal, good)

    # no mixture at all, as where derivatives promise what no exact model keeps
    monkeypatch.setattr(delivery, "stack_options", lambda *_: stack_single(folds, Option("nominal")))
    (first, *_) = deliver()
    assert first.kind == "calibrated"
    alone = hold_out_stack(folds, stack_single(folds, PLAIN))
    assert first.held.rms == pytest.approx(alone.correct_for_selection(folds.fold[plain.rows], good[plain.rows]).rms)
    assert first.held.rms < 0.3 * plain.rms


def test_the_spread_of_models_that_disagree_is_in_the_posterior_of_their_mixture(diagnosis: Diagnosis) -> None:
    folds = fold(diagnosis)
    options = [Option("nominal"), Option("plain calibration", wide=True)]
    blend = stack_options(folds, options, np.ones(len(folds.pose), bool))
    half = replace(blend, weights=np.array([0.5, 0.5]))
    plain = blend.solved[1].posterior
    fitted = half.fitted(diagnosis.fit).model.posterior
    want = 0.5 * np.diag(plain.covariance) + 0.25 * plain.mean**2
    np.testing.assert_allclose(np.diag(fitted.covariance), want, rtol=1e-9)


def test_small_errors_everywhere_go_out_though_none_of_them_is_named(diagnosis: Diagnosis, robot: Robot) -> None:
    first = diagnosis.deliveries[0]
    assert first.kind == "calibrated"
    fresh = measure(robot, plan_rows(robot, 42, poses=40, loads=1), EVERYWHERE, 42)

    def left(model: Robot) -> float:
        gap = fresh.position - predict_campaign(model, fresh).position
        return float(np.sqrt(np.mean(np.sum(gap**2, axis=1))))

    assert left(diagnosis.updated) < 0.25 * left(robot)
    assert first.held.rms == pytest.approx(left(diagnosis.updated), rel=0.35)


def test_forms_that_were_looked_for_pay_for_their_luck(diagnosis: Diagnosis) -> None:
    folds = fold(diagnosis)
    signatures = folds.fit.search.ledger.signatures
    number = next(n for n, s in enumerate(signatures) if s.name == "transmission_error" and s.tried == 1)
    looked_for = tuple(replace(s, tried=100) if n == number else s for n, s in enumerate(signatures))
    ledger = replace(folds.fit.search.ledger, signatures=looked_for)
    other = replace(folds, fit=replace(folds.fit, search=replace(folds.fit.search, ledger=ledger)))
    assert rate_chance(folds, [Claim(number, 1.0)]) == 1.0
    poses = len(np.unique(folds.pose))
    assert rate_chance(other, [Claim(number, 1.0)]) == pytest.approx(np.sqrt(1.0 + 2.0 * np.log(100.0) / (3 * poses)))


def test_the_gap_of_a_robot_that_was_not_calibrated_is_divided_by_joint_and_kind(diagnosis: Diagnosis) -> None:
    """All errors are zeros and lengths: geometry carries nearly all of it, and joints and kinds add up to the same."""
    found = divide_small_errors(diagnosis)
    assert found is not None
    assert found.by_kind["geometry"].share > 0.85
    parts = [
        sum(s.share for name, s in side.items() if name != UNEXPLAINED) for side in (found.by_place, found.by_kind)
    ]
    assert parts[0] == pytest.approx(parts[1]) and 0.9 < parts[0] <= 1.0
    assert all(s.low <= s.share <= s.high for s in found.by_kind.values())
    assert found.groups and {group.kind for group in found.groups} == {"geometry"}
    assert sum(group.share.share for group in found.groups) <= parts[0] + 1e-9


def test_what_small_errors_explain_is_called_calibrated_where_nothing_is_named() -> None:
    structure = Structure(0.0, 0.0, 1e-3, 0.0, 0.0, True, 1e-4)
    unknown = Verdict("unknown", (), (), (), structure)
    assert check_calibration(unknown, 1e-3, 0.19e-3).status == "calibrated"
    assert check_calibration(unknown, 1e-3, 0.21e-3).status == "unknown"
    # close to the noise eighty per cent are not asked for
    assert check_calibration(unknown, 0.3e-3, 0.14e-3).status == "calibrated"
    named = replace(unknown, status="partly_explained")
    assert check_calibration(named, 1e-3, 0.0).status == "partly_explained"


def test_the_page_says_what_small_errors_are_of_and_never_plans_with_a_nominal_robot(diagnosis: Diagnosis) -> None:
    found = divide_small_errors(diagnosis)
    assert found is not None
    text = describe_small_errors(found)
    assert text.startswith("Which: no single cause; small errors make the gap: geometry ")
    assert "both halves of the poses show it." in text
    unknown = {"status": "unknown", "effects": []}
    told = [open_diagnosis(unknown, {}, kind, "").next for kind in ("nominal", "calibrated")]
    assert "Plan with" not in told[0] and told[1].startswith("Plan with the updated robot")


def test_what_a_calibration_takes_up_is_not_said_to_be_explained_by_nothing() -> None:
    partly = {"status": "partly_explained", "effects": [{"effect": "backlash", "joint": "joint_2"}]}

    def told(kind: str, after: float) -> str:
        gap = {"held_out_before_rms_mm": 0.7, "held_out_after_rms_mm": after, "noise_floor_mm": 0.1}
        return open_diagnosis(partly, gap, kind, "").verdict

    assert told("calibrated", 0.12).endswith("The rest has no name, but calibration takes it up to the noise.")
    for kind, after in (("calibrated", 0.2), ("causes", 0.12)):
        assert told(kind, after).endswith("Something is left that nothing explains.")


def test_a_model_whose_exact_robot_does_not_do_what_derivatives_promise_has_no_part(diagnosis: Diagnosis) -> None:
    """A zero that is off by half a turn: first order moves the tool along a line, the robot along an arc."""
    folds = fold(diagnosis)
    ledger = folds.fit.search.ledger
    solved = solve_option(folds, Option("plain calibration", wide=True))
    assert is_faithful(folds.fit, solved)
    far = solved.posterior.mean.copy()
    far[np.searchsorted(solved.posterior.columns, ledger.columns_named("joint_offset")[1])] = 3.0 / 1e-3
    assert not is_faithful(folds.fit, replace(solved, posterior=replace(solved.posterior, mean=far)))
