"""The engine of the diagnosis: evidence, gains, held-out folds, ambiguity, files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.cell.predict import predict_campaign
from compplan.diagnose import Diagnosis, diagnose_campaign
from compplan.diagnose.evidence import _negative, find_gains, find_posterior
from compplan.diagnose.held_out import make_folds
from compplan.diagnose.search import Claim
from compplan.diagnose.where import split_diagnosis
from compplan.effects import Effect
from compplan.errors import InputError
from compplan.outputs.diagnosis import write_diagnosis
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder
from tests.simulated_campaigns import measure, plan_rows, write_small_robot

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


def test_the_gap_falls_to_the_noise_floor_on_rows_never_seen(diagnosis: Diagnosis) -> None:
    assert diagnosis.gap.held_out_after < 1.1 * diagnosis.gap.noise_floor
    assert diagnosis.gap.held_out_before > 3 * diagnosis.gap.noise_floor
    assert diagnosis.gap.noise_floor == pytest.approx(np.sqrt(3) * 2e-5, rel=0.1)


def test_the_gradient_of_the_evidence_agrees_with_differences(diagnosis: Diagnosis) -> None:
    search, model = diagnosis.fit.search, diagnosis.fit.model
    prior = search.prior_of(model.claims)
    channels = [c.take(prior.active) for c in search.ledger.channels]
    hyper = replace(model.posterior.hyper, log_tau=np.full_like(model.posterior.hyper.log_tau, -1.0))
    value, gradient = _negative(channels, prior, hyper)
    for k in range(len(hyper.vector)):
        moved = hyper.vector
        moved[k] += 1e-5
        difference = (_negative(channels, prior, hyper.with_vector(moved))[0] - value) / 1e-5
        assert difference == pytest.approx(gradient[k], abs=0.5, rel=0.02)


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


def test_an_offset_lists_the_origin_that_does_the_same(diagnosis: Diagnosis) -> None:
    finding = next(f for f in diagnosis.verdict.findings if f.effect.name == "joint_offset")
    alike = {r.place[:2] for r in finding.rivals if r.alike}
    assert ("link_geometry", "joint_6") in alike


def test_the_updated_folder_predicts_a_fresh_campaign(diagnosis: Diagnosis, robot: Robot, tmp_path: Path) -> None:
    write_diagnosis(diagnosis, split_diagnosis(diagnosis), diagnosis.to_table(), tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert {e["effect"] for e in table["verdict"]["effects"]} == {"joint_stiffness", "joint_offset"}
    updated = read_robot_folder(tmp_path / "robot")
    fresh = measure(robot, plan_rows(robot, 77), [CAUSE, SECOND], 77)
    gap = np.linalg.norm(fresh.position - predict_campaign(updated, fresh).position, axis=1)
    assert np.sqrt(np.mean(gap**2)) < 1.15 * diagnosis.gap.noise_floor


def test_the_same_campaign_gives_the_same_answer(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 21, poses=20), [CAUSE], 21)
    assert diagnose_campaign(robot, campaign).to_table() == diagnose_campaign(robot, campaign).to_table()


def test_a_handful_of_rows_is_refused(robot: Robot) -> None:
    with pytest.raises(InputError, match="expected at least 12"):
        diagnose_campaign(robot, measure(robot, plan_rows(robot, 22, poses=2), [], 22))


def test_backlash_on_a_path_waits_at_reversals_and_is_named(robot: Robot) -> None:
    play = Effect("backlash", "joint_2", None, {"width_rad": 3e-4})
    campaign = measure(robot, plan_rows(robot, 23, poses=20, path=150), [play], 23)
    found = diagnose_campaign(robot, campaign).verdict.findings
    assert [f.effect.place for f in found] == [play.place]
    assert found[0].effect.parameters["width_rad"] == pytest.approx(3e-4, rel=0.05)
