"""What a controller makes of a program: closed forms of drives, blends and speed; `compplan execute`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.executed.drives import lag_command
from compplan.executed.geometry import build_path, locate_nodes
from compplan.executed.instructions import read_instructions
from compplan.executed.run import execute_program
from compplan.executed.timing import limit_speed
from compplan.program.servo import read_motion
from compplan.robot import load_robot
from compplan.statics.ik import build_arm

HEAD = "move,x_mm,y_mm,z_mm,i,j,k,feed_mm_s,zone_mm\n"
CORNER = HEAD + "joint,700,0,300,0,0,1,200,0\nline,800,0,300,0,0,1,100,10\nline,800,100,300,0,0,1,100,0\n"


def test_a_lag_on_a_ramp_trails_by_its_time_times_the_rate() -> None:
    ramp = 0.3 * 0.004 * np.arange(500)[:, None]
    out = lag_command(ramp, np.array([0.05]), np.zeros(1), 0.004)
    assert ramp[-1, 0] - out[-1, 0] == pytest.approx(0.05 * 0.3, rel=1e-6)


def test_a_step_of_slope_is_answered_as_the_differential_equation_says() -> None:
    t = 0.004 * np.arange(100)
    out = lag_command(0.3 * t[:, None], np.array([0.05]), np.zeros(1), 0.004)[:, 0]
    assert np.abs(out - 0.3 * (t - 0.05 * (1 - np.exp(-t / 0.05)))).max() < 1e-12


def test_an_acceleration_residue_trails_a_parabola_by_itself_times_the_acceleration() -> None:
    t = 0.004 * np.arange(100)[:, None]
    out = lag_command(0.5 * 2.0 * t**2, np.zeros(1), np.array([1e-3]), 0.004)
    assert (0.5 * 2.0 * t**2 - out)[5:-5] == pytest.approx(2e-3, rel=1e-9)


def test_a_line_from_rest_to_rest_speeds_up_and_slows_down_with_the_acceleration_of_the_tip(tmp_path: Path) -> None:
    program = tmp_path / "p.csv"
    program.write_text(HEAD + "joint,700,0,300,0,0,1,200,0\nline,700,300,300,0,0,1,900,0\n")
    robot = load_robot("ur10")
    arm = build_arm(robot)
    path = build_path(locate_nodes(read_instructions(program, robot), arm), arm, 0.5)
    limits = np.full(6, 3.0), np.full(6, 1e3)
    motion = replace(read_motion(None, robot.prismatic, limits), acceleration=0.8)
    first = path.stops[-2] if len(path.stops) > 1 else 0
    run = np.linalg.norm(path.position - path.position[first], axis=1)[first:]
    tip = limit_speed(path, motion)[first:] * np.linalg.norm(np.gradient(path.position, path.s, axis=0), axis=1)[first:]
    early = (run > 0.02) & (run < 0.12)
    assert tip[early] == pytest.approx(np.sqrt(2.0 * 0.8 * run[early]), rel=0.02)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_blend_stays_in_its_zone_and_passes_the_corner_as_a_parabola_does(tmp_path: Path, share: float) -> None:
    program = tmp_path / "p.csv"
    program.write_text(CORNER)
    robot = load_robot("ur10")
    arm = build_arm(robot)
    path = build_path(locate_nodes(read_instructions(program, robot), arm), arm, share)
    corner, reach = np.array([0.8, 0.0, 0.3]), 0.01 * share
    away = np.linalg.norm(path.position - corner, axis=1)
    assert away.min() == pytest.approx(reach / (2 * np.sqrt(2)), rel=1e-6)  # half way to the chord
    outside = away > reach
    off = np.minimum(np.abs(path.position[:, 1]), np.abs(path.position[:, 0] - 0.8))
    assert off[outside].max() < 1e-9


def test_a_line_at_constant_speed_has_rows_of_constant_spacing(tmp_path: Path) -> None:
    program = tmp_path / "p.csv"
    program.write_text(HEAD + "joint,700,0,300,0,0,1,200,0\nline,700,300,300,0,0,1,100,0\n")
    executed = execute_program(program, load_robot("ur10"))
    step = np.linalg.norm(np.diff(executed.position, axis=0), axis=1)[150:-150]
    assert step == pytest.approx(0.1 * 0.004, rel=1e-4)
    assert executed.position[-1] == pytest.approx([0.7, 0.3, 0.3], abs=1e-7)
    assert np.abs(executed.position[:, 0] - 0.7).max() < 1e-7


def test_a_zone_of_zero_is_an_exact_stop_and_a_zone_is_not(tmp_path: Path) -> None:
    fastest = {}
    for zone in (0, 10):
        program = tmp_path / f"p{zone}.csv"
        program.write_text(CORNER.replace("100,10", f"100,{zone}"))
        executed = execute_program(program, load_robot("ur10"))
        speed = np.linalg.norm(np.diff(executed.position, axis=0), axis=1) / 0.004
        near = np.linalg.norm(executed.position[1:] - [0.8, 0.0, 0.3], axis=1) < 0.004
        fastest[zone] = speed[near].min()
    assert fastest[0] < 1e-3 and fastest[10] > 0.08


def test_executed_rows_are_at_most_four_milliseconds_apart(tmp_path, monkeypatch, capsys) -> None:
    program, out = tmp_path / "p.csv", tmp_path / "e.csv"
    program.write_text(CORNER)
    answer = run_command(["execute", program, "--robot", "ur10", "--out", out], monkeypatch, capsys)
    assert answer.status == 0 and "assumed of the controller" in answer.out
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table.dtype.names == ("time_s", *(f"q{j}_deg" for j in range(1, 7)), "x_mm", "y_mm", "z_mm")
    assert np.diff(table["time_s"]).max() < 0.004 + 1e-9


@pytest.mark.parametrize(
    ("text", "status", "says"),
    [
        (HEAD + "joint,700,0,300,0,0,1,200,0\n", 2, "expected at least 2"),
        (CORNER.replace("line,800,0", "arc,800,0"), 2, "p.csv:3: move is 'arc', expected joint or line"),
        (CORNER.replace(",100,10", ",-1,10"), 2, "feed_mm_s is -1"),
        (CORNER.replace("line,800,0,300", "line,9800,0,300"), 2, "p.csv:3: no joints within the limits"),
        (CORNER.replace("line,800,0,300", "line,,0,300"), 2, "needs all of x_mm y_mm z_mm"),
        (CORNER.replace("800,0,300,0,0,1", "800,0,300,0,0,3"), 2, "length 3, expected 1"),
        (HEAD + "joint,700,0,300,0,0,1,9,0\nline,-700,0,300,0,0,1,9,0\n", 3, "cannot be followed along a line"),
    ],
)  # fmt: skip
def test_what_is_no_program_is_refused_in_one_line(text, status, says, tmp_path, monkeypatch, capsys) -> None:
    program, out = tmp_path / "p.csv", tmp_path / "e.csv"
    program.write_text(text)
    answer = run_command(["execute", program, "--robot", "ur10", "--out", out], monkeypatch, capsys)
    assert answer.status == status and says in answer.err and answer.err.count("\n") == 1
    assert not out.exists()
