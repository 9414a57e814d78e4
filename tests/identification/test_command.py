"""`compplan identify` from log to robot folder."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from observation_log import write_campaign_log
from scipy.spatial.transform import Rotation

from benchmarks.round_trip import draw_candidates, simulate_observations
from compplan.cli import group
from compplan.errors import InputError, UnknownNameError
from compplan.identification.campaign import Identification, identify_campaign
from compplan.identification.problem import IdentifyOptions
from compplan.measurement.reading import read_campaign
from compplan.robot import Robot, Spring, load_robot
from compplan.robot.folder import write_robot_folder
from compplan.robot.springs import link_springs

SOFTER = np.array([1.4, 0.7, 1.2, 0.8, 1.3, 0.9])


def soft_kr270() -> Robot:
    robot = load_robot("kuka_kr270")
    springs = [replace(s, compliance=s.compliance * f) for s, f in zip(robot.springs, SOFTER, strict=True)]
    return replace(robot, springs=tuple(springs))


def measure(truth: Robot, folder: Path, *, poses: int = 40, seed: int = 1) -> Path:
    drawn = draw_candidates(truth, poses, seed=seed)
    file = folder / "measurements.csv"
    write_campaign_log(simulate_observations(truth, drawn.q, drawn.wrench, seed=seed), truth, file)
    return file


def run(*arguments: object) -> object:
    return CliRunner().invoke(group, ["identify", *map(str, arguments)], catch_exceptions=False, standalone_mode=False)


def test_a_log_becomes_an_updated_robot_folder_and_a_report_with_intervals(tmp_path: Path) -> None:
    truth = soft_kr270()
    file = measure(truth, tmp_path)
    result = run(file, "--robot", "kuka_kr270", "--out", tmp_path / "out")
    assert "times closer to the measurements" in result.output
    summary = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert [entry["name"] for entry in summary["parameters"]] == [f"joint_{k}" for k in range(1, 7)]
    for entry, spring in zip(summary["parameters"], truth.springs, strict=True):
        low, high = entry["interval_95"]
        centre, reach = (low + high) / 2, (high - low) / 2
        assert entry["unit"] == "urad/(N m)"
        assert abs(spring.compliance * 1e6 - centre) < 2 * reach
        assert entry["before"] == pytest.approx(
            next(s.compliance for s in load_robot("kuka_kr270").springs if s.name == entry["name"]) * 1e6
        )
    # 15 um and 6 um a metre of distance, per axis, from a tracker some metres away; 5e-5 rad are 0.00286 deg
    assert 0.025 < summary["residual_per_axis"]["position_mm"] < 0.05
    assert summary["residual_per_axis"]["orientation_deg"] == pytest.approx(0.00286, rel=0.2)
    gap = summary["gap"]
    assert gap["held_out_after_rms_mm"] < 0.1 < gap["held_out_before_rms_mm"]
    updated = load_robot(tmp_path / "out" / "robot")
    assert updated.grade == "identified"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "What cannot be determined" in page and "joint_6" in page
    assert updated.sources["compliance"] == "identified from measurements.csv, 40 rows"
    for spring, wanted in zip(updated.springs, truth.springs, strict=True):
        assert spring.compliance == pytest.approx(wanted.compliance, rel=0.15)


def test_unknown_frames_are_fitted_along_and_written_as_registration(tmp_path: Path) -> None:
    truth = soft_kr270()
    drawn = draw_candidates(truth, 40, seed=1)
    q, wrench = np.vstack([drawn.q] * 2), np.vstack([drawn.wrench, np.zeros((40, 6))])
    rows = simulate_observations(truth, q, wrench, seed=2)
    base, tool = np.eye(4), np.array([0.05, -0.02, 0.1])
    base[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 1.1]).as_matrix()
    base[:3, 3] = [2.0, -1.0, 0.3]
    position = (rows.position + rows.rotation @ tool) @ base[:3, :3].T + base[:3, 3]
    moved = replace(rows, position=position, rotation=base[:3, :3] @ rows.rotation)
    file = tmp_path / "measurements.csv"
    write_campaign_log(moved, truth, file)
    result = identify_campaign(
        load_robot("kuka_kr270"), read_campaign(file, truth), IdentifyOptions(register=("base", "tool"))
    )
    errors = result.kept.standard_errors[:6]
    wanted = np.array([spring.compliance for spring in truth.springs])
    assert np.abs((result.kept.model_values - wanted) / errors).max() < 4
    np.testing.assert_allclose(result.registration.base, base, atol=1e-4)
    np.testing.assert_allclose(result.registration.tool[0, :3, 3], tool, atol=1e-4)
    assert result.geometry == "none"
    assert run(file, "--robot", "kuka_kr270", "--out", tmp_path / "out", "--register", "base,tool").exit_code == 0
    assert (tmp_path / "out" / "robot" / "registration.toml").is_file()


def test_a_wrong_joint_zero_is_fitted_along_and_the_controller_keeps_its_geometry(tmp_path: Path) -> None:
    truth = soft_kr270()
    joints = list(truth.joints)
    third = next(k for k, joint in enumerate(joints) if joint.name == "joint_3")
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(8e-4 * joints[third].axis).as_matrix()
    joints[third] = replace(joints[third], placement=joints[third].placement @ turn)
    bent = replace(truth, joints=tuple(joints))
    file = measure(bent, tmp_path, poses=80)
    run(file, "--robot", "kuka_kr270", "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert summary["geometry"] == "offsets"
    offset = next(entry for entry in summary["parameters"] if entry["name"] == "joint_3.offset")
    assert offset["value"] == pytest.approx(np.rad2deg(8e-4), rel=0.1) and offset["unit"] == "deg"
    updated = load_robot(tmp_path / "out" / "robot")
    placed = next(joint for joint in updated.joints if joint.name == "joint_3").placement
    np.testing.assert_allclose(placed, joints[third].placement, atol=1e-4)
    assert (tmp_path / "out" / "robot" / "controller.urdf").read_text() == load_robot("kuka_kr270").urdf


def test_a_rigid_robot_keeps_only_the_springs_that_earn_their_place(tmp_path: Path) -> None:
    rigid = load_robot("ur10")
    truth = replace(rigid, springs=(Spring(rigid.joint_names[1], "own", 4e-5, actuator=True),))
    drawn = draw_candidates(rigid, 120, seed=1)
    file = tmp_path / "measurements.csv"
    write_campaign_log(simulate_observations(truth, drawn.q, np.zeros((120, 6)), seed=3), rigid, file)
    result = identify_campaign(rigid, read_campaign(file, rigid))
    assert [spring.joint for spring in result.robot.springs] == [rigid.joint_names[1]]
    assert result.robot.springs[0].compliance == pytest.approx(4e-5, rel=0.1)
    held = {item.held: item.reason for item in result.estimate.held}
    assert "weight of the links never acts about its axis" in held[rigid.joint_names[0]]
    assert result.gap.held_out_after < 0.5 * result.gap.held_out_before


def test_modes_of_double_encoders_tell_gears_and_links_apart(tmp_path: Path) -> None:
    robot = soft_kr270()
    truth = replace(robot, springs=(*robot.springs, replace(link_springs(robot)[1], compliance=3e-7)))
    drawn = draw_candidates(robot, 25, seed=1)
    nothing = np.zeros_like(drawn.wrench)
    modes = np.repeat([False, True, False, True], 25)
    loads = np.vstack([nothing, nothing, drawn.wrench, drawn.wrench])
    file = tmp_path / "measurements.csv"
    rows = simulate_observations(truth, np.vstack([drawn.q] * 4), loads, seed=2, link_side=modes)
    write_campaign_log(rows, robot, file)
    result = identify_campaign(load_robot("kuka_kr270"), read_campaign(file, robot))
    found = {(s.joint, s.actuator): s.compliance for s in result.robot.springs}
    assert found[("joint_2", True)] == pytest.approx(robot.springs[1].compliance, rel=0.05)
    assert found[("joint_2", False)] == pytest.approx(3e-7, rel=0.05)
    assert len(found) == 7


def identify_shifted(folder: Path, shifted: list[int]) -> tuple[Robot, Identification]:
    """Return the truth and what is identified from 100 rows, some of them off by 5 mm."""
    truth = soft_kr270()
    drawn = draw_candidates(truth, 100, seed=1)
    rows = simulate_observations(truth, drawn.q, drawn.wrench, seed=1)
    position = rows.position.copy()
    position[shifted] += [0.004, -0.003, 0.002]
    file = folder / "measurements.csv"
    write_campaign_log(replace(rows, position=position), truth, file)
    return truth, identify_campaign(load_robot("kuka_kr270"), read_campaign(file, truth))


def test_gross_outliers_are_found_named_and_left_out(tmp_path: Path) -> None:
    truth, result = identify_shifted(tmp_path, [7, 42])
    assert result.outliers == (7, 42)
    assert result.gap.after < 1e-4
    score = (result.kept.model_values - [s.compliance for s in truth.springs]) / result.kept.standard_errors
    assert np.abs(score).max() < 4


def test_a_quarter_of_rows_that_no_model_explains_is_not_called_outliers(tmp_path: Path) -> None:
    _, result = identify_shifted(tmp_path, list(range(75, 100)))  # the frame jumped
    assert result.outliers == ()
    assert any("too many for gross outliers" in note for note in result.notes)


def test_an_updated_folder_can_be_identified_again(tmp_path: Path) -> None:
    truth = soft_kr270()
    file = measure(truth, tmp_path)
    folder = tmp_path / "nominal"
    write_robot_folder(load_robot("kuka_kr270"), folder)
    run(file, "--robot", folder, "--out", tmp_path / "first")
    run(file, "--robot", tmp_path / "first" / "robot", "--out", tmp_path / "second")
    gaps = [json.loads((tmp_path / k / "identify.json").read_text())["gap"] for k in ("first", "second")]
    assert gaps[1]["before_rms_mm"] == pytest.approx(gaps[0]["after_rms_mm"], rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--register", "flange"], "--register names 'flange', choose from"),
        (["--springs", "joint_1,joint_7"], "no spring named 'joint_7', choose from"),
        (["--add", "elbow.rx"], "no joint named 'elbow', choose from"),
        (["--springs", "joint_1.rx"], "no spring named 'joint_1.rx'"),
    ],
)
def test_options_that_name_nothing_are_refused(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    file = measure(soft_kr270(), tmp_path, poses=10)
    with pytest.raises((InputError, UnknownNameError), match=sentence):
        run(file, "--robot", "kuka_kr270", "--out", tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


def test_a_log_without_settled_poses_or_without_loads_is_refused(tmp_path: Path) -> None:
    file = measure(soft_kr270(), tmp_path, poses=10)
    passing = tmp_path / "path.csv"
    passing.write_text(file.read_text().replace("static_1", "path_1"))
    with pytest.raises(InputError, match="no settled pose in this log"):
        run(passing, "--robot", "kuka_kr270", "--out", tmp_path / "out")
    robot = load_robot("kuka_kr270")
    idle = tmp_path / "idle.csv"
    q = draw_candidates(robot, 12, seed=1).q
    write_campaign_log(simulate_observations(robot, q, np.zeros((12, 6)), seed=1), robot, idle)
    with pytest.raises(InputError, match="nothing can be identified: joint_1 cannot be determined at all: no row"):
        run(idle, "--robot", "kuka_kr270", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bad_input_is_one_line_with_file_and_line_and_status_2(tmp_path: Path) -> None:
    file = measure(soft_kr270(), tmp_path, poses=10)
    lines = file.read_text().splitlines()
    lines[3] = lines[3].replace("static_1,", "static_1,abc", 1)
    file.write_text("\n".join(lines))
    done = subprocess.run(
        [sys.executable, "-c", "from compplan.cli import main; main()", "identify", str(file), "--robot", "kuka_kr270",
         "--out", str(tmp_path / "out")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {file}:4: column 'q1_deg' holds")
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_the_example_campaign_gives_back_the_factors_that_were_put_in(tmp_path: Path) -> None:
    file = Path(__file__).parents[2] / "examples" / "identify" / "measurements.csv"
    said = run(file, "--robot", "kuka_kr270", "--out", tmp_path, "--json")
    summary = json.loads((tmp_path / "identify.json").read_text())
    assert json.loads(said.output) == summary
    factors = [entry["value"] / entry["before"] for entry in summary["parameters"]]
    errors = [entry["standard_error"] / entry["before"] for entry in summary["parameters"]]
    assert np.abs((np.array(factors) - SOFTER) / errors).max() < 4
    assert summary["gap"]["held_out_after_rms_mm"] < 0.08
