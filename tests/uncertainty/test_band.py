"""The promise: the band against closed forms, and against robots drawn and solved exactly."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm
from commandline import run_command
from drawn_robots import sample_promise

from compplan.measurement.distance import band_radius, calibrate_band
from compplan.planning.plan import PlanOptions, plan_compensation
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.toolpath.generators import CircleTable
from compplan.toolpath.toolpath import place_toolpath
from compplan.uncertainty.assumed import free_base
from compplan.uncertainty.band import estimate_band, linearise_path
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model, measure_slopes
from compplan.uncertainty.touch_off import TouchedPart

PATHS = Path(__file__).parents[2] / "paths"
SURE = ForceSpread(0.0, 0.0, 0.0, "known")
UNSURE = ForceSpread(0.1, 0.02, 0.05, "made up")


def soft_joint(deviation: float, **more: float) -> Uncertainty:
    unknown = Unknown("joint_stiffness", "joint_1", None, ("compliance_change_rad_per_Nm",), np.array([deviation]))
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.zeros(1))
    return Uncertainty("measured", "made up", (unknown, tool), np.eye(2), repeatability=0.0, **more)


@pytest.mark.parametrize(
    ("spread", "tolerance"),
    [((1.0, 0, 0), 1e-6), ((1.0, 1.0, 1.0), 1e-6), ((1.0, 0.5, 0.1), 6e-3), ((1, 0.9, 0), 6e-3)],
)
def test_the_radius_holds_its_share_of_normal_errors(spread: tuple[float, ...], tolerance: float) -> None:
    """One and three equal directions against tables (1.959964, 2.795483); others against 400,000 draws."""
    radius = band_radius(np.diag(spread)[None])[0]
    if spread == (1.0, 0, 0):
        assert radius == pytest.approx(1.959964, abs=tolerance)
    elif spread == (1.0, 1.0, 1.0):
        assert radius == pytest.approx(2.795483, abs=tolerance)
    else:
        drawn = np.random.default_rng(1).standard_normal((400000, 3)) * np.sqrt(spread)
        assert np.mean(np.linalg.norm(drawn, axis=1) <= radius) == pytest.approx(0.95, abs=tolerance)


def test_a_soft_joint_moves_the_tip_by_load_times_lever_squared(tmp_path: Path) -> None:
    """dz = C F L^2: with F = 100 N, L = 1.5 m and a deviation of 1e-8 rad/(N m) the band is 1.96 * 2.25 um."""
    robot = replace(one_joint_arm(tmp_path, length=1.5), uncertainty=soft_joint(1e-8))
    wrench = np.tile([0.0, 0, 100.0, 0, 0, 0], (4, 1))
    scene = build_path_model(robot, np.zeros((4, 1)), wrench)
    promise = estimate_band(robot, scene, np.ones(4, bool), SURE)
    assert promise.radius == pytest.approx(1.959964 * 1e-8 * 100.0 * 1.5**2, rel=2e-3)
    assert promise.parts["force"] == pytest.approx(0.0, abs=1e-12)
    assert promise.leading[0] == ("joint_stiffness joint_1", pytest.approx(1.0))


def test_the_parts_of_the_band_are_what_makes_it(tmp_path: Path) -> None:
    """Force level of 10 %: .1 C F L^2 up; unexplained and repeatability alike in all directions."""
    robot = one_joint_arm(tmp_path, length=1.0, compliance=1e-6)
    known = replace(soft_joint(0.0, unexplained=3e-5), repeatability=1e-5)
    robot = replace(robot, uncertainty=known)
    wrench = np.tile([0.0, 0, 200.0, 0, 0, 0], (3, 1))
    scene = build_path_model(robot, np.zeros((3, 1)), wrench)
    promise = estimate_band(robot, scene, np.ones(3, bool), ForceSpread(0.1, 0.0, 0.0, "made up"))
    assert promise.parts["force"] == pytest.approx(1.959964 * 0.1 * 1e-6 * 200.0, rel=2e-3)
    assert promise.parts["unexplained"] == pytest.approx(2.795483 * 3e-5 / np.sqrt(3.0), rel=1e-6)
    assert promise.parts["repeatability"] == pytest.approx(2.795483e-5, rel=1e-6)


def test_what_a_fitted_base_frame_hides_keeps_its_width_from_before_the_log() -> None:
    """Zero of .01 deg, lengths of .1 mm of joint_1 as delivered; what the log told of joint_2 stays."""
    robot = load_robot("kuka_kr270")
    unknowns = tuple(
        Unknown(*place, (key,), np.array([1e-6]))
        for *place, key in (
            ("joint_offset", "joint_1", None, "offset_rad"), ("link_geometry", "joint_1", "tx", "tx_m"),
            ("joint_offset", "joint_2", None, "offset_rad"),
        )
    )  # fmt: skip
    factor = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.6, 0.8]])
    known = free_base(robot, Uncertainty("measured", "test", unknowns, factor, calibration=2.0))
    width = dict(zip(known.names, known.width, strict=True))
    assert width["joint_offset joint_1"] == pytest.approx(np.radians(0.01))
    assert [width[f"link_geometry joint_1 t{axis}"] for axis in "xyz"] == pytest.approx([1e-4] * 3)
    assert width["joint_offset joint_2"] == pytest.approx(2e-6)
    assert "zero and place of joint_1 assumed" in known.source
    first = known.names.index("joint_offset joint_1")
    assert np.delete(known.covariance[first], first) == pytest.approx(0.0)
    again = free_base(replace(robot, uncertainty=known), known)  # a second log finds it as the first left it
    assert dict(zip(again.names, again.width, strict=True)) == pytest.approx(width)


def test_a_part_that_was_touched_off_moves_with_the_first_joint_zero() -> None:
    """A zero of width s moves the tip by s times its distance from the axis; a part found with the robot goes along."""
    robot, turn = load_robot("kuka_kr270"), 1e-4
    zero = Unknown("joint_offset", "joint_1", None, ("offset_rad",), np.array([turn]))
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.zeros(1))
    robot = replace(robot, uncertainty=Uncertainty("measured", "test", (zero, tool), np.eye(2), repeatability=0.0))
    q = np.radians([20.0, -70, 90, 0, 60, 0]) + np.linspace(0, 0.2, 4)[:, None]
    scene = build_path_model(robot, q, np.zeros((4, 6)))
    tip = linearise_path(scene, robot.uncertainty, SURE, np.ones(4, bool)).tip
    touched = TouchedPart(robot, q[:3], tip[:3], None)
    for found, share in ((None, 1.0), (touched, 0.0)):
        promise = estimate_band(robot, scene, np.ones(4, bool), SURE, touched=found)
        reach = np.linalg.norm(tip[:, :2], axis=1)
        assert promise.radius == pytest.approx(share * 1.959964 * turn * reach, rel=2e-3, abs=1e-8)


def test_lost_motion_counts_by_the_direction_of_travel(tmp_path: Path) -> None:
    """The tip lags by half the width on the way up and leads by it on the way back: both give one slope, L / 2."""
    robot = one_joint_arm(tmp_path, length=2.0, compliance=0.0)
    play = Unknown("backlash", "joint_1", None, ("width_rad",), np.array([1e-5]))
    q = np.r_[np.linspace(0, 0.1, 6), np.linspace(0.1, 0, 6)[1:]][:, None]
    slopes = measure_slopes(build_path_model(robot, q, np.zeros((11, 6))), [play], np.array([3, 8]))
    assert np.linalg.norm(slopes[:, :, 0], axis=1) == pytest.approx(1.0, rel=1e-4)
    assert slopes[0, :, 0] == pytest.approx(-slopes[1, :, 0], abs=0.1)


@pytest.mark.parametrize("name", ["kuka_kr270", pytest.param("staubli_tx200", marks=pytest.mark.slow)])
def test_the_band_holds_the_tips_of_drawn_robots(name: str) -> None:
    robot = load_robot(name)
    phase = np.linspace(0, 2 * np.pi, 40)[:, None]
    middle = 0.5 * (robot.lower + robot.upper)
    bent = middle + np.array([0.0, 0.4, 0.6, 0.2, 0.5, 0.1]) + 0.1 * np.sin(phase + np.arange(6))
    wrench = np.tile([300.0, -200.0, 500.0, 0, 0, 0], (40, 1))
    scene = build_path_model(robot, bent, wrench)
    promise = estimate_band(robot, scene, np.ones(40, bool), ForceSpread(0.15, 0.05, 0.05, "made up"))
    sampled = sample_promise(scene, promise, 200, seed=11, most=8)
    assert 0.92 < sampled.held < 0.98


def test_a_conformal_step_widens_a_model_that_is_too_sure_and_leaves_a_true_one() -> None:
    random = np.random.default_rng(4)
    model = np.tile(np.eye(3) * 1e-8, (600, 1, 1))
    error = 1e-4 * random.standard_normal((600, 3))
    alone = np.arange(600)
    honest, groups = calibrate_band(error, model, np.zeros((600, 3, 3)), alone)
    assert groups == 600
    assert honest == pytest.approx(1.0, abs=0.08)
    assert calibrate_band(3.0 * error, model, np.zeros((600, 3, 3)), alone)[0] == pytest.approx(3.0 * honest, rel=0.08)
    held = np.linalg.norm(3.0 * error, axis=1) <= band_radius(9.0 * model)
    assert held.mean() == pytest.approx(0.95, abs=0.02)


def test_plan_states_its_promise_and_what_it_rests_on(tmp_path, monkeypatch, capsys) -> None:
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 40")
    job = tmp_path / "circle.toml"
    job.write_text(text, encoding="utf-8")
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0
    assert "95 % band" in answer.out
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    promised, parts = plan["error_band_mm"], plan["error_band_mm"]["at_widest"]
    assert max(parts.values()) < promised["p95_max"] < 1.01 * np.sqrt(sum(v**2 for v in parts.values())) + 0.05
    assert promised["p95_max"] <= promised["whole_path_p95"]
    assert any("assumed" in sentence for sentence in plan["error_band_from"]["assumed"])
    assert "along the whole part within" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_oracle_is_the_quantile_of_the_tips_and_unmodelled_ones_leave_the_band(tmp_path: Path) -> None:
    """A band of 1.96 sigma is an oracle's; where the truth scatters twice as far the oracle is twice as wide."""
    robot = replace(one_joint_arm(tmp_path, length=1.5), uncertainty=soft_joint(1e-8))
    scene = build_path_model(robot, np.zeros((4, 1)), np.tile([0.0, 0, 100.0, 0, 0, 0], (4, 1)))
    promise = estimate_band(robot, scene, np.ones(4, bool), SURE)
    honest = sample_promise(scene, promise, 600, seed=3)
    assert honest.oracle == pytest.approx(promise.radius[honest.rows], rel=0.06)
    wider = sample_promise(scene, promise, 600, seed=3, true=soft_joint(2e-8))
    assert wider.oracle == pytest.approx(2 * honest.oracle, rel=1e-6)
    assert wider.held == pytest.approx(0.673, abs=0.04)  # P(|z| < 0.98)


def test_a_folder_whose_uncertainty_is_broken_ends_in_one_line(tmp_path, monkeypatch, capsys) -> None:
    folder = tmp_path / "robot"
    shutil.copytree(PATHS.parent / "robots" / "kuka_kr270", folder)
    (folder / "uncertainty.toml").write_text('schema = 1\ngrade = "measured"\nsource = "x"\nrms = 3\n')
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace('robot = "kuka_kr270"', 'robot = "robot"')
    (tmp_path / "circle.toml").write_text(text, encoding="utf-8")
    answer = run_command(["plan", tmp_path / "circle.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert answer.err.count("\n") == 1
    assert "uncertainty.toml: rms: unknown key" in answer.err
    assert not (tmp_path / "out").exists()


def test_a_band_far_wider_than_the_uncorrected_program_is_off_says_why() -> None:
    path = CircleTable(radius_mm=50, feed_mm_s=20, waypoints=30).generate()
    place = np.eye(4)
    place[:3, 3] = 1.6, 0.0, 0.9
    robot = load_robot("kuka_kr270")
    offset = Unknown("joint_offset", "joint_1", None, ("offset_rad",), np.array([2e-3]))
    known = Uncertainty("measured", "test", (offset,), np.eye(1), repeatability=1e-5)
    for push, wide in ((30.0, True), (3000.0, False)):
        wrench = np.tile([push, 0.0, 0.0, 0.0, 0.0, 0.0], (30, 1))
        nominal = replace(place_toolpath(path, place), wrench=wrench)
        plan = plan_compensation(replace(robot, uncertainty=known), nominal, PlanOptions(inertia=False))
        assert plan.promise is not None
        assert (plan.promise.greatest > 10.0 * plan.before.max_deviation) == wide
        said = plan.verdict.sentence
        assert ("The band is wide" in said) == wide, said
        assert not wide or "zero of joint" in said.replace("_", " ") or "joint 1" in said.replace("_", " "), said
