"""Causes that no effect of the vocabulary makes: they are not forced onto effects, and what they follow is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.evidence.unmodelled import describe_unmodelled, past_load
from compplan.diagnosis.results.delivery import of_instrument
from compplan.effects import Effect, robot_effects
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


def drivers(diagnosis: Diagnosis) -> list[str | None]:
    return [f.effect.axis for f in diagnosis.verdict.structure.dependences]


def names(diagnosis: Diagnosis) -> list[str]:
    return [f.effect.name for f in diagnosis.verdict.findings]


def scale_instrument(campaign: Campaign, share: float) -> Campaign:
    """Let the distances from an instrument that stands two metres away be a share too long."""
    return replace(campaign, position=campaign.position + share * (campaign.position - np.array([2.0, 1.0, 1.5])))


@pytest.mark.slow
def test_an_instrument_with_a_wrong_scale_is_unknown_and_follows_the_place(robot: Robot) -> None:
    campaign = scale_instrument(measure(robot, plan_rows(robot, 31), [], 31), 3e-4)
    diagnosis = diagnose_campaign(robot, campaign)
    assert diagnosis.verdict.status == "unknown"
    assert drivers(diagnosis) == ["the place of the target"]
    assert names(diagnosis) == []
    # small errors everywhere may be delivered where they predict better; what is no part of the robot never is
    assert not any(of_instrument(effect) for effect in robot_effects(diagnosis.updated))


@pytest.mark.slow  # test_known_truth.py asks the same of three joints
def test_an_effect_beside_an_unknown_cause_keeps_its_name(robot: Robot) -> None:
    soft = Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 9e-7})
    campaign = scale_instrument(measure(robot, plan_rows(robot, 32), [soft], 32), 3e-4)
    diagnosis = diagnose_campaign(robot, campaign)
    assert diagnosis.verdict.status == "partly_explained"
    assert names(diagnosis) == ["joint_stiffness"]
    change = diagnosis.verdict.findings[0].effect.parameters["compliance_change_rad_per_Nm"]
    assert change == pytest.approx(9e-7, rel=0.1)


@pytest.mark.slow
def test_what_an_unknown_cause_follows_stands_in_the_report(robot: Robot, tmp_path: Path) -> None:
    campaign = scale_instrument(measure(robot, plan_rows(robot, 33), [], 33), 3e-4)
    table = diagnose_campaign(robot, campaign).to_table()["structure_left"]
    assert table["present"] is True
    assert [entry["driver"] for entry in table["depends_on"]] == ["the place of the target"]
    assert table["depends_on"][0]["rms_mm"] > 0.1


def test_a_sound_robot_shows_no_dependence(robot: Robot) -> None:
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 34), [], 34))
    assert diagnosis.verdict.status == "none"
    assert diagnosis.verdict.structure.dependences == ()


def test_a_dependence_is_said_in_words() -> None:
    assert describe_unmodelled(None, "time") == "an error that follows time"
    assert describe_unmodelled("joint_2", "time") == "an error of joint_2 that follows time"


def test_the_load_of_the_past_fades_with_its_time_constant() -> None:
    load = np.array([0.0, 1.0, 1.0])
    past = past_load(np.array([0.0, 0.0, 60.0]), load, 60.0)
    np.testing.assert_allclose(past, [0.0, 0.0, 1.0 - np.exp(-1.0)])
