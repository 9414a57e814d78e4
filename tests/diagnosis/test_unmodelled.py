"""Causes that no effect of the vocabulary makes: they are not forced onto effects, and what they follow is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.validation.unmodelled import describe_unmodelled, past_load
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
