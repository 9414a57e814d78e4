"""Causes that no effect of the vocabulary makes: they are not forced onto effects, and what they follow is said."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import diagnose_campaign
from compplan.diagnosis.validation.unmodelled import describe_unmodelled, past_load
from compplan.robot import Robot


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


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
