"""Prediction: robot folders with effects, registrations, modes of double encoders, and files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.cli import load_command
from compplan.effects import EFFECTS, Effect, fold_effects, robot_effects
from compplan.measurement.frames import fit_registration
from compplan.measurement.registration import Registration, read_registration, write_registration
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder, write_robot_folder
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.simulation.predict import predict_campaign

EXAMPLES = [
    Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": 2e-7}),
    Effect("link_compliance", "joint_3", "rx", {"compliance_rad_per_Nm": 3e-7}),
    Effect("base_compliance", None, "ry", {"compliance_rad_per_Nm": 1e-7}),
    Effect("payload", None, None, {"mass_kg": 15.0, "first_moment_kg_m": [1.0, 0.0, 2.0]}),
    Effect("joint_offset", "joint_4", None, {"offset_rad": 1e-3}),
    Effect("link_geometry", "joint_3", "tx", {"tx_m": 5e-4}),
    Effect("tool_frame", None, None, {"tx_m": 1e-3, "ty_m": 0.0, "tz_m": -1e-3}),
    Effect("base_frame", None, None, {"tx_m": 1e-3, "rz_rad": 1e-4}),
    Effect("backlash", "joint_1", None, {"width_rad": 2e-4}),
    Effect("wrench_scale", None, None, {"gain_error_ratio": 0.1}),
]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda e: e.name)
def test_a_folder_with_an_effect_predicts_what_the_effect_does(effect: Effect, robot: Robot, tmp_path: Path) -> None:
    rows = plan_rows(robot, 5, poses=12)
    seen = measure(robot, rows, [effect], 5, sigma=0.0)
    write_robot_folder(fold_effects(robot, [effect]), tmp_path / "updated")
    predicted = predict_campaign(read_robot_folder(tmp_path / "updated"), rows)
    np.testing.assert_allclose(predicted.position, seen.position, rtol=0, atol=2e-8)


def test_a_later_campaign_takes_the_state_after_the_last_shift(robot: Robot) -> None:
    rows = plan_rows(robot, 6, poses=8)
    shifted = fold_effects(robot, [Effect("frame_shift", None, None, {"row": 10, "tx_m": 2e-3})])
    moved = predict_campaign(shifted, rows).position - predict_campaign(robot, rows).position
    np.testing.assert_allclose(moved, np.tile([2e-3, 0, 0], (len(rows), 1)), atol=1e-12)


def test_registration_finds_base_and_tool_of_an_instrument_anywhere(robot: Robot) -> None:
    rows = plan_rows(robot, 7, poses=15)
    base, tool = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.from_rotvec([0.5, -2.0, 1.0]).as_matrix(), [3.0, -1.0, 0.4]
    tool[:3, :3], tool[:3, 3] = Rotation.from_rotvec([0.2, 0.1, -0.4]).as_matrix(), [0.02, -0.05, 0.1]
    there = Registration(base, tool[None])
    seen = predict_campaign(robot, rows, registration=there)
    for rotation in (seen.rotation, None):
        campaign = replace(rows, position=seen.position, rotation=rotation)
        found = predict_campaign(robot, campaign, register=("base", "tool"))
        np.testing.assert_allclose(found.position, seen.position, atol=1e-7)


def test_a_registration_survives_its_file(robot: Robot, tmp_path: Path) -> None:
    rows = plan_rows(robot, 8, poses=10)
    plain = predict_campaign(robot, rows)
    campaign = replace(rows, position=plain.position + 0.001)
    registration = fit_registration(campaign, plain.position, plain.rotation, ("base",))
    write_registration(registration, tmp_path / "registration.toml")
    back = read_registration(tmp_path / "registration.toml")
    np.testing.assert_allclose(back.base, registration.base, atol=1e-9)


def test_a_registration_is_read_in_millimetres_and_rotation_vectors_in_degrees(robot: Robot, tmp_path: Path) -> None:
    third = 120.0 / np.sqrt(3.0)  # a third of a turn about the diagonal of a cube takes x to y, y to z, z to x
    (tmp_path / "registration.toml").write_text(
        'schema = 1\nfitted = ["base", "tool"]\n'
        f"[base]\nposition_mm = [2500, -1500, 800]\nrotation_deg = [{third}, {third}, {third}]\n"
        '[[tool]]\ntarget = ""\nposition_mm = [20, 30, 40]\nrotation_deg = [0, 0, 90]\n',
        encoding="utf-8",
    )
    told = read_registration(tmp_path / "registration.toml")
    rows = plan_rows(robot, 10, poses=4)
    plain, seen = predict_campaign(robot, rows), predict_campaign(robot, rows, registration=told)
    x, y, z = (plain.position + plain.rotation @ np.array([0.02, 0.03, 0.04])).T
    np.testing.assert_allclose(seen.position, np.column_stack([z + 2.5, x - 1.5, y + 0.8]), rtol=0, atol=1e-12)
    ahead, across, out = np.moveaxis(plain.rotation, 2, 0)  # the target's x is the tool's y, its y the tool's -x
    turned = np.stack([across, -ahead, out], axis=2)[:, [2, 0, 1]]
    np.testing.assert_allclose(seen.rotation, turned, rtol=0, atol=1e-12)


def test_link_side_readings_hide_what_lies_before_them(robot: Robot) -> None:
    rows = plan_rows(robot, 9, poses=6)
    linked = replace(rows, mode=np.array(["L2"] * len(rows)))
    soft = fold_effects(robot, [Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": 1e-6})])
    np.testing.assert_allclose(
        predict_campaign(soft, linked).position, predict_campaign(robot, linked).position, atol=1e-9
    )
    assert np.abs(predict_campaign(soft, rows).position - predict_campaign(robot, rows).position).max() > 1e-4


def test_every_effect_of_a_file_is_checked(robot: Robot) -> None:
    with pytest.raises(Exception, match="no effect named 'friction'"):
        robot_effects(replace(robot, effects=({"effect": "friction", "parameters": {}},)))
    with pytest.raises(Exception, match="no joint named 'joint_9'"):
        robot_effects(replace(robot, effects=({"effect": "backlash", "joint": "joint_9", "parameters": {}},)))
    assert len(EFFECTS) == 21


def test_the_command_keeps_all_rows(robot: Robot, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    joints = ",".join(f"q{k}_deg" for k in range(1, 7))
    log.write_text(f"run,{joints},x_mm,y_mm,z_mm\nstatic,1,2,3,4,5,6,7,8,9\nstatic,1,2,3,4,5,,7,8,9\n")
    out = tmp_path / "prediction.csv"
    words = [str(log), "--robot", str(robot.folder), "--out", str(out)]
    result = CliRunner().invoke(load_command("predict"), words)
    assert result.exit_code == 0, result.output
    lines = out.read_text().splitlines()
    assert lines[0].startswith("x_mm,y_mm,z_mm")
    assert len(lines) == 3
    assert lines[2].startswith(",,")
    told = dict(zip(lines[0].split(","), map(float, lines[1].split(",")), strict=True))
    (position,), (rotation,), _ = solve_exact_pose(build_exact_robot(robot), np.radians([[1.0, 2, 3, 4, 5, 6]]))
    assert [told[f"{axis}_mm"] for axis in "xyz"] == pytest.approx(1e3 * position, abs=1e-5)
    turn = np.degrees(Rotation.from_matrix(rotation).as_rotvec())
    assert [told[f"{axis}_deg"] for axis in ("rx", "ry", "rz")] == pytest.approx(turn, abs=1e-5)
    said = (
        CliRunner()
        .invoke(load_command("predict"), [str(log), "--robot", str(robot.folder), "--out", str(out), "--json"])
        .output
    )
    apart = np.linalg.norm(1e3 * position - [7.0, 8.0, 9.0])
    assert json.loads(said)["rms_mm"] == json.loads(said)["median_mm"] == pytest.approx(apart)
