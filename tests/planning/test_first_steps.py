"""What somebody meets who starts: commands that are fast, names that are nearly right, files of another kind."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commandline import run_command

from compplan.io.notes import list_remarks, list_stops
from compplan.job.job import check_job
from compplan.job.questions import check_tool, describe_spindle
from compplan.planning.notes import describe_causes
from compplan.robot import load_robot, robot_folders
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.ik import build_arm, solve_branches
from compplan.toolpath.events import Event

JOB = {"schema": 1, "robot": "ur10", "toolpath": "part.nc"}


def test_the_command_line_chooses_the_threads_before_numpy_is_imported() -> None:
    words = "import sys, compplan.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


class Rows(SimpleNamespace):
    """Stands for a task of 100 waypoints."""

    def __len__(self) -> int:
        return 100


def slow_run() -> tuple[Any, Any]:
    """A run of 100 waypoints in 10 s: rests at 30, held by joint_2 at 60, slow from 50 to 94."""
    rests = np.zeros(100, bool)
    rests[30] = True
    share = np.r_[np.ones(28), [0.5, 0.4, 0.1, 0.4, 0.5], np.ones(17), np.full(45, 0.9), np.ones(5)]
    limiting = np.full(100, -1)
    limiting[60], share[60] = 1, 0.7
    task = Rows(
        nominal=SimpleNamespace(rapid=np.zeros(100, bool)), lead=np.zeros(100, bool), rests=rests,
        smoothing=0.105, robot=SimpleNamespace(joint_names=("joint_1", "joint_2")),
    )  # fmt: skip
    timing = SimpleNamespace(
        time=np.linspace(0.0, 9.9, 100), share=share, lowered=share < 0.995, limiting=limiting,
        by_velocity=np.ones(100, bool),
    )  # fmt: skip
    return task, timing


def test_a_slow_run_names_its_waypoints_and_the_limits_reached() -> None:
    said = describe_causes(*slow_run())
    assert said.startswith("The feed is lowered at 50 waypoints (28-32, 50-94), down to 10 % at waypoint 30: ")
    assert "by the velocity limit of joint_2, at corners, where the tool comes to rest, " in said


def test_a_cut_that_nowhere_reaches_its_feed_is_told() -> None:
    task, timing = slow_run()
    timing.share[:], timing.lowered[:], timing.feed = 0.5, True, np.full(100, 0.05)
    task.smoothing = 2.0  # all of the run is speeding up and slowing down
    assert describe_causes(task, timing).startswith("The programmed feed is not reached: at most 50 mm/s in a cut this")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["plna", "part.toml"], "error: no command named 'plna', did you mean plan or place; compplan --help"),
        (["doctor", "part.toml"], "if it is a job: compplan plan part.toml --out out"),
        (["doctor", "part.nc"], "part.nc: is a CAM file; compplan convert part.nc --out path.csv"),
        (["plan", "part.nc", "--out", "out"], "part.nc: is a CAM file, expected a job that ends in .toml; "),
        (["learn", "part.toml"], "error: MEASURED is missing; compplan learn --help shows an example"),
        (
            ["execute", "part.nc", "--robot", "ur10", "--out", "out.csv"],
            "part.nc: is not a program table; execute reads",
        ),
        (["plan", "part.csv", "--out", "out"], "part.csv: is a table, expected a job that ends in .toml"),
        (["doctor", "irb6640"], "no robot named 'irb6640', choose from ['abb_irb6640_185_280'] (42 robots in all)"),
        (["doctor", "kuka_kr16-2"], "choose from ['kuka_kr16_2'"),
        (["post", "part.nc", "--robot", "kuka", "--part", "1,2,3", "--program", "krl"], "no robot named 'kuka', "),
        (["post", "part.nc", "--robot", "ur5e", "--part", "1,2,3", "--program", "KRL"], "error: --program: krl is the"),
        (
            ["post", "part.nc", "--robot", "ur5e", "--part", "1e9,2,3", "--program", "csv"],
            "error: --part position_mm[0]",
        ),
        (["init", "log", "--robot", "ur5e", "--short"], "--short has no meaning in: compplan init log"),
    ],
)
def test_what_is_nearly_right_is_told_in_one_line_what_would_be(words, said, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    Path("part.nc").write_text("G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F600\nX20\n")
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and said in done.err and done.err.count("\n") == 1, done.err


@pytest.mark.parametrize("name", ["abb_irb6640_185_280", "kuka_kr16_2", "fanuc_m20ia", "yaskawa_gp50", "comau_nj220"])
def test_a_straight_tool_leaves_the_flange_along_the_last_axis(name: str) -> None:
    robot = load_robot(name)
    pose = mounted_tool(robot).copy()
    pose[:3, 3] = 0.15 * outward_axis(robot)
    q = np.radians([[10.0, -20.0, 30.0, 40.0, 50.0, 60.0], [10.0, -20.0, 30.0, 40.0, 50.0, -30.0]])
    frames = locate_frames(build_chain(robot.with_tool(pose)), q)
    plain = locate_frames(build_chain(robot), q)
    # the tip of a straight tool stays as the last joint turns, and lies where z of the frame points
    assert frames.tcp_position[0] == pytest.approx(frames.tcp_position[1], abs=1e-9)
    assert frames.tcp_position[0] == pytest.approx(plain.tcp_position[0] + 0.15 * plain.tcp_rotation[0][:, 2], abs=1e-9)


def test_every_robot_of_the_library_says_which_axis_leaves_its_flange() -> None:
    makers = {"abb": "x", "kuka": "x", "fanuc": "x", "yaskawa": "x"}
    for name in robot_folders():
        assert name_axis(outward_axis(load_robot(name))) == makers.get(name.split("_")[0], "z"), name


def test_a_new_job_stands_within_reach_with_a_tool_that_is_straight(tmp_path, monkeypatch, capsys) -> None:
    name = "kuka_kr16_2"
    monkeypatch.chdir(tmp_path)
    Path("part.nc").write_text("G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F600\nX60\nY40\nX0\nY0\n")
    words = ["init", "part.toml", "--robot", name, "--toolpath", "part.nc", "--short"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0 and "the part is at [" in done.out and "(assumed: amid the places" in done.out, done.err
    text = Path("part.toml").read_text()
    data = tomllib.loads(text)
    assert set(data) == {"schema", "name", "robot", "toolpath", "part", "tool", "process", "plan", "output"}
    assert data["tool"]["position_mm"] == [0.0, 0.0, 150.0] and data["tool"]["frame"] == "pendant"
    assert "put yours" in text.partition("position_mm")[2].partition("\n")[0] and len(text.splitlines()) < 45
    assert "corners of the cut" not in text  # goes on with a line that --short leaves out
    job = check_job(data, tmp_path / "part.toml")
    assert job.tool is not None and not check_tool(job, load_robot(name))
    robot = job.tool.mount(load_robot(name))
    around = np.array([[0, 0, -1], [60, 0, -1], [60, 40, -1], [0, 40, -1]])
    corners = 1e-3 * (np.array(job.part.position_mm) + around)
    turns = np.radians(np.arange(0.0, 360.0, 20.0))
    down = np.array([[[np.cos(a), np.sin(a), 0.0], [np.sin(a), -np.cos(a), 0.0], [0.0, 0.0, -1.0]] for a in turns])
    q = solve_branches(build_arm(robot), corners.repeat(len(turns), axis=0), np.tile(down, (4, 1, 1)))
    inside = ((q > robot.lower) & (q < robot.upper)).all(axis=2).reshape(4, -1)
    assert inside.any(axis=1).all()


def test_a_tool_that_leaves_the_flange_sideways_is_asked_about() -> None:
    job = {**JOB, "robot": "kuka_kr16_2", "tool": {"position_mm": [0.0, 0.0, 150.0]}}
    kuka, ur = load_robot("kuka_kr16_2"), load_robot("ur10")
    (note,) = check_tool(check_job(job), kuka)
    assert "90 deg away from the direction x" in note and "compplan init --robot kuka_kr16_2 writes" in note
    assert not check_tool(check_job({**job, "collision": {"tool": "spindle.stl"}}), kuka)
    assert not check_tool(check_job({**JOB, "tool": {"position_mm": [0.0, 0.0, 150.0]}}), ur)  # z leaves a ur10
    (note,) = check_tool(check_job({**JOB, "tool": {"position_mm": [280.0, 0.0, 30.0]}}), ur)
    assert "The tip lies 83.9 deg aside of the direction z" in note
    (note,) = check_tool(check_job({**JOB, "tool": {"position_mm": [0.0, 0.0, 1200.0]}}), ur)
    assert list_stops(["a remark", note]) == [note] and list_remarks(["a remark", note]) == ["a remark"]
    assert "1200 mm long" in note and "tool.position_mm in mm" in note


def test_a_cut_that_nothing_turns_the_spindle_for_is_told() -> None:
    job = check_job({**JOB, "process": {"model": "end_mill", "diameter_mm": 8.0, "teeth": 2, "spindle_rpm": 9000.0,
                                        "material": "al6082_t6"}})  # fmt: skip
    task: Any = SimpleNamespace(nominal=SimpleNamespace(events=(Event(-1, "tool", 1.0),)))
    assert "never starts the spindle (no M3 or M4)" in describe_spindle(task.nominal, job)
    task.nominal.events = (Event(0, "spindle_cw", 9000.0),)
    assert not describe_spindle(task.nominal, job) and not describe_spindle(
        task.nominal, check_job({**JOB, "toolpath": "path.csv"})
    )
