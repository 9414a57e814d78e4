"""`compplan trace`: an emulated controller is found again, and told from the faults of its log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from executed_emulator import SimulatedRobot, emulate, write_log, write_program, zigzag
from scipy.ndimage import uniform_filter1d

from compplan.controllers.motion.align import find_nearest, measure_way, place_rows
from compplan.controllers.motion.geometry import Path as Laid
from compplan.controllers.motion.log import read_log
from compplan.controllers.motion.run import execute_program
from compplan.controllers.writers.joint_convention import load_controller, to_controller
from compplan.controllers.writers.motion_table import MotionTable, read_motion, tabulate_motion
from compplan.robot import load_robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm

CELL = SimulatedRobot(zone_share=0.8, lag=np.array([0.03, 0.025, 0.02, 0.015, 0.012, 0.01]))


def draw(
    folder: Path, name: str, feed: float, seed: int, cell: SimulatedRobot = CELL, **careless: float
) -> tuple[Path, Path]:
    """Write program and log of a zigzag."""
    points = zigzag(seed, 16)
    program = write_program(folder / f"p{name}.csv", points, feed, 0.005)
    return program, write_log(folder / f"l{name}.csv", *emulate(points, feed, 0.005, cell), seed=seed, **careless)


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trace two programs at two speeds."""
    folder = tmp_path_factory.mktemp("trace")
    p1, l1 = draw(folder, "1", 0.1, 1, torn=0.02, begin=0.3, clock=1000.0)
    p2, l2 = draw(folder, "2", 0.15, 2, torn=0.02, missing=0.03, late=0.4)
    with pytest.MonkeyPatch.context() as patch:
        words = ["trace", l1, l2, "--program", p1, "--program", p2, "--robot", "ur10", "--out", folder / "out"]
        patch.setattr("sys.argv", ["compplan", *map(str, words)])
        from compplan.cli.application import main

        with pytest.raises(SystemExit) as leaving:
            main()
    assert not leaving.value.code
    return folder


def test_the_model_leaves_at_most_a_third_on_logs_left_out(traced: Path) -> None:
    found = json.loads((traced / "out" / "trace.json").read_text())
    assert found["written"] and found["held_out"] == "log"
    for name in ("median", "p95"):
        assert found["left_mm"][name] < found["left_without_model_mm"][name] / 3
    assert found["parts"]["lag"] > found["parts"]["blend"] > found["parts"]["jitter"]
    assert sum(found["parts"].values()) == pytest.approx(1.0, abs=0.1)


def test_a_motion_is_stated_in_ms_mm_and_degrees_and_read_back_in_si() -> None:
    slides = np.array([True, False])
    table = MotionTable(
        cycle_ms=4.0, acceleration_mm_s2=2500.0, smoothing_ms=30.0, lag_ms=[12.0, 8.0],
        acceleration_lag_ms2=[150.0, -90.0], lost_motion_deg=[0.02, 0.01],
    )  # fmt: skip
    motion = read_motion(table, slides, (np.ones(2), np.full(2, np.inf)), Path("controller.toml"))
    assert (motion.cycle, motion.smoothing, motion.acceleration) == pytest.approx((4e-3, 3e-2, 2.5))
    assert motion.lag == pytest.approx([12e-3, 8e-3])
    assert motion.acceleration_lag == pytest.approx([1.5e-4, -9e-5])
    assert motion.lost_motion == pytest.approx([2e-5, np.radians(0.01)])
    stated = tabulate_motion(motion, slides)
    assert MotionTable.model_validate(stated) == table


def test_drawn_zone_and_lags_are_found(traced: Path) -> None:
    motion = json.loads((traced / "out" / "trace.json").read_text())["motion"]
    assert motion["blend_share"] == pytest.approx(0.8, abs=0.12)
    spread = np.array(motion["lag_ms"])[:4] - 1e3 * CELL.lag[:4]
    assert np.abs(spread - spread.mean()).max() < 4.0 and abs(spread.mean()) < 10.0


def test_another_path_at_another_speed_is_executed_three_times_nearer(traced: Path) -> None:
    points = zigzag(7, 16)
    program = write_program(traced / "p7.csv", points, 0.12, 0.005)
    _, q = emulate(points, 0.12, 0.005, CELL)
    robot = load_robot("ur10")
    arm = build_arm(robot)
    tip = locate_frames(arm.chain, q[::20]).tcp_position
    left = {}
    for name, folder in (("model", load_robot(traced / "out" / "robot")), ("none", None)):
        path = points if folder is None else execute_program(program, folder).position
        index = ((tip[:, None] - path) ** 2).sum(axis=2).argmin(axis=1)
        near, _ = find_nearest(path, index, tip, 3)
        left[name] = np.percentile(np.linalg.norm(tip - near, axis=1), [50, 95])
    assert (left["model"] < left["none"] / 3).all()


def test_a_log_of_a_drive_that_follows_exactly_is_no_lag(tmp_path, monkeypatch, capsys) -> None:
    exact = SimulatedRobot(zone_share=0.0, lag=np.full(6, 1e-3), noise=0.0, acceleration=50.0)
    program, log = draw(tmp_path, "0", 0.02, 3, exact, torn=0.05, noise=0.0)
    words = ["trace", log, "--program", program, "--robot", "ur10", "--out", tmp_path / "out", "--json"]
    answer = run_command(words, monkeypatch, capsys)
    found = json.loads(answer.out)
    assert found["left_mm"]["p95"] <= found["left_without_model_mm"]["p95"] + 1e-3
    if found["written"]:
        assert found["motion"]["blend_share"] < 0.05
    else:
        old = Path("robots/ur10/controller.toml").read_text()
        assert (tmp_path / "out" / "robot" / "controller.toml").read_text() == old
    assert found["logs"][0]["torn_readings"] > 0


def test_a_log_is_found_in_its_own_layer_of_many_though_cut_corners_shorten_its_way() -> None:
    corner = np.array([(0.06 * ((k + 1) // 2 % 2), 0.008 * (k // 2), 0.0) for k in range(16)])
    corners = np.concatenate([corner + np.array([0.0, 5e-4 * (k % 7), -2e-4 * k]) for k in range(10)])
    at = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    s = np.arange(0.0, at[-1], 1e-3)
    points = np.stack([np.interp(s, at, column) for column in corners.T], axis=1)
    none = np.zeros((len(s), 6))
    path = Laid(s, none, points, np.full(len(s), 0.1), np.array([0, len(s) - 1]), none, none, s)
    tip = uniform_filter1d(points, 9, axis=0)[::2]
    s_found, point = place_rows(path, tip, measure_way(0.004 * np.arange(len(tip)), tip, 0.01))
    assert np.abs(s_found - s[::2]).max() < 3e-3
    assert np.median(np.linalg.norm(tip - point, axis=1)) < 1e-6


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,q1_deg\n0,1\n", "has 1 columns q1"),
        ("time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,1,2,3,4,5,6\n", "50 are needed"),
        ("q1_deg\n1\n", "missing column time"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(text, says, tmp_path, monkeypatch, capsys) -> None:
    program = write_program(tmp_path / "p.csv", zigzag(1, 5), 0.1, 0.005)
    (tmp_path / "l.csv").write_text(text)
    words = ["trace", tmp_path / "l.csv", "--program", program, "--robot", "ur10", "--out", tmp_path / "out"]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 2 and says in answer.err and answer.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_log_of_another_program_is_refused(tmp_path, monkeypatch, capsys) -> None:
    _, log = draw(tmp_path, "1", 0.2, 1)
    program = write_program(tmp_path / "p.csv", zigzag(1, 5) + np.array([0.0, 0.0, 0.2]), 0.1, 0.005)
    words = ["trace", log, "--program", program, "--robot", "ur10", "--out", tmp_path / "out"]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 2 and "is it the log of this program" in answer.err


@pytest.mark.parametrize("between", [" ", ","])
def test_a_recording_of_rtde_is_read_by_its_own_names_and_units(tmp_path, between) -> None:
    t = 0.002 * np.arange(80)
    q = np.stack([0.1 * j + 0.3 * t for j in range(6)], axis=1)
    head = ["timestamp", *(f"actual_q_{j}" for j in range(6)), *(f"target_q_{j}" for j in range(6)), "robot_mode"]
    rows = np.column_stack([t, q, q, np.full(80, 7.0)])
    file = tmp_path / "l.csv"
    np.savetxt(file, rows, delimiter=between, header=between.join(head), comments="", fmt="%.9f")
    log = read_log(file, load_robot("ur10"))
    assert log.raw == pytest.approx(q, abs=1e-8) and log.cycle == pytest.approx(0.002)
    assert any("robot_mode" in note for note in log.notes)


@pytest.mark.parametrize(
    ("clock", "size", "joint"),
    [
        ("header.tm", 1e3, lambda j: f"feedBack.joints.joints[{j}]"), ("timestamp", 1.0, lambda j: f" J{j + 1}"),
        ("IPOC", 1e3, lambda j: f"AIPos.A{j + 1}"), ("IPOC", 1e3, lambda j: f"AIPos_A{j + 1}"),
    ],
)  # fmt: skip
def test_exports_of_other_makes_are_read_in_the_counting_of_the_controller(tmp_path, clock, size, joint) -> None:
    robot = load_robot("kuka_kr240")
    counting = load_controller(robot)
    assert not np.allclose(counting.matrix, np.eye(6)) or counting.zero.any()
    t = 0.004 * np.arange(80)
    q = np.stack([0.1 * j + 0.3 * t for j in range(6)], axis=1)
    head = ",".join([clock, *map(joint, range(6)), "cmd_num"])
    file = tmp_path / "l.csv"
    rows = np.column_stack([size * t, to_controller(counting, q), np.ones(80)])
    np.savetxt(file, rows, delimiter=",", header=head, comments="", fmt="%.9f")
    log = read_log(file, robot)
    assert log.raw == pytest.approx(q, abs=1e-8) and log.cycle == pytest.approx(0.004)


def test_rows_out_of_order_and_repeated_are_told(tmp_path) -> None:
    _, file = draw(tmp_path, "1", 0.2, 1)
    lines = file.read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    file.write_text("\n".join([*lines, lines[-1]]) + "\n")
    log = read_log(file, load_robot("ur10"))
    assert any("rows are out of order" in note for note in log.notes) and any("repeat" in note for note in log.notes)
