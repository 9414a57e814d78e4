"""The independent check of plans fails on joints.csv files that are wrong on purpose, and on them alone."""

from __future__ import annotations

import ast
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.simulated_robot.clearance import least_clearance
from benchmarks.simulated_robot.force import contact_share, law, milling
from benchmarks.simulated_robot.match import Placed, place_rows
from benchmarks.simulated_robot.measure import examine, work_out
from benchmarks.simulated_robot.paths import write_jobs
from benchmarks.simulated_robot.verdict import judge_answer, list_breaches

from benchmarks.simulated_robot.cell import Kinematics, SimulatedRobot
from benchmarks.simulated_robot.job import WRENCH, Job, Rows, read_job, read_joints
from benchmarks.simulated_robot.robot import Array, beam, mount_tool, read_arm
from benchmarks.simulated_robot.run import ROOT, Outcome

POSTURE = np.array([0.1, 0.4, -1.8, 0.2, 0.7, -0.3])
FEED = 0.04
PLAN = {"status": "solved", "error_after_mm": {"max": 0.0}, "between_waypoints_mm": {"max": 0.0}, "notes": ["feed"]}
MILLING = """model = "milling"
depth_mm = 3.0
width_mm = 12.0
diameter_mm = 12.0
spindle_rpm = 6000.0
kc_N_mm2 = 900.0
"""


def make_job(folder: Path, process: str = MILLING) -> Job:
    """Write and read a job: 60 mm along y from where the arm stands in POSTURE, a waypoint every 2 mm."""
    arm = read_arm(ROOT / "robots" / "kuka_kr270")
    pose = Kinematics(arm).tip(POSTURE[None])[0]
    axis, place = -pose[:3, 2], pose[:3, 3] * 1e3
    lines = ["x_mm,y_mm,z_mm,i,j,k,feed_mm_s"]
    lines += [",".join(f"{v:.12g}" for v in (0.0, y, 0.0, *axis, FEED * 1e3)) for y in np.arange(0.0, 61.0, 2.0)]
    folder.mkdir(exist_ok=True)
    (folder / "line.csv").write_text("\n".join(lines))
    (folder / "job.toml").write_text(
        'schema = 1\nrobot = "kuka_kr270"\ntoolpath = "line.csv"\n'
        f"[part]\nposition_mm = {[float(v) for v in place]}\n[process]\n{process}"
        "[plan]\nmax_correction_mm = 10.0\ntolerance_mm = 0.1\n"
    )
    return read_job(folder / "job.toml")


def plan_rightly(job: Job) -> Rows:
    """Find the joint positions whose loaded tip stands on the path, by turning round what is left of the deviation."""
    cell, kinematics = SimulatedRobot(job.arm), Kinematics(job.arm)
    wanted, axis, n = job.path.position, job.path.axis, len(job.path.position)
    length = job.path.arc
    # slow at both ends, so that the arm starts and stops within its accelerations
    pace = FEED * np.minimum(1.0, 0.2 + np.minimum(length, length[-1] - length) / 0.02)
    time = np.r_[0.0, np.cumsum(np.diff(length) / np.minimum(pace[1:], pace[:-1]))]
    blank = Rows(time, np.tile(POSTURE, (n, 1)), wanted, axis, np.zeros((n, 6)), None)
    wrench = work_out(job, blank).wrench
    target = np.tile(kinematics.tip(POSTURE[None]), (n, 1, 1))
    target[:, :3, 3] = wanted
    q = blank.q
    for _ in range(8):
        q, _ = kinematics.reach(q, target)
        target[:, :3, 3] += wanted - cell.rest(q, wrench).position
    return Rows(time, q, wanted, axis, wrench, None)


def change(rows: Rows, **fields: Array) -> Rows:
    return Rows(**{**{name: getattr(rows, name) for name in Rows.__dataclass_fields__}, **fields})


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, Rows]:
    job = make_job(tmp_path_factory.mktemp("line"))
    return job, plan_rightly(job)


def breaches_of(job: Job, rows: Rows) -> list[str]:
    return list_breaches(job.table, examine(job, PLAN, rows), PLAN)


def test_a_right_plan_has_no_breach(right: tuple[Job, Rows]) -> None:
    job, rows = right
    found = examine(job, PLAN, rows)
    assert found["at_mm"] < 1e-6
    assert found["force_greatest_N"] > 100
    assert found["correction_mm"] > 0.05
    assert [b for b in list_breaches(job.table, found, PLAN) if "inside" not in b] == []
    for silent, word in (("notes", "no note"), ("between_waypoints_mm", "no between_waypoints_mm")):
        assert any(word in b for b in list_breaches(job.table, found, {**PLAN, silent: {}}))


def test_a_tip_beside_the_path_is_seen_at_and_between_waypoints(right: tuple[Job, Rows]) -> None:
    job, rows = right
    shifted = examine(job, PLAN, change(rows, q=rows.q + np.array([0, 2e-4, 0, 0, 0, 0])))
    for name in ("at_mm", "between_joint_mm", "between_cartesian_mm", "between_spline_mm"):
        assert 0.25 < shifted[name] < 0.6, name


def test_a_wanted_tip_beside_the_cam_path_is_seen_though_the_plan_reaches_it(right: tuple[Job, Rows]) -> None:
    job, rows = right
    lifted = change(rows, wanted=rows.wanted + np.array([0.0, 0.0, 2e-4]))
    assert any("off the CAM path" in b for b in breaches_of(job, lifted))


def test_a_correction_of_the_wrong_sign_doubles_the_deviation(right: tuple[Job, Rows]) -> None:
    job, rows = right
    kinematics = Kinematics(job.arm)
    target = kinematics.tip(rows.q)
    target[:, :3, 3] = 2 * rows.wanted - target[:, :3, 3]
    wrong, _ = kinematics.reach(rows.q, target)
    found = examine(job, PLAN, change(rows, q=wrong))
    assert found["at_mm"] == pytest.approx(2 * found["correction_mm"], rel=0.02)
    assert any(b.startswith("at waypoints") for b in list_breaches(job.table, found, PLAN))


def test_another_feed_than_the_force_was_planned_with_is_seen(right: tuple[Job, Rows]) -> None:
    job, rows = right
    found = examine(job, PLAN, change(rows, time=2 * rows.time))
    assert found["feed_least_share"] == pytest.approx(0.5 * examine(job, PLAN, rows)["feed_least_share"])
    assert found["force_off_N"] == pytest.approx(0.5 * np.linalg.norm(rows.wrench[:, :3], axis=1).max(), rel=1e-6)
    assert found["at_mm"] > 0.02


def test_waypoints_too_far_apart_are_seen_between_them_alone(tmp_path: Path) -> None:
    job = make_job(tmp_path, 'model = "constant"\nforce_N = [100.0, 200.0, 300.0]\n')
    rows = plan_rightly(job)
    ends = [0, len(rows) - 1]
    thinned = Rows(*(getattr(rows, name)[ends] for name in ("time", "q", "wanted", "axis", "wrench")), None)
    found = examine(job, PLAN, thinned)
    assert found["at_mm"] < 1e-6
    assert found["between_joint_mm"] > 0.1
    assert found["between_cartesian_mm"] < 0.01 * found["between_joint_mm"]


def test_motion_faster_than_the_limits_is_seen(right: tuple[Job, Rows]) -> None:
    job, rows = right
    assert any(b.startswith("acceleration") for b in breaches_of(job, change(rows, time=rows.time / 200)))


def test_a_path_that_ends_early_is_seen(right: tuple[Job, Rows]) -> None:
    job, rows = right
    short = Rows(*(getattr(rows, name)[:-3] for name in ("time", "q", "wanted", "axis", "wrench")), None)
    assert any(b.startswith("end of the path") for b in breaches_of(job, short))


def test_rows_on_a_path_out_and_back_are_placed_in_order(tmp_path: Path) -> None:
    job = read_job(write_jobs(tmp_path)["out_and_back"])
    path = job.path
    n = len(path.position)
    rows = Rows(np.arange(n) * 1.0, np.zeros((n, 6)), path.position, path.axis, np.zeros((n, 6)), None)
    placed = place_rows(path, rows)
    np.testing.assert_allclose(placed.arc, path.arc, atol=1e-9)
    np.testing.assert_array_equal(placed.cuts, ~path.rapid)


def test_approach_and_lifts_between_cuts_have_no_place_on_the_path(tmp_path: Path) -> None:
    job = read_job(write_jobs(tmp_path)["zigzag"])
    path, middle = job.path, 130
    above = np.array([0.0, 0.0, 80e-3])
    first, second = path.position[2 : middle + 1], path.position[middle + 1 : -1]
    start, again = path.position[1], path.position[middle]
    wanted = np.vstack([start + above, start, first, again + above, again, second])
    arrive = ["approach", "approach"]
    move = np.array([*arrive, *["cut"] * len(first), "retract", "approach", *["cut"] * len(second)])
    n = len(wanted)
    rows = Rows(np.arange(float(n)), np.zeros((n, 6)), wanted, np.tile(path.axis[0], (n, 1)), np.zeros((n, 6)), move)
    placed = place_rows(path, rows)
    assert placed.away[placed.on].max() < 1e-9
    np.testing.assert_array_equal(placed.cuts, move == "cut")


def test_a_ramp_within_one_long_move_counts_there(right: tuple[Job, Rows], tmp_path: Path) -> None:
    steep = 'model = "constant"\nforce_N = [0.0, 0.0, 400.0]\nramp_mm = 10.0\n'
    job = make_job(tmp_path, steep)
    rows = plan_rightly(job)
    ends = [0, len(rows) - 1]
    thinned = Rows(*(getattr(rows, name)[ends] for name in ("time", "q", "wanted", "axis", "wrench")), None)
    found = examine(job, PLAN, thinned)
    assert found["at_mm"] < 1e-6
    assert found["between_cartesian_mm"] > 0.5 * found["correction_mm"]


def test_rows_that_load_at_a_contact_are_judged_with_the_force_that_they_state(tmp_path: Path) -> None:
    job = make_job(tmp_path, 'model = "constant"\nforce_N = [0.0, 0.0, 400.0]\n')
    rows, kinematics = plan_rightly(job), Kinematics(job.arm)
    pose = kinematics.tip(POSTURE[None])
    pose[0, :3, 3] = rows.wanted[0]
    free, _ = kinematics.reach(rows.q[:1], pose)
    led = Rows(
        np.r_[-0.5, rows.time], np.vstack([free, rows.q]), np.vstack([rows.wanted[:1], rows.wanted]),
        np.vstack([rows.axis[:1], rows.axis]), np.vstack([np.zeros((1, 6)), rows.wrench]),
        np.array(["approach", *["cut"] * len(rows)]),
    )  # fmt: skip
    assert examine(job, PLAN, led)["at_mm"] < 1e-6
    late = led.wrench.copy()
    late[0] = rows.wrench[0]
    assert examine(job, PLAN, change(led, wrench=late))["at_mm"] > 0.1


def test_an_end_mill_cuts_as_deep_as_it_stands_in_the_stock_and_not_on_its_way_down(tmp_path: Path) -> None:
    job = make_job(tmp_path, MILLING + "stock_top_mm = 0.0\n")
    below = job.T_base_part[:3, 3] - np.outer([-0.001, 0.001, 0.0015, 0.004], job.R_base_part[:, 2])
    np.testing.assert_allclose(contact_share(job, np.zeros(4), 0.0, 1.0, below), [0.0, 1 / 3, 0.5, 1.0])
    axis = np.tile(job.R_base_part[:, 2], (3, 1))
    cut = Placed(*np.zeros((2, 3)), np.zeros(3), np.ones(3, int), *np.ones((2, 3), bool), *np.zeros((3, 3)))
    np.testing.assert_allclose(law(job, cut, below[1:], axis, np.full(3, FEED)), 0.0, atol=1e-9)


def test_joints_csv_is_read_with_its_units_and_moves(tmp_path: Path) -> None:
    arm = read_arm(ROOT / "robots" / "kuka_kr240_rail")
    header = ["time_s", "q1_mm", *(f"q{k}_deg" for k in range(2, 8)), "x_mm", "y_mm", "z_mm", "i", "j", "k", *WRENCH]
    with (tmp_path / "joints.csv").open("w", newline="") as stream:
        row = [0.5, 1500, *[90] * 6, 1, 2, 3, 0, 0, 1, *[7] * 6, "approach"]
        csv.writer(stream).writerows([[*header, "move"], row])
    rows = read_joints(tmp_path / "joints.csv", arm)
    np.testing.assert_allclose(rows.q[0], [1.5, *[np.pi / 2] * 6])
    np.testing.assert_allclose(rows.wanted[0], [1e-3, 2e-3, 3e-3])
    assert rows.move is not None and rows.move[0] == "approach"


def test_the_mean_force_of_a_slot_is_a_quarter_of_the_chip_across_the_travel() -> None:
    table = {"depth_mm": 2.0, "width_mm": 10.0, "diameter_mm": 10.0, "spindle_rpm": 6000.0, "kc_N_mm2": 800.0}
    force = milling({**table, "radial_ratio": 0.0}) * 0.05
    chip = 50.0 * 60.0 / 6000.0  # mm of feed a turn
    np.testing.assert_allclose(force[:3], [0.0, 800.0 * 2.0 * chip / 4, 0.0], atol=1e-9)


def test_a_clamped_tube_bends_by_the_textbook() -> None:
    stiffness = 70e9 * np.pi / 64 * (0.2**4 - 0.1**4)
    compliance = beam(1.5, 0.2, 0.1, 70e9, 26e9, axis="x")
    assert compliance[2, 2] == pytest.approx(1.5**3 / (3 * stiffness))
    assert compliance[4, 2] == pytest.approx(-(1.5**2) / (2 * stiffness))  # a push along z turns the tip about -y
    np.testing.assert_allclose(compliance, compliance.T)


def test_no_module_of_the_check_imports_the_product() -> None:
    for file in (ROOT / "benchmarks" / "plan_check").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] == "compplan"], file.name


def test_a_slab_through_the_tool_touches_it(tmp_path: Path) -> None:
    job = read_job(write_jobs(tmp_path)["slab"])
    job = replace(job, arm=replace(job.arm, shapes=()))  # the tool alone
    kinematics = Kinematics(job.arm)
    pose = np.eye(4)[None].copy()
    pose[0, :3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[0, :3, 3] = job.T_base_part[:3, 3]
    q, left = kinematics.reach(np.array([[0.0, 0.3, -1.8, 0.0, 0.5, 0.0]]), pose, rounds=100)
    assert left[0] < 1e-9
    found = least_clearance(job, kinematics, q)
    assert found is not None and found["least_mm"] < 5.0 and found["between"] == ("tool", "fixture")


def test_joint_torques_hold_the_wrench_by_virtual_work() -> None:
    arm = read_arm(ROOT / "benchmarks" / "plan_check" / "jobs" / "robots" / "parallelogram")
    q, wrench = np.array([[0.2, 0.3, 0.4, 0.3, 0.8, -0.5]]), np.array([[100.0, -200.0, 300.0, 10.0, 20.0, -30.0]])
    _, jacobian = Kinematics(arm).frames(q)
    held = SimulatedRobot(arm).torques(q, wrench, None)
    np.testing.assert_allclose(held[0], -jacobian[0].T @ wrench[0], rtol=1e-9)


def test_a_tool_weighs_though_the_folder_has_no_gravity() -> None:
    bare = read_arm(ROOT / "robots" / "kuka_kr270")
    at_tip = {"position_mm": [0.0, 0.0, 300.0], "mass_kg": 10.0, "centre_of_mass_mm": [0.0, 0.0, 300.0]}
    cell, q = SimulatedRobot(mount_tool(bare, at_tip)), POSTURE[None]
    weight = np.array([[0.0, 0.0, -98.1, 0.0, 0.0, 0.0]])
    heavy = cell.rest(q, np.zeros((1, 6))).position
    np.testing.assert_allclose(heavy, cell.rest(q, weight, weights=False).position, atol=1e-12)
    assert np.linalg.norm(heavy - cell.rest(q, np.zeros((1, 6)), weights=False).position) > 2e-5


def test_an_accelerated_carriage_bends_the_arm_like_gravity_turned_round() -> None:
    rail = read_arm(ROOT / "robots" / "kuka_kr240_rail")
    q = np.array([[1.5, 0.3, 1.0, -1.2, 0.2, 0.7, -0.3]])
    push = np.array([[2.0, 0, 0, 0, 0, 0, 0]])
    moved = SimulatedRobot(rail).rest(q, np.zeros((1, 6)), rate=np.zeros((1, 7)), change=push).position
    pulled = SimulatedRobot(replace(rail, gravity=np.array([0.0, -2.0, 0.0]))).rest(q, np.zeros((1, 6))).position
    np.testing.assert_allclose(moved, pulled, atol=1e-10)
    assert np.linalg.norm(moved - Kinematics(rail).tip(q)[:, :3, 3]) > 1e-5


def test_an_answer_is_judged_by_what_was_expected(tmp_path: Path) -> None:
    found = {"correction_mm": 1.0, "most_correction_mm": 10.0}
    solved = Outcome(0, "", 1.0, {"status": "solved"}, tmp_path)
    infeasible = Outcome(3, "", 1.0, {"status": "infeasible"}, tmp_path)
    assert judge_answer("solved", solved, [], found) == "trusted"
    assert judge_answer("solved", solved, ["x"], found).startswith("FAILS")
    assert judge_answer("refused", solved, [], found).startswith("FAILS")
    assert judge_answer("solved", infeasible, ["x"], found) == "honest"
    assert judge_answer("refused", infeasible, ["x"], found) == "trusted"
    assert judge_answer("refused", infeasible, [], {**found, "correction_mm": 11.0}).startswith("FAILS")
    wrong = {**found, "correction_mm": 700.0}
    assert judge_answer("refused", infeasible, [], wrong, planted=True) == "trusted"
    assert judge_answer("refused", solved, [], wrong, planted=True).startswith("FAILS")
    said = Outcome(2, "error: elasticity.toml: compliance 0.1 rad/(N m), at most 0.01", 1.0, None, tmp_path)
    assert judge_answer("refused", said, [], None) == "trusted"
    assert judge_answer("solved", said, [], None).startswith("FAILS")
    assert judge_answer("refused", replace(said, lines=12), [], None).startswith("FAILS")
    assert judge_answer("any", Outcome(1, "", 1.0, None, tmp_path), [], None).startswith("FAILS")
    assert judge_answer("any", Outcome(None, "", 1.0, None, tmp_path), [], None).startswith("FAILS")
