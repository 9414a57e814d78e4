"""The engine of the diagnosis: evidence, gains, held-out folds, ambiguity, files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.results.assessment import assess_diagnosis
from compplan.diagnosis.results.delivery import deliverable_claims
from compplan.diagnosis.results.verdict import reach_verdict
from compplan.diagnosis.results.where import split_diagnosis
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.state import Problem, attain_state
from compplan.diagnosis.validation import bounds
from compplan.diagnosis.validation.held_out import Folds, free_of_frames, make_folds
from compplan.effects import EFFECTS, Effect
from compplan.errors import InputError
from compplan.measurement.registration import Registration
from compplan.reporting.diagnosis import write_diagnosis
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
    verdict = reach_verdict(diagnosis.fit, diagnosis.revised)
    assert [f.effect.place for f in verdict.findings] == [SECOND.place]
    (soft,) = (f for f in verdict.doubtful if f.effect.place == CAUSE.place)
    assert soft.signature not in {claim.signature for claim in deliverable_claims(diagnosis.fit, verdict)}
    assert soft.beyond.startswith("joint_3 would bend by")
    assert ("not named", f"joint_stiffness: {soft.beyond}") in replace(diagnosis, verdict=verdict).summary()


def test_the_gap_falls_to_the_noise_floor_on_rows_never_seen(diagnosis: Diagnosis) -> None:
    assert diagnosis.gap.held_out_after < 1.1 * diagnosis.gap.noise_floor
    assert diagnosis.gap.held_out_before > 3 * diagnosis.gap.noise_floor
    assert diagnosis.gap.noise_floor == pytest.approx(np.sqrt(3) * 2e-5, rel=0.1)


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


def test_no_fold_holds_all_of_a_short_path(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 3), [], 3)
    for rows in (12, 40, len(campaign)):
        path = campaign.take(np.arange(rows))
        path = replace(path, run=np.array(["path_1"] * rows))
        fold = make_folds(path)
        assert np.bincount(fold).max() < rows and fold.min() == 0


def test_the_updated_folder_predicts_a_fresh_campaign(diagnosis: Diagnosis, robot: Robot, tmp_path: Path) -> None:
    write_diagnosis(diagnosis, split_diagnosis(diagnosis), assess_diagnosis(diagnosis), diagnosis.to_table(), tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert {e["effect"] for e in table["verdict"]["effects"]} == {"joint_stiffness", "joint_offset"}
    updated = read_robot_folder(tmp_path / "robot")
    assert (tmp_path / "robot" / "controller.urdf").read_text() == robot.urdf  # no controller knows the offset
    fresh = measure(robot, plan_rows(robot, 77), [CAUSE, SECOND], 77)
    gap = np.linalg.norm(fresh.position - predict_campaign(updated, fresh).position, axis=1)
    assert np.sqrt(np.mean(gap**2)) < 1.15 * diagnosis.gap.noise_floor


def test_every_figure_belongs_to_the_folder_that_is_written(diagnosis: Diagnosis, tmp_path: Path) -> None:
    table = {**diagnosis.to_table(), **assess_diagnosis(diagnosis).to_json()}
    write_diagnosis(diagnosis, split_diagnosis(diagnosis), assess_diagnosis(diagnosis), table, tmp_path)
    campaign = diagnosis.fit.problem.campaign
    good = np.setdiff1d(np.flatnonzero(campaign.usable), diagnosis.outliers)
    first, folder = diagnosis.delivery, read_robot_folder(tmp_path / "robot")
    gap = campaign.position - predict_campaign(folder, campaign, later=False).position
    np.testing.assert_allclose(gap[good], first.residual[good], rtol=0, atol=2e-8)
    after = float(np.sqrt(np.mean(np.sum(first.residual[good] ** 2, axis=1))))
    assert table["gap"]["after_rms_mm"] == pytest.approx(1e3 * after, abs=1e-5)
    assert table["gap"]["held_out_after_rms_mm"] == pytest.approx(1e3 * first.held.rms, rel=0.02)
    assert table["accuracy"]["after"]["rms_mm"] < 1.1 * table["gap"]["held_out_after_rms_mm"]


def test_frames_are_fitted_to_the_campaign_around_a_robot_that_never_saw_the_rows(robot: Robot) -> None:
    """No frame takes more of what is left; six of 48 values of 16 points go to the base, three to the target."""
    campaign = measure(robot, plan_rows(robot, 23, poses=16), [SECOND], 23)
    problem = Problem(robot, campaign, ("base", "tool"))
    fit = fit_effects(replace(problem, without=tuple(EFFECTS)), Registration.identity(campaign))
    held = Folds(fit, make_folds(campaign)).hold_out(lambda number: fit.state)
    nominal = predict_campaign(robot, campaign, register=("base", "tool"))
    registered = (campaign.position - nominal.position)[held.rows]
    place = campaign.position[held.rows]
    assert held.residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    assert np.cross(place, held.residual).mean(axis=0) == pytest.approx(np.zeros(3), abs=2e-6)
    least = np.sqrt(48 / 39 * np.mean(np.sum(registered**2, axis=1)))
    assert 1.0 < held.rms / least < 1.4
    assert free_of_frames(fit, 2) == pytest.approx(np.sqrt(2.0))
    assert free_of_frames(replace(fit, problem=replace(problem, register=())), 16) == 1.0


def test_names_of_many_poses_are_searched_on_some_and_calibrated_on_all(robot: Robot) -> None:
    """Of 900 poses, one in 2.25; a pose that is searched has all its visits, and the first and the last are near."""
    campaign = measure(robot, plan_rows(robot, 24, poses=900), [CAUSE, SECOND], 24)
    searched = Problem(robot, campaign).searched
    assert len(np.unique(campaign.pose[searched])) == 400
    assert set(campaign.pose[searched]).isdisjoint(campaign.pose[~searched])
    rows = np.flatnonzero(searched)
    assert max(rows[0], len(campaign) - rows[-1], np.diff(rows).max()) < 0.02 * len(campaign)
    found = diagnose_campaign(robot, campaign)
    assert {f.effect.place for f in found.verdict.findings} == {CAUSE.place, SECOND.place}
    assert len(found.fit.search.equations.source[0].rows) == len(rows)
    assert len(found.equations.source[0].rows) == len(campaign)


@pytest.mark.slow
def test_the_same_campaign_gives_the_same_answer(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 21, poses=20), [CAUSE], 21)
    assert diagnose_campaign(robot, campaign).to_table() == diagnose_campaign(robot, campaign).to_table()


def test_a_handful_of_rows_is_refused(robot: Robot) -> None:
    with pytest.raises(InputError, match="expected at least 12"):
        diagnose_campaign(robot, measure(robot, plan_rows(robot, 22, poses=2), [], 22))
