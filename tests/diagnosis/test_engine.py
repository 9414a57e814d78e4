"""The engine of the diagnosis: evidence, gains, held-out folds, ambiguity, files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.evidence.evidence import _choose_solver, _loose, _value_and_slope, find_posterior
from compplan.diagnosis.evidence.evidence_gain import find_gains
from compplan.diagnosis.results.accuracy import _summarise, assess_diagnosis, draw_learning, list_worst
from compplan.diagnosis.results.calibration import list_corrections
from compplan.diagnosis.results.delivery import possible_claims, settle_play
from compplan.diagnosis.results.verdict import reach_verdict
from compplan.diagnosis.results.where import split_diagnosis
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import FitState, Problem, attain_state
from compplan.diagnosis.validation import bounds
from compplan.diagnosis.validation.held_out import Folds, HeldOut, free_of_frames, make_folds
from compplan.diagnosis.validation.options import rate_chance
from compplan.effects import EFFECTS, Effect
from compplan.errors import InputError
from compplan.measurement.registration import Registration
from compplan.reporting.writers.diagnosis import write_diagnosis
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder
from compplan.simulation.predict import predict_campaign

CAUSE = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 3e-7})
SECOND = Effect("joint_offset", "joint_5", None, {"offset_rad": 6e-4})


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def diagnosis(robot: Robot) -> Diagnosis:
    return diagnose_campaign(robot, measure(robot, plan_rows(robot, 20), [CAUSE, SECOND], 20))


def test_both_of_two_effects_are_named_with_their_sizes(diagnosis: Diagnosis) -> None:
    found = {f.effect.place: f.effect.parameters for f in diagnosis.verdict.findings}
    assert set(found) == {CAUSE.place, SECOND.place}
    assert found[CAUSE.place]["compliance_change_rad_per_Nm"] == pytest.approx(3e-7, rel=0.03)
    assert found[SECOND.place]["offset_rad"] == pytest.approx(6e-4, rel=0.03)
    assert diagnosis.verdict.status == "explained"


def test_what_no_robot_can_have_is_not_named_goes_into_no_folder_and_the_reason_is_said(
    diagnosis: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a bound of a thousandth the softer joint is beyond it."""
    monkeypatch.setattr(bounds, "MOST_BENT", 0.001 * bounds.MOST_BENT)
    verdict = reach_verdict(diagnosis.fit, diagnosis.doubt)
    assert [f.effect.place for f in verdict.findings] == [SECOND.place]
    (soft,) = (f for f in verdict.doubtful if f.effect.place == CAUSE.place)
    assert soft.signature not in {claim.signature for claim in possible_claims(verdict)}
    assert soft.beyond.startswith("joint_3 would bend by")
    assert ("not named", f"joint_stiffness: {soft.beyond}") in replace(diagnosis, verdict=verdict).summary()


def test_the_poses_predicted_worst_are_told_with_joints_in_degrees(diagnosis: Diagnosis) -> None:
    worst = list_worst(diagnosis)
    assert list(worst) == sorted(worst, key=lambda pose: -pose.distance)
    campaign = diagnosis.fit.problem.campaign
    assert all(np.radians(pose.joints) == pytest.approx(campaign.q[pose.row]) for pose in worst)


def test_the_gap_falls_to_the_noise_floor_on_rows_never_seen(diagnosis: Diagnosis) -> None:
    assert diagnosis.gap.held_out_after < 1.1 * diagnosis.gap.noise_floor
    assert diagnosis.gap.held_out_before > 3 * diagnosis.gap.noise_floor
    assert diagnosis.gap.noise_floor == pytest.approx(np.sqrt(3) * 2e-5, rel=0.1)


def test_the_gradient_of_the_evidence_agrees_with_differences(diagnosis: Diagnosis) -> None:
    search, model = diagnosis.fit.search, diagnosis.fit.model
    prior = search.prior_of(model.claims)
    solver, channels = _choose_solver(search.ledger, prior), search.ledger.channels
    hyper = replace(model.posterior.hyper, log_tau=np.full_like(model.posterior.hyper.log_tau, -1.0))
    loose = _loose(prior, hyper)
    here, gradient, _ = _value_and_slope(solver, channels, hyper, loose)
    for k in range(len(hyper.vector)):
        moved = hyper.vector
        moved[k] += 1e-5
        ahead, _, _ = _value_and_slope(solver, channels, hyper.with_vector(moved), loose)
        difference = (ahead - here) / 1e-5
        assert difference == pytest.approx(gradient[k], abs=0.5, rel=0.02)


def test_a_state_is_solved_once_and_seen_through_other_frames_as_if_solved_anew(diagnosis: Diagnosis) -> None:
    problem, state = diagnosis.fit.problem, diagnosis.fit.state
    attained = attain_state(problem, state)[1]
    assert attain_state(problem, state)[1] is attained
    base, tool = np.eye(4), np.eye(4)[None].copy()
    base[:3, :3], base[:3, 3], tool[0, :3, 3] = Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix(), 0.4, (0.0, 0.1, 0.2)
    moved = replace(state, registration=Registration(base, tool))
    again, afresh = attain_state(problem, moved)[1], attain_state(replace(problem), moved)[1]
    assert again.frames is attained.frames
    assert afresh.frames is not attained.frames
    for seen, solved in zip(again[:4], afresh[:4], strict=True):
        assert seen == pytest.approx(solved, abs=0.0)
    assert again.target == pytest.approx(afresh.target, abs=0.0)
    assert np.abs(again.position - attained.position).max() > 0.1


def test_a_prediction_that_is_better_by_luck_is_told_from_one_that_is_better_everywhere() -> None:
    rows, pose = np.arange(40), np.repeat(np.arange(10), 4)
    nominal = HeldOut(rows, np.full((40, 3), 1e-3))
    everywhere = HeldOut(rows, np.full((40, 3), 0.9e-3) * np.where(pose % 2, 0.99, 1.0)[:, None])
    at_one = HeldOut(rows, np.full((40, 3), 1e-3) * np.where(pose == 3, 0.1, 1.0)[:, None])
    # one pose of ten decides the sign; all ten have to keep theirs, which is one choice of signs in 1024
    assert at_one.selection_bonus(nominal, pose) == pytest.approx(0.5)
    assert everywhere.selection_bonus(nominal, pose) == pytest.approx(2.0**-10)
    assert nominal.selection_bonus(everywhere, pose) == 1.0
    assert nominal.selection_bonus(nominal, pose) == 1.0


def test_a_stated_error_is_too_small_by_a_quarter_in_one_case_of_twenty_at_most() -> None:
    """Five folds whose logarithms scatter about the true one by themselves, and together as the fits they share do."""
    random, fold, seen = np.random.default_rng(7), np.repeat(np.arange(5), 2), np.ones(10, bool)
    low, plain = 0, 0
    for _ in range(2000):
        logs = random.normal(0.0, 0.6, 5) + random.normal(0.0, 0.6 * np.sqrt(0.25))
        shown = HeldOut(np.arange(10), np.sqrt(np.exp(logs) / 3.0)[fold][:, None] * np.ones(3))
        low += shown.correct_for_selection(fold, seen).rms < 0.8
        plain += shown.rms < 0.8
    assert low < 0.05 * 2000 < plain
    alike = HeldOut(np.arange(10), np.full((10, 3), 1e-3))
    assert alike.correct_for_selection(fold, seen).rms == pytest.approx(alike.rms)
    # by hand: t of one degree of freedom is 6.314; logs of 1 and 4 have the deviation log(4) / sqrt(2)
    two = HeldOut(np.arange(2), np.array([1.0, 2.0])[:, None] * np.ones(3))
    above = 6.3138 * np.log(4.0) / np.sqrt(2.0) * np.sqrt(1.5)
    said = two.correct_for_selection(np.arange(2), np.ones(2, bool))
    assert said.rms == pytest.approx(0.8 * np.exp(0.5 * above) * two.rms, rel=1e-3)


def test_the_choice_of_a_model_is_judged_on_the_fold_that_did_not_choose() -> None:
    """Of two models each is the better one on a fold of its own: chosen by the other fold, it is the worse one here."""
    rows, fold, seen = np.arange(4), np.array([0, 0, 1, 1]), np.ones(4, bool)
    first = HeldOut(rows, np.array([1.0, 1.0, 3.0, 3.0])[:, None] * np.ones(3))
    second = HeldOut(rows, np.array([3.0, 3.0, 2.0, 2.0])[:, None] * np.ones(3))
    assert first.nest_choice([first, second], fold, seen).residual[:, 0] == pytest.approx([3.0, 3.0, 3.0, 3.0])
    assert first.nest_choice([first], fold, seen).rms == first.rms


def test_poses_that_are_predicted_better_by_very_different_amounts_are_not_luck() -> None:
    """Seven poses, all better: their standard error is large since one gains most, and all signs are the same."""
    rows = np.arange(7)
    nominal = HeldOut(rows, np.array([0.1, 0.1, 0.2, 0.2, 0.3, 0.5, 2.0])[:, None] * np.ones(3))
    better = HeldOut(rows, 0.5 * nominal.residual)
    assert better.selection_bonus(nominal, rows) == pytest.approx(2.0**-7)


def test_the_luck_of_many_poses_is_that_of_all_their_signs() -> None:
    """By hand: of 16 signs of 4, 3, 2 and -1 two sum to 8 or more. Forty gains against signs that are drawn."""

    def held(square: np.ndarray) -> HeldOut:
        return HeldOut(np.arange(len(square)), np.sqrt(square / 3.0)[:, None] * np.ones(3))

    gain = np.array([4.0, 3.0, 2.0, -1.0])
    assert held(5.0 - gain).selection_bonus(held(np.full(4, 5.0)), np.arange(4)) == pytest.approx(2 / 16)
    many = np.random.default_rng(5).normal(0.3, 1.0, 40)
    luck = held(5.0 - many).selection_bonus(held(np.full(40, 5.0)), np.arange(40))
    signs = np.random.default_rng(6).choice([-1.0, 1.0], (40000, 40))
    assert luck == pytest.approx(np.mean(signs @ many >= many.sum()), abs=0.006)


def test_a_gain_is_the_evidence_that_the_claim_then_adds(diagnosis: Diagnosis) -> None:
    search = diagnosis.fit.search
    empty = find_posterior(search.ledger, search.prior_of([]), search.start, fit=False)
    number = next(n for n, s in enumerate(search.ledger.signatures) if s.name == "wrench_scale")
    gain = find_gains(search.ledger, empty, [number])[0]
    values = []
    for size in (0.1, 0.3, 1.0, 3.0, 10.0, 40.0):
        claimed = search.prior_of([Claim(number, size)])
        values.append(find_posterior(search.ledger, claimed, search.start, fit=False).log_evidence - empty.log_evidence)
    top = max(values)
    assert gain.log_evidence == pytest.approx(top + np.log(np.mean(np.exp(np.array(values) - top))), abs=1e-3)


def test_the_same_pose_is_never_in_two_folds(robot: Robot) -> None:
    campaign = plan_rows(robot, 3, poses=30)
    folds = make_folds(campaign)
    for pose in np.unique(campaign.pose):
        assert len(np.unique(folds[campaign.pose == pose])) == 1


def test_no_fold_holds_all_of_a_short_path(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 3), [], 3)
    for rows in (12, 40, len(campaign)):
        path = campaign.take(np.arange(rows))
        path = replace(path, run=np.array(["path_1"] * rows))
        fold = make_folds(path)
        assert np.bincount(fold).max() < rows and fold.min() == 0


def test_an_offset_lists_the_origin_that_does_the_same(diagnosis: Diagnosis) -> None:
    finding = next(f for f in diagnosis.verdict.findings if f.effect.name == "joint_offset")
    alike = {r.place[:2] for r in finding.rivals if r.alike}
    assert ("link_geometry", "joint_6") in alike


def test_the_updated_folder_predicts_a_fresh_campaign(diagnosis: Diagnosis, robot: Robot, tmp_path: Path) -> None:
    write_diagnosis(diagnosis, split_diagnosis(diagnosis), assess_diagnosis(diagnosis), diagnosis.to_table(), tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert {e["effect"] for e in table["verdict"]["effects"]} == {"joint_stiffness", "joint_offset"}
    updated = read_robot_folder(tmp_path / "robot")
    assert (tmp_path / "robot" / "controller.urdf").read_text() == robot.urdf  # no controller knows the offset
    fresh = measure(robot, plan_rows(robot, 77), [CAUSE, SECOND], 77)
    gap = np.linalg.norm(fresh.position - predict_campaign(updated, fresh).position, axis=1)
    assert np.sqrt(np.mean(gap**2)) < 1.15 * diagnosis.gap.noise_floor


@pytest.mark.parametrize("start", [-0.5, 0.5])
def test_a_joint_begins_on_that_side_of_its_play_on_which_the_first_rows_stand(robot: Robot, start: float) -> None:
    play = Effect("backlash", "joint_2", None, {"width_rad": 4e-4})
    true = replace(play, parameters={**play.parameters, "start_ratio": start})
    campaign = measure(robot, plan_rows(robot, 8, poses=6), [SECOND, true], 8)
    state = FitState((SECOND, play), {}, None, campaign.usable)
    assert settle_play(Problem(robot, campaign), state).effects == (SECOND, true)


def test_every_figure_belongs_to_the_folder_that_is_written(diagnosis: Diagnosis, tmp_path: Path) -> None:
    table = {**diagnosis.to_table(), **assess_diagnosis(diagnosis).to_json()}
    write_diagnosis(diagnosis, split_diagnosis(diagnosis), assess_diagnosis(diagnosis), table, tmp_path)
    campaign = diagnosis.fit.problem.campaign
    good = np.setdiff1d(np.flatnonzero(campaign.usable), diagnosis.outliers)
    assert [d["folder"] for d in table["delivered"]] == sorted(p.name for p in tmp_path.glob("robot*"))
    for delivery, entry in zip(diagnosis.deliveries, table["delivered"], strict=True):
        folder = read_robot_folder(tmp_path / entry["folder"])
        gap = campaign.position - predict_campaign(folder, campaign, later=False).position
        np.testing.assert_allclose(gap[good], delivery.residual[good], rtol=0, atol=2e-8)
    first = diagnosis.deliveries[0]
    after = float(np.sqrt(np.mean(np.sum(first.residual[good] ** 2, axis=1))))
    assert table["gap"]["after_rms_mm"] == pytest.approx(1e3 * after, abs=1e-5)
    assert table["gap"]["held_out_after_rms_mm"] == pytest.approx(1e3 * first.held.rms, rel=0.02)
    assert table["accuracy"]["after"]["rms_mm"] < 1.1 * table["gap"]["held_out_after_rms_mm"]


def test_frames_are_fitted_to_the_campaign_around_a_robot_that_never_saw_the_rows(robot: Robot) -> None:
    """No frame takes anything more of what is left; each row was predicted by frames that other rows were fitted to.

    The frames take nine of the 48 values of sixteen points, six for the base and three for where the target sits.
    """
    campaign = measure(robot, plan_rows(robot, 23, poses=16), [SECOND], 23)
    problem = Problem(robot, campaign, ("base", "tool"))
    fit = fit_effects(replace(problem, without=tuple(EFFECTS)), Registration.identity(campaign))
    held = Folds(fit, make_folds(campaign)).hold_out([], background=False)
    nominal = predict_campaign(robot, campaign, register=("base", "tool"))
    registered = (campaign.position - nominal.position)[held.rows]
    place = campaign.position[held.rows]
    assert held.residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    assert np.cross(place, held.residual).mean(axis=0) == pytest.approx(np.zeros(3), abs=2e-6)
    least = np.sqrt(48 / 39 * np.mean(np.sum(registered**2, axis=1)))
    assert 1.0 < held.rms / least < 1.4
    assert free_of_frames(fit, 2) == pytest.approx(np.sqrt(2.0))
    assert free_of_frames(replace(fit, problem=replace(problem, register=())), 16) == 1.0


def test_long_campaigns_are_dealt_in_longer_runs(robot: Robot) -> None:
    campaign = plan_rows(robot, 3, poses=120, loads=0)
    for poses, run in ((30, 3), (120, 6)):
        fold = make_folds(campaign.take(np.arange(poses)))
        assert int(np.flatnonzero(np.diff(fold))[0]) + 1 == run


def test_a_zero_to_enter_has_an_interval_that_holds_the_truth(diagnosis: Diagnosis) -> None:
    zeros = {c.joint: c for c in list_corrections(diagnosis) if c.effect == "joint_offset"}
    truth = np.rad2deg(6e-4)
    assert zeros["joint_5"].named and zeros["joint_5"].unit == "deg"
    assert zeros["joint_5"].low < truth < zeros["joint_5"].high
    assert zeros["joint_5"].high - zeros["joint_5"].low < 0.2 * truth
    others = [c for joint, c in zeros.items() if joint != "joint_5"]
    assert not any(c.named or c.plain for c in others)


def test_pose_accuracy_is_mean_largest_and_three_sigma_of_the_distances() -> None:
    """By hand: 1, 2, 3 mm have mean 2 and standard deviation 1."""
    found = _summarise(np.array([1e-3, 2e-3, 3e-3]))
    assert found.to_json() == {"poses": 3, "mean_mm": 2.0, "max_mm": 3.0, "mean_and_3_sigma_mm": 5.0,
                               "rms_mm": pytest.approx(2.16025)}  # fmt: skip


def test_a_learning_curve_falls_to_the_noise_and_no_farther(diagnosis: Diagnosis) -> None:
    learning = draw_learning(diagnosis)
    assert learning is not None
    more = learning.to_json()["expected_with_10_more_mm"]
    assert 1e-3 * more <= learning.at(learning.now) + 1e-8
    assert learning.floor == pytest.approx(diagnosis.gap.noise_floor, rel=0.1)


@pytest.mark.slow
def test_the_same_campaign_gives_the_same_answer(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 21, poses=20), [CAUSE], 21)
    assert diagnose_campaign(robot, campaign).to_table() == diagnose_campaign(robot, campaign).to_table()


def test_a_handful_of_rows_is_refused(robot: Robot) -> None:
    with pytest.raises(InputError, match="expected at least 12"):
        diagnose_campaign(robot, measure(robot, plan_rows(robot, 22, poses=2), [], 22))


@pytest.mark.slow
def test_backlash_on_a_path_waits_at_reversals_and_is_named(robot: Robot) -> None:
    play = Effect("backlash", "joint_2", None, {"width_rad": 3e-4})
    campaign = measure(robot, plan_rows(robot, 23, poses=20, path=150), [play], 23)
    found = diagnose_campaign(robot, campaign).verdict.findings
    assert [f.effect.place for f in found] == [play.place]
    assert found[0].effect.parameters["width_rad"] == pytest.approx(3e-4, rel=0.05)


def test_a_form_picked_from_more_alternatives_than_fit_a_word_of_memory_counts_their_chance() -> None:
    source = [SimpleNamespace(told=np.full(100, 3.0))]
    ledger = SimpleNamespace(signatures=[SimpleNamespace(tried=10**40)], source=source)
    folds = SimpleNamespace(fit=SimpleNamespace(search=SimpleNamespace(ledger=ledger)), pose=np.arange(100))
    chance = rate_chance(folds, [Claim(0, 1.0)])  # type: ignore[arg-type]
    assert chance == pytest.approx(np.sqrt(1.0 + 2.0 * 40.0 * np.log(10.0) / 300))
