"""Traps of real campaigns, not fallen into; slow where test_known_truth.py holds a smaller campaign of the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import Diagnosis, diagnose_campaign
from compplan.effects import Effect, build_model, solve_model_poses
from compplan.robot import Robot


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


def names(diagnosis: Diagnosis) -> list[str]:
    return [f.effect.name for f in diagnosis.verdict.findings]


def places(diagnosis: Diagnosis) -> list[tuple[str, str | None]]:
    return [(f.effect.name, f.effect.joint) for f in diagnosis.verdict.findings]


def test_trap_1_readings_logged_before_the_arm_stood_still_are_no_backlash(robot: Robot) -> None:
    campaign = measure(robot, plan_rows(robot, 1), [Effect("time_skew", parameters={"stale_ratio": 3e-4})], 1)
    assert names(diagnose_campaign(robot, campaign)) == ["time_skew"]


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


@pytest.mark.parametrize("moved", ["frame", "tool"])
def test_a_frame_or_a_tool_that_drifts_smoothly_is_no_shift(robot: Robot, moved: str) -> None:
    campaign = measure(robot, plan_rows(robot, 1, poses=40, loads=1), [], 1, orientation=False)
    drift = np.linspace(0.0, 1.0, len(campaign))[:, None] * np.array([2e-4, -1e-4, 1.5e-4])
    if moved == "tool":
        drift = np.einsum("nij,nj->ni", solve_model_poses(build_model(robot, campaign)).rotation, drift)
    found = diagnose_campaign(robot, replace(campaign, position=campaign.position + drift)).verdict
    assert found.status == "unknown" and not found.findings


@pytest.mark.parametrize("parts", [(), pytest.param(("base", "tool"), marks=pytest.mark.slow)])
def test_trap_4_a_coupling_convention_is_named_not_fitted(robot: Robot, parts: tuple[str, ...]) -> None:
    coupled = Effect("joint_coupling", "joint_3", None, {"other": "joint_2", "ratio": -1.0})
    diagnosis = diagnose_campaign(robot, measure(robot, plan_rows(robot, 4), [coupled], 4), register=parts)
    assert places(diagnosis) == [("joint_coupling", "joint_3")]
    assert diagnosis.gap.after < 1.2 * diagnosis.gap.noise_floor
    if not parts:
        assert "joint_coupling" in str(diagnosis) and "joint_3: probability 0.99" in str(diagnosis)


def test_trap_8_offset_and_compliance_that_explain_equally_well_are_both_said(robot: Robot) -> None:
    rows = plan_rows(robot, 8, poses=40, loads=0, region=0.05)
    campaign = measure(robot, rows, [Effect("joint_offset", "joint_3", None, {"offset_rad": 5e-4})], 8)
    finding = diagnose_campaign(robot, campaign).verdict.findings[0]
    said = {finding.effect.place[:2], *(r.place[:2] for r in finding.rivals if r.alike)}
    assert {("joint_offset", "joint_3"), ("joint_stiffness", "joint_3")} <= said


def test_diagnosis_reads_no_folder(robot: Robot, tmp_path: Path) -> None:
    campaign = measure(robot, plan_rows(robot, 13), [], 13)
    assert diagnose_campaign(replace(robot, folder=None), campaign).verdict.status == "none"
