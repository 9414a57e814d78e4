"""What is named sits at its place, and no joint carries what a sensor or the warmth did; MuJoCo draws the logs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drawn_campaigns import Drawn, draw_robot_files
from effect_cases import CASES, FITTED, ROBOTS, Place

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.data.shared import SAMPLE
from compplan.diagnosis.results.shares import CALIBRATION, UNEXPLAINED, Part, PosteriorMotion
from compplan.diagnosis.results.where import Split, split_diagnosis

NOISE = 1e-5
#: Effects of sensors, warmth, tool and base, and the place that has to carry them.
NO_JOINT = {"wrench_scale": "force sensor", "thermal_drift": "links"}
NO_JOINT_EITHER = {"wrench_bias": "force sensor", "payload": "tool", "time_skew": "clock"}
#: Effects that show on paths alone; the others are measured at poses, positions alone.
IN_MOTION = ("time_skew",)
Where = Callable[[str], tuple[Diagnosis, Split]]


@pytest.fixture(scope="module")
def where(tmp_path_factory: pytest.TempPathFactory) -> Where:
    """Diagnose a campaign of MuJoCo's with one effect, and split its gap; each once."""
    robots: dict[int, Drawn] = {}
    answers: dict[str, tuple[Diagnosis, Split]] = {}

    def find(effect: str) -> tuple[Diagnosis, Split]:
        if effect not in answers:
            place = case_of(effect)
            case = CASES[place]
            description = case.base or ROBOTS[place[0]]
            if id(description) not in robots:
                robots[id(description)] = draw_robot_files(description, tmp_path_factory.mktemp("drawn"))
            drawn = robots[id(description)]
            campaign, _ = drawn.measure(case.real(drawn.nominal), noise=NOISE)
            campaign = replace(campaign, link=None, rotation=None)
            if effect not in IN_MOTION:
                campaign = campaign.take(~campaign.on_path)
            diagnosis = diagnose_campaign(drawn.robot, campaign)
            answers[effect] = diagnosis, split_diagnosis(diagnosis)
        return answers[effect]

    return find


def case_of(effect: str) -> Place:
    """Return the case of an effect that tests of sizes fit, too."""
    return next(place for place in FITTED if place[1] == effect)


def place_of(effect: str) -> str:
    """Return the joint of the fitted case of an effect."""
    return str(CASES[case_of(effect)].effect.joint)


@pytest.mark.parametrize(
    "effect", [*NO_JOINT, *(pytest.param(effect, marks=pytest.mark.slow) for effect in NO_JOINT_EITHER)]
)
def test_no_joint_carries_what_a_sensor_the_warmth_the_tool_or_the_clock_did(effect: str, where: Where) -> None:
    _, split = where(effect)
    joints = {name: share for name, share in split.by_joint.items() if name.startswith(("joint", "rail"))}
    assert len(joints) >= 6
    assert max(share.low for share in joints.values()) == 0.0
    assert max(share.share for share in joints.values()) < 0.05
    largest = max(split.by_joint, key=lambda name: split.by_joint[name].share)
    assert largest == {**NO_JOINT, **NO_JOINT_EITHER}[effect] and split.by_joint[largest].share > 0.8


@pytest.mark.parametrize(
    "effect", ["joint_stiffness", "backlash", pytest.param("joint_offset", marks=pytest.mark.slow)]
)
def test_a_joints_own_error_is_carried_by_that_joint(effect: str, where: Where) -> None:
    _, split = where(effect)
    joint = place_of(effect)
    assert split.by_joint[joint].share > 0.9
    others = [share for name, share in split.by_joint.items() if name != joint]
    assert max(share.share for share in others) < 0.05


def test_parts_divide_what_they_explain_by_what_comes_back_without_each(where: Where) -> None:
    diagnosis, _ = where("joint_stiffness")
    motion = PosteriorMotion(diagnosis, np.random.default_rng(0))
    gap, rng = motion.gap, np.random.default_rng(1)
    moved = [1.5 * gap + 1e-5 * rng.normal(size=len(gap)), -0.7 * gap, 1e-5 * rng.normal(size=len(gap)) + 0.1 * gap]
    parts = [Part(str(k), "", "", 1.0, m, np.zeros(0, int)) for k, m in enumerate(moved)]
    shares, drawn = motion.divide(parts)
    left = gap - sum(moved)
    back = [np.sum((left + m) ** 2) - np.sum(left**2) for m in moved]
    assert min(back) > 0.0
    by_hand = np.array(back) / np.sum(back) * (1.0 - np.sum(left**2) / np.sum(gap**2))
    assert shares == pytest.approx(by_hand, abs=1e-12)
    assert shares[0] > shares[1] > 0.1
    assert all(values.shape == (SAMPLE,) and values.min() <= share <= values.max()
               for values, share in zip(drawn, shares, strict=True))  # fmt: skip


def test_a_finding_that_may_be_absent_has_an_interval_from_zero(where: Where) -> None:
    diagnosis, _ = where("joint_stiffness")
    (finding,) = diagnosis.verdict.findings

    def low(probability: float) -> float:
        findings = (replace(finding, probability=probability),)
        stated = replace(diagnosis, verdict=replace(diagnosis.verdict, findings=findings))
        return split_diagnosis(stated).by_joint[place_of("joint_stiffness")].low

    assert low(0.6) == 0.0 < 0.8 < low(0.99)


def test_places_noise_and_what_is_not_explained_add_up_and_are_plain_json(where: Where) -> None:
    diagnosis, split = where("thermal_drift")
    assert sum(s.share for s in split.by_joint.values()) + split.shares.noise == pytest.approx(1.0, abs=1e-6)
    assert sum(s.share for s in split.shares.by_factor.values()) + split.shares.noise == pytest.approx(1.0, abs=1e-6)
    spread = split.spread
    assert 0.5 < sum(entry["share"] for entry in spread["by_region"]) <= 1.001
    assert sum(entry["share"] for entry in spread["by_run"].values()) == pytest.approx(1.0, abs=1e-3)
    assert sum(spread["by_axis"][axis]["share"] for axis in "xyz") == pytest.approx(1.0, abs=1e-3)
    assert spread["rms_mm"] == pytest.approx(1e3 * diagnosis.gap.before, rel=1e-9)
    written = json.loads(json.dumps(split.to_json(), allow_nan=False))
    assert set(written["by_joint"]) >= {*diagnosis.robot.joint_names, CALIBRATION, UNEXPLAINED}
    assert all(0 <= share["low"] <= share["share"] <= share["high"] <= 1 for share in written["by_joint"].values())
    assert split.to_json() == split_diagnosis(diagnosis).to_json()
