"""Traps that real campaigns contained: each is built, and must not be fallen into.

Those of which tests/support/known_campaigns.py holds a smaller campaign (test_known_truth.py) are slow here.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.cli.commands.diagnose import describe_diagnosis
from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.diagnosis.results.accuracy import assess_diagnosis
from compplan.effects import Effect
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot
from compplan.simulation.predict import predict_campaign


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


def names(diagnosis: Diagnosis) -> list[str]:
    return [f.effect.name for f in diagnosis.verdict.findings]


def places(diagnosis: Diagnosis) -> list[tuple[str, str | None]]:
    return [(f.effect.name, f.effect.joint) for f in diagnosis.verdict.findings]


def fresh_rms(robot: Robot, effects: list[Effect], updated: Robot, **rows: float) -> float:
    fresh = measure(robot, plan_rows(robot, 99, **rows), effects, 99)  # type: ignore[arg-type]
    gap = fresh.position - predict_campaign(updated, fresh).position
    return float(np.sqrt(np.mean(np.sum(gap[~fresh.first_visit] ** 2, axis=1))))


def test_trap_1_readings_logged_before_the_arm_stood_still_are_no_backlash(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 1), [Effect("time_skew", parameters={"stale_ratio": 3e-4})], 1)
    assert names(diagnose_campaign(robot, campaign)) == ["time_skew"]


@pytest.mark.slow
def test_trap_2_a_clock_skew_between_two_encoders_is_no_backlash(robot: Robot) -> None:
    rows = plan_rows(robot, 2, poses=20, path=200)
    campaign = measure(robot, rows, [Effect("time_skew", parameters={"encoder_skew_s": 0.003})], 2, encoders=True)
    assert names(diagnose_campaign(robot, campaign)) == ["time_skew"]


@pytest.mark.slow  # known: "a jump"
def test_trap_3_a_frame_that_jumps_by_millimetres_is_a_shift_at_its_row(robot: Robot) -> None:
    rows = plan_rows(robot, 3)
    jump = {"row": 61, "tx_m": 2e-3, "ty_m": -1e-3, "tz_m": 3e-3, "rx_rad": 1e-3, "ry_rad": 0.0, "rz_rad": -1e-3}
    diagnosis = diagnose_campaign(robot, measure(robot, rows, [Effect("frame_shift", parameters=jump)], 3))
    assert names(diagnosis) == ["frame_shift"]
    assert abs(diagnosis.verdict.findings[0].effect.parameters["row"] - 61) <= 1


@pytest.mark.parametrize("name", ["tool_shift", "frame_shift"])
def test_a_target_or_frame_that_moves_twice_is_named_twice_by_its_own_name(robot: Robot, name: str) -> None:
    """The second event of a turning target once made it a shift of the frame."""
    rows = {14: (5e-4, -2e-4, 1e-4), 28: (-3e-4, 4e-4, 1e-4)}
    moves = [Effect(name, None, None, {"row": row, "tx_m": x, "ty_m": y, "tz_m": z}) for row, (x, y, z) in rows.items()]
    campaign = measure(robot, plan_rows(robot, 20, poses=40, loads=0), moves, 20, orientation=False)
    found = {f.effect.parameters["row"]: f for f in diagnose_campaign(robot, campaign).verdict.findings}
    assert {(row, f.effect.name) for row, f in found.items()} == {(14, name), (28, name)}
    for row, (x, y, _) in rows.items():
        assert found[row].effect.parameters["tx_m"] == pytest.approx(x, abs=3e-5)
        assert found[row].effect.parameters["ty_m"] == pytest.approx(y, abs=3e-5)


@pytest.mark.parametrize("parts", [(), pytest.param(("base", "tool"), marks=pytest.mark.slow)])
def test_trap_4_a_coupling_convention_is_named_not_fitted(robot: Robot, parts: tuple[str, ...]) -> None:
    coupled = Effect("joint_coupling", "joint_3", None, {"other": "joint_2", "ratio": -1.0})
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 4), [coupled], 4), register=parts)
    assert places(diagnosis) == [("joint_coupling", "joint_3")]
    assert diagnosis.gap.after < 1.2 * diagnosis.gap.noise_floor
    if not parts:
        # the folder holds the convention and no parameter: more poses would bring nothing, and that can be said
        assert diagnosis.deliveries[0].kind == "causes"
        learning = assess_diagnosis(diagnosis).learning
        assert learning is not None
        assert learning.errors == pytest.approx([learning.errors[0]] * len(learning.errors), rel=0.05)
        told = describe_diagnosis(diagnosis)
        assert "joint_coupling joint_3: probability 0.99, found before anything was fitted" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    "convention",
    [
        Effect("joint_coupling", "joint_3", None, {"other": "joint_2", "ratio": 0.5}),
        Effect("joint_coupling", "joint_2", None, {"zero_rad": 0.4}),
    ],
)
def test_trap_4_a_convention_of_any_size_is_found_with_its_size(robot: Robot, convention: Effect) -> None:
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 41), [convention], 41))
    assert places(diagnosis) == [(convention.name, convention.joint)]
    assert diagnosis.verdict.status == "explained"
    size = list(convention.parameters.values())[-1]
    assert list(diagnosis.verdict.findings[0].effect.parameters.values())[-1] == pytest.approx(size, abs=1e-4)
    assert diagnosis.gap.after < 1.2 * diagnosis.gap.noise_floor


@pytest.mark.slow  # known: "two causes and a typing error"
def test_trap_5_mistyped_points_are_reported_and_harm_nothing(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 5), [Effect("joint_offset", "joint_3", None, {"offset_rad": 4e-4})], 5)
    position = campaign.position.copy()
    position[[20, 75]] += [[0.01, 0.0, 0.0], [0.0, -0.002, 0.0]]
    diagnosis = diagnose_campaign(robot, replace(campaign, position=position))
    assert set(diagnosis.outliers) == {20, 75}
    assert places(diagnosis) == [("joint_offset", "joint_3")]


@pytest.mark.slow
def test_trap_6_a_fit_on_a_narrow_set_of_poses_harms_no_wide_campaign(robot: Robot) -> None:
    effects = [
        Effect("link_geometry", "joint_3", "tx", {"tx_m": 3e-4}),
        Effect("joint_offset", "joint_2", None, {"offset_rad": 2e-4}),
        Effect("joint_offset", "joint_4", None, {"offset_rad": -3e-4}),
    ]
    narrow = measure(robot, plan_rows(robot, 6, region=0.08), effects, 6)
    updated = diagnose_campaign(robot, narrow).updated
    assert fresh_rms(robot, effects, updated) < 1.05 * fresh_rms(robot, effects, robot)


@pytest.mark.slow
def test_trap_7_a_periodic_error_stays_small_outside_the_visited_angles(robot: Robot) -> None:
    waves = {"cycles_per_turn": [11.0, 17.0], "sine_rad": [1.5e-4, 1e-4], "cosine_rad": [1e-4, -1e-4]}
    effects = [Effect("transmission_error", "joint_1", None, waves)]
    campaign = measure(robot, plan_rows(robot, 7, poses=80, loads=0, region=0.35), effects, 7)
    diagnosis = diagnose_campaign(robot, campaign)
    assert ("transmission_error", "joint_1") in places(diagnosis)
    assert fresh_rms(robot, effects, diagnosis.updated, region=0.95) < 1e-3


def test_trap_8_offset_and_compliance_that_explain_equally_well_are_both_said(robot: Robot) -> None:
    rows = plan_rows(robot, 8, poses=40, loads=0, region=0.05)
    campaign = measure(robot, rows, [Effect("joint_offset", "joint_3", None, {"offset_rad": 5e-4})], 8)
    finding = diagnose_campaign(robot, campaign).verdict.findings[0]
    said = {finding.effect.place[:2], *(r.place[:2] for r in finding.rivals if r.alike)}
    assert {("joint_offset", "joint_3"), ("joint_stiffness", "joint_3")} <= said


@pytest.mark.slow
def test_trap_9_compliance_is_not_biased_by_a_periodic_error(robot: Robot) -> None:
    waves = {"cycles_per_turn": [3.0], "sine_rad": [4e-4], "cosine_rad": [-2e-4]}
    effects = [
        Effect("transmission_error", "joint_3", None, waves),
        Effect("joint_stiffness", "joint_3", None, {"compliance_change_rad_per_Nm": 4e-7}),
    ]
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 9), effects, 9))
    assert set(places(diagnosis)) == {("transmission_error", "joint_3"), ("joint_stiffness", "joint_3")}
    change = next(f.effect.parameters for f in diagnosis.verdict.findings if f.effect.name == "joint_stiffness")
    assert change["compliance_change_rad_per_Nm"] == pytest.approx(4e-7, rel=0.05)


def test_trap_10_two_parameters_win_over_eighteen(robot: Robot) -> None:
    waves = {"cycles_per_turn": [2.0], "sine_rad": [2e-4], "cosine_rad": [1e-4]}
    campaign = measure(robot, plan_rows(robot, 10), [Effect("transmission_error", "joint_2", None, waves)], 10)
    diagnosis = diagnose_campaign(robot, campaign)
    assert places(diagnosis) == [("transmission_error", "joint_2")]
    assert diagnosis.verdict.findings[0].effect.parameters["cycles_per_turn"] == pytest.approx([2.0], abs=0.1)


@pytest.mark.slow  # known: "nothing"
def test_nothing_is_named_where_there_is_nothing(robot: Robot) -> None:
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 11), [], 11))
    assert diagnosis.verdict.status == "none"
    for field in fields(robot):
        if field.name != "uncertainty":  # how surely it is known is all that is new
            assert np.all(getattr(diagnosis.updated, field.name) == getattr(robot, field.name)), field.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(12, marks=pytest.mark.xfail(strict=True, reason="joint_stiffness of the joint, stated 0.95")),
        pytest.param(112, marks=pytest.mark.xfail(strict=True, reason="joint_stiffness of the joint, stated 0.90")),
        212,
    ],
)
def test_the_true_effect_left_out_is_never_replaced_by_a_confident_wrong_name(robot: Robot, seed: int) -> None:
    change = Effect("link_compliance", "joint_2", "rx", {"compliance_rad_per_Nm": 1e-6})
    campaign: Campaign = measure(robot, plan_rows(robot, seed), [change], seed)
    if seed == 12:
        assert places(diagnose_campaign(robot, campaign)) == [("link_compliance", "joint_2")]
    diagnosis = diagnose_campaign(robot, campaign, without=("link_compliance",))
    assert diagnosis.verdict.status in ("unknown", "partly_explained")
    assert all(f.probability < 0.8 for f in diagnosis.verdict.findings)


def test_diagnosis_reads_no_folder(robot: Robot, tmp_path: Path) -> None:
    campaign = measure(robot, plan_rows(robot, 13), [], 13)
    assert diagnose_campaign(replace(robot, folder=None), campaign).verdict.status == "none"
