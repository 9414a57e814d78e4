"""The error band against closed forms, and against robots drawn and solved exactly."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import one_joint_arm
from commandline import run_command
from drawn_robots import sample_band
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import compplan
from compplan.job.job import check_job
from compplan.job.noise import NoiseTable
from compplan.measurement.distance import band_radius, calibrate_band
from compplan.planning.inertia import find_inside
from compplan.planning.plan import plan_job
from compplan.robot import load_robot
from compplan.robot.pose import fit_displacement
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.simulation.vibration import MODES, build_dynamics, find_modes, modal_response
from compplan.statics.inertia import build_moving_chain, load_motion
from compplan.studies.study import prepare_study
from compplan.uncertainty.assumed import restore_prior
from compplan.uncertainty.band import estimate_band, linearise_path
from compplan.uncertainty.motion import Motion
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model, measure_slopes
from compplan.uncertainty.touch_off import TouchedPart, spread_placement

PATHS = Path(__file__).parents[2] / "paths"
SURE = ForceSpread(0.0, 0.0, 0.0, "known")
JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 100.0, "feed_mm_s": 150.0, "waypoints": 120},
    "part": {"position_mm": [1700.0, 0.0, 900.0]},
    "process": {"model": "constant", "force_N": [0.0, 0.0, 0.0], "frame": "base"},
    "plan": {"tolerance_mm": 0.1},
}


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
    error_band = estimate_band(robot, scene, np.ones(4, bool), SURE)
    assert error_band.radius == pytest.approx(1.959964 * 1e-8 * 100.0 * 1.5**2, rel=2e-3)
    assert error_band.parts["force"] == pytest.approx(0.0, abs=1e-12)
    assert error_band.leading[0] == ("joint_stiffness joint_1", pytest.approx(1.0))


def test_the_parts_of_the_band_are_what_makes_it(tmp_path: Path) -> None:
    """Force level of 10 %: .1 C F L^2 up; unexplained and repeatability alike in all directions."""
    robot = one_joint_arm(tmp_path, length=1.0, compliance=1e-6)
    known = replace(soft_joint(0.0, unexplained=3e-5), repeatability=1e-5)
    robot = replace(robot, uncertainty=known)
    wrench = np.tile([0.0, 0, 200.0, 0, 0, 0], (3, 1))
    scene = build_path_model(robot, np.zeros((3, 1)), wrench)
    error_band = estimate_band(robot, scene, np.ones(3, bool), ForceSpread(0.1, 0.0, 0.0, "made up"))
    assert error_band.parts["force"] == pytest.approx(1.959964 * 0.1 * 1e-6 * 200.0, rel=2e-3)
    assert error_band.parts["unexplained"] == pytest.approx(2.795483 * 3e-5 / np.sqrt(3.0), rel=1e-6)
    assert error_band.parts["repeatability"] == pytest.approx(2.795483e-5, rel=1e-6)


def test_band_before_equals_the_band_of_a_plan_that_corrects_nothing(tmp_path: Path) -> None:
    """Soft joint, motion of 12 draws that differ along the path; where nothing bends both bands are one, to 1e-12 m."""
    robot = replace(one_joint_arm(tmp_path, length=1.0), uncertainty=soft_joint(1e-8, unexplained=2e-5))
    scene = build_path_model(robot, np.zeros((5, 1)), np.tile([0.0, 0, 100.0, 0, 0, 0], (5, 1)))
    error = 3e-5 * np.random.default_rng(4).standard_normal((12, 5, 3))
    motion = Motion(error, np.zeros((5, 3)), np.zeros((5, 3)), "made up")
    fit = np.full(5, 1e-5)
    for off in (0.0, 2e-5):
        band = estimate_band(robot, scene, np.ones(5, bool), SURE, left=fit, written=fit, between=1e-6,
                             motion=motion, uncorrected=np.full((5, 3), off))  # fmt: skip
        if off == 0.0:
            assert band.before == pytest.approx((band.greatest, band.whole), abs=1e-12)
        else:
            assert band.before is not None and band.before[1] > band.whole
    assert band.whole > band.greatest


def test_what_a_log_does_not_determine_keeps_its_width_from_before_the_log() -> None:
    """Zero of .01 deg, lengths of .1 mm of joint_1 as delivered; what the log told of joint_2 stays."""
    robot = load_robot("kuka_kr270")
    unknowns = tuple(
        Unknown(*place, (key,), np.array([size]))
        for *place, key, size in (
            ("joint_offset", "joint_1", None, "offset_rad", 1e-6), ("link_geometry", "joint_1", "tx", "tx_m", 1e-6),
            ("joint_offset", "joint_2", None, "offset_rad", 1e-6),
            ("joint_stiffness", "joint_6", None, "compliance_change_rad_per_Nm", 1e-9),
        )
    )  # fmt: skip
    factor = np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0], [0.0, 0.0, 0.0, 1.0]])
    known = restore_prior(robot, Uncertainty("measured", "test", unknowns, factor, calibration=2.0), free_base=True)
    width = dict(zip(known.names, known.width, strict=True))
    assert width["joint_offset joint_1"] == pytest.approx(np.radians(0.01))
    assert [width[f"link_geometry joint_1 t{axis}"] for axis in "xyz"] == pytest.approx([1e-4] * 3)
    assert width["joint_offset joint_2"] == pytest.approx(2e-6)
    assert "zero and place of joint_1 assumed" in known.source
    first = known.names.index("joint_offset joint_1")
    assert np.delete(known.covariance[first], first) == pytest.approx(0.0)
    # no load on any joint but the sixth: their compliances are as unknown as before, 20 % of the folder's
    assert "compliance of joint_1, joint_2, joint_3, joint_4, joint_5 assumed" in known.source
    springs = {spring.joint: spring.compliance for spring in robot.springs}
    assert [width[f"joint_stiffness joint_{k}"] / springs[f"joint_{k}"] for k in (1, 5)] == pytest.approx([0.2, 0.2])
    assert width["joint_stiffness joint_6"] == pytest.approx(2e-9)
    again = restore_prior(replace(robot, uncertainty=known), known, free_base=True)  # a second log leaves it as it is
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
        error_band = estimate_band(robot, scene, np.ones(4, bool), SURE, touched=found)
        reach = np.linalg.norm(tip[:, :2], axis=1)
        assert error_band.radius == pytest.approx(share * 1.959964 * turn * reach, rel=2e-3, abs=1e-8)


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
    error_band = estimate_band(robot, scene, np.ones(40, bool), ForceSpread(0.15, 0.05, 0.05, "made up"))
    sampled = sample_band(scene, error_band, 200, seed=11, most=8)
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
    assert "(95 %)" in answer.out
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
    error_band = estimate_band(robot, scene, np.ones(4, bool), SURE)
    honest = sample_band(scene, error_band, 600, seed=3)
    assert honest.oracle == pytest.approx(error_band.radius[honest.rows], rel=0.06)
    wider = sample_band(scene, error_band, 600, seed=3, true=soft_joint(2e-8))
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


def test_the_spread_of_a_fitted_part_is_that_of_parts_fitted_to_drawn_points() -> None:
    """1000 draws: each coordinate of three points 100 mm apart with 20 um, the part fitted to them."""
    robot = compplan.load_robot("kuka_kr270")
    points = np.array([[1.7, 0.0, 0.9], [1.8, 0.0, 0.9], [1.7, 0.1, 0.9]])
    place = np.array([[1.75, 0.05, 0.88], [1.9, 0.2, 0.9]])
    touched = TouchedPart(robot, np.zeros((3, 6)), points, None)
    columns = touched.spread_part(place)
    random, off = np.random.default_rng(3), []
    for _ in range(1000):
        pose = fit_displacement(points, points + 2e-5 * random.standard_normal((3, 3)))
        off.append(place @ pose[:3, :3].T + pose[:3, 3] - place)
    seen = np.sqrt((np.array(off) ** 2).mean(axis=0))
    assert np.sqrt((columns**2).sum(axis=2)) == pytest.approx(seen, rel=0.1)


def test_a_part_follows_rigid_motions_of_its_points_exactly() -> None:
    robot = compplan.load_robot("kuka_kr270")
    points = np.array([[1.7, 0.0, 0.9], [1.8, 0.0, 0.9], [1.7, 0.1, 0.9]])
    touched = TouchedPart(robot, np.zeros((3, 6)), points, None)
    turn = Rotation.from_rotvec([1e-7, -2e-7, 3e-7])
    place = np.array([[1.75, 0.05, 0.88]])
    moved = (turn.apply(points) - points)[:, :, None]
    assert touched.follow(moved, place)[:, :, 0] == pytest.approx(turn.apply(place) - place, abs=1e-12)


@pytest.mark.parametrize(("scale", "damping"), [(1.0, 0.03), (0.8, 0.1)])
def test_a_mass_on_a_spring_rings_as_an_integration_in_small_steps_says(
    tmp_path: Path, scale: float, damping: float
) -> None:
    """One joint, 20 kg at 1 m, C = 1e-5: w = 70.7 rad/s; a load that sets in and ends, rows far from even."""
    dynamics = build_dynamics(one_joint_arm(tmp_path, 1.0, 1e-5, mass=20.0))
    random = np.random.default_rng(3)
    time = np.sort(np.r_[0.0, random.uniform(0.0, 1.0, 200), 1.0])
    load = np.where(time < 0.5, 100.0 * np.sin(6.0 * time) ** 2, 0.0)[:, None]
    modes = find_modes(dynamics, np.zeros((1, 1)), MODES)
    omega = scale * modes[0].omega[0]
    assert modes[0].omega[0] == pytest.approx((1e-5 * 20.0) ** -0.5, rel=1e-3)
    one, share = np.ones((1, 1)), np.array([damping])
    more = modal_response(modes, np.array([0]), time, [load], one, np.array([scale]), share)[0]
    static = 1e-5 * load[:, 0]

    def change(t: float, x: np.ndarray) -> list[float]:
        push = 1e-5 * omega**2 * np.interp(t, time, load[:, 0])
        return [x[1], push - 2 * damping * omega * x[1] - omega**2 * x[0]]

    found = solve_ivp(change, (0.0, 1.0), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]
    assert np.abs(found).max() > 1.02 * np.abs(static).max()
    tip = np.abs(more[:, 2]) * np.sign(found - static)
    assert tip == pytest.approx(found - static, abs=2e-3 * np.abs(found).max())


def test_a_nervous_path_moves_no_drive_nervously_and_what_that_leaves_is_in_the_band(tmp_path: Path) -> None:
    """Rows on a zigzag of 20 um: its inertia is out of the arm's reach, so the command does not answer to it."""
    x = np.linspace(0.0, 120.0, 121)
    rows = [f"{a:.4f},{0.02 * (k % 2):.4f},0,60" for k, a in enumerate(x)]
    (tmp_path / "path.csv").write_text("\n".join(["x_mm,y_mm,z_mm,feed_mm_s", *rows]) + "\n", encoding="utf-8")
    table = {**JOB, "toolpath": "path.csv", "sampling": {"max_step_mm": 1000.0}}
    plan = plan_job(check_job(table, tmp_path / "job.toml"))
    task, error_band = plan.task, plan.error_band
    assert (
        plan.status == "solved" and task.bias is not None and error_band is not None and error_band.motion is not None
    )
    raw = load_motion(build_moving_chain(task.robot), task.q_links, plan.timing.time, find_inside(task))
    middle = slice(len(task) // 3, 2 * len(task) // 3)
    jumps, smooth = (np.abs(np.diff(load[middle], axis=0)).max(axis=0) for load in (raw, task.bias))
    assert (jumps > 1.0).any() and (smooth[jumps > 1.0] < 0.3 * jumps[jumps > 1.0]).all()
    assert np.linalg.norm(error_band.motion.mean[plan.task.cut], axis=1).max() > 1e-6


def test_a_plan_that_leaves_inertia_alone_has_it_in_its_band_and_its_verdict_says_so() -> None:
    """The same path at the same feed without force: what differs is the inertia of the motion."""
    jobs = {on: check_job({**JOB, "plan": {"tolerance_mm": 0.1, "inertia": on}}, "job.toml") for on in (True, False)}
    plans = {on: plan_job(job) for on, job in jobs.items()}
    bands = {on: plan.error_band for on, plan in plans.items()}
    assert plans[True].task.inertia and plans[True].status == "solved"
    for on in (True, False):
        assert bands[on] is not None and bands[on].motion is not None
    widest = {on: float(band.parts["motion"][band.cut].max()) for on, band in bands.items() if band is not None}
    assert widest[True] < 0.8 * widest[False]
    assert widest[False] > plans[False].inertia
    if plans[False].verdict.largest_cause == "inertia and vibration":
        assert "inertia = true" in plans[False].verdict.change


def test_the_place_of_an_absolute_part_counts_as_stated_or_assumed() -> None:
    """One deviation of .05 mm per axis is assumed, and .005 deg about the part frame: the same as in Monte Carlo."""
    plain, placed = (
        plan_job(check_job({**JOB, **more}, "job.toml"))
        for more in (
            {"part": {**JOB["part"], "touched_off": False}},
            {"noise": {"part_frame_mm": 0.5, "part_frame_deg": 0.0}, "part": {**JOB["part"], "touched_off": False}},
        )
    )
    assert placed.error_band is not None and plain.error_band is not None
    assert placed.error_band.parts["placement"] == pytest.approx(2.795483 * 5e-4, rel=1e-4)
    assert placed.verdict.largest_cause == "place of the part"
    assert any("absolute part frame: 0.05 mm and 0.005 deg" in one for one in plain.error_band.assumed)
    assert not any("absolute part frame" in one for one in placed.error_band.assumed)
    random, lever = np.random.default_rng(3).standard_normal((2, 100_000, 3)), np.array([0.1, 0.0, 0.0])
    moved = 5e-5 * random[0] + np.cross(np.radians(0.005) * random[1], lever)
    drawn = np.quantile(np.linalg.norm(moved, axis=1), 0.95)
    assert plain.error_band.parts["placement"][plain.task.cut] == pytest.approx(drawn, rel=0.01)
    rates = prepare_study(plain.task, strategies=["none"]).context.shift[1:7]
    covariance = np.einsum("kin,kjn->nij", rates, rates)
    assert band_radius(covariance) == pytest.approx(plain.error_band.parts["placement"], rel=1e-6)


def test_the_place_of_a_part_is_stated_in_mm_and_degrees() -> None:
    columns = spread_placement(NoiseTable(part_frame_mm=0.5, part_frame_deg=2.0), None, np.eye(3), np.zeros(3))
    assert columns[2, :, [0, 5]] == pytest.approx(np.array([[5e-4, 0, 0], [0, 0, 0]]))
    assert columns[0, :, 5] == pytest.approx([0.0, np.pi / 90, 0.0])


def test_a_part_that_is_turned_moves_by_the_angle_times_the_distance_from_its_frame() -> None:
    noise = NoiseTable(part_frame_mm=0.1, part_frame_deg=1.0)
    columns = spread_placement(noise, None, np.array([[1.0, 0.5, 0.0]]), np.array([1.0, 0.0, 0.0]))
    assert np.linalg.norm(columns[0, :, 5]) == pytest.approx(np.pi / 180 * 0.5)
    assert columns[0, :, 4] == pytest.approx(0.0)
