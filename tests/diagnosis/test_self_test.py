"""The self-test: effects of known size in a campaign's own poses and noise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import SIGMA, measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.self_test import FOUND, TIED, SelfTest, run_self_test
from compplan.effects import Effect
from compplan.reporting.diagnosis import deliver_diagnosis
from compplan.reporting.diagnosis_text import describe_self_test

SOFT = Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": 3e-7})


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    robot = write_small_robot(tmp_path_factory.mktemp("small"), joints=3)
    return diagnose_campaign(
        robot, measure(robot, plan_rows(robot, 3, poses=20, loads=1), [SOFT], 3, orientation=False)
    )


@pytest.fixture(scope="module")
def tested(diagnosis: Diagnosis) -> SelfTest:
    return run_self_test(diagnosis, 3)


def test_large_planted_effects_are_found_or_tied_and_the_page_says_so(
    diagnosis: Diagnosis, tested: SelfTest, tmp_path: Path
) -> None:
    assert len({one.effect.name for one in tested.planted}) == len(tested.planted) == tested.asked
    large = [one for one in tested.planted if one.moved > 10.0 * SIGMA]
    assert large and all(one.outcome in (FOUND, TIED) for one in large)
    table = deliver_diagnosis(diagnosis, tmp_path / "out", tested=tested)
    assert json.loads((tmp_path / "out/diagnosis.json").read_text())["self_test"] == table["self_test"]
    text = describe_self_test(table["self_test"])
    assert text[0].startswith("self-test, 3 of 3 effects") and text[-1].startswith("  right: ")
    assert "Self-test" in (tmp_path / "out/report.html").read_text()


def test_an_interrupted_self_test_keeps_what_was_done_and_the_seed_repeats_it(
    diagnosis: Diagnosis, tested: SelfTest
) -> None:
    def stop(done: int, left: float) -> None:
        assert np.isnan(left) == (done == 0)
        if done:
            raise KeyboardInterrupt

    (one,) = run_self_test(diagnosis, 3, progress=stop).planted
    assert one.to_json() == tested.planted[0].to_json()
    assert describe_self_test(replace(tested, planted=()).to_json()) == [
        "self-test: ended before the first diagnosis was done"
    ]
