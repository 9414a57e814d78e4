"""What a controller makes of a program: closed forms of drives, blends and speed; `compplan execute`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from scipy.spatial.transform import Rotation

import compplan.controllers.writers
from compplan.controllers.motion.geometry import Nodes, build_path, locate_nodes
from compplan.controllers.motion.instructions import Instructions, read_instructions
from compplan.controllers.motion.run import execute_program, follow_command, lag_command, limit_speed
from compplan.controllers.readback.languages import read_fanuc, read_krl, read_rapid, read_val3
from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript
from compplan.controllers.writers import WRITERS, Program, build_program, kawasaki_as, widest_zone, write_program
from compplan.controllers.writers.motion_table import MotionTable, read_motion
from compplan.controllers.writers.zones import ZONES, find_zones
from compplan.robot import load_robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, refine_ik
from compplan.toolpath.readers.arcs import Arc

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


def test_lost_motion_leaves_a_joint_behind_whichever_way_it_goes() -> None:
    motion = read_motion(MotionTable(lost_motion_deg=(np.degrees(2e-4),)), np.array([False]), (np.ones(1), np.ones(1)))
    q = np.array([0.0, 0.01, 0.02, 0.03, 0.02, 0.01])[:, None]
    assert (follow_command(q, motion) - q)[:, 0] == pytest.approx([0.0, -1e-4, -1e-4, -1e-4, 1e-4, 1e-4], abs=1e-15)


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
        (CORNER.replace("line,800,0,300", "line,9800,0,300"), 2, "p.csv:3: no joint positions within the limits"),
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


def test_an_arc_keeps_its_radius_and_its_even_turn() -> None:
    robot = load_robot("ur10")
    arm = build_arm(robot)
    q = np.radians([[0.0, -100.0, -110.0, -60.0, 90.0, 0.0]])
    frames = locate_frames(arm.chain, q)
    start, turn = frames.tcp_position[0], frames.tcp_rotation[0]
    centre = start - np.array([0.05, 0.0, 0.0])
    angle = np.array([0.0, np.pi / 2])
    ends = centre + 0.05 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    turns = np.stack([turn, Rotation.from_euler("z", 10.0, degrees=True).as_matrix() @ turn])
    joints = refine_ik(arm, np.repeat(q, 2, axis=0), ends, turns)
    some = Instructions(Path("p"), np.arange(2), np.ones(2, bool), ends, ends, joints, np.full(2, 0.05), np.zeros(2))
    length = np.array([0.0, 0.05 * np.pi / 2])
    arc = Arc(tuple(centre), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.05, 0.05, np.pi / 2)
    path = build_path(Nodes(some, joints, ends, turns, length, {1: arc}), arm, 1.0)
    assert np.linalg.norm(path.position - centre, axis=1) == pytest.approx(0.05, abs=1e-9)
    done = np.unwrap(np.arctan2(*(path.position - centre).T[1::-1])) / (np.pi / 2)
    turned = Rotation.from_matrix(locate_frames(arm.chain, path.q).tcp_rotation @ turn.T).as_rotvec(degrees=True)
    assert turned[:, 2] == pytest.approx(10.0 * done, abs=1e-6)


@pytest.mark.parametrize(
    ("language", "says"),
    [("krl", "$APO.CDIS=0.1"), ("kawasaki_as", "ACCURACY {{ accuracy }} ALWAYS"), ("sinumerik", "G642")],
)
def test_zones_are_those_that_templates_say(language: str, says: str) -> None:
    assert says in (Path(compplan.controllers.writers.__file__).parent / "posts" / f"{language}.jinja").read_text()
    assert ZONES[language].size == 1e-4


def test_every_language_with_lines_has_its_zone() -> None:
    stated = {name for name, language in WRITERS.items() if hasattr(language, "ZONE")}
    assert set(WRITERS) - {"csv", "own"} == {*ZONES, *stated}
    assert ZONES["kawasaki_as"].size == pytest.approx(1e-3 * kawasaki_as.ACCURACY)
    assert widest_zone(("krl", "rapid")) is ZONES["rapid"]


def test_a_zone_that_grows_with_the_feed_is_half_the_way_of_the_smoothing() -> None:
    """30 mm/s over half of 40 ms; a corner between moves of 1 mm has half a millimetre."""
    for length, wanted in ((10e-3, 6e-4), (1e-3, 5e-4)):
        tcp = np.tile(np.eye(4), (3, 1, 1))
        tcp[1:, 0, 3], tcp[2, 1, 3] = length, length
        program = Program("corner", np.zeros((3, 6)), tuple("ABCDEF"), np.zeros(6, bool), np.array([0.0, 30.0, 30.0]),
                          np.array([True, False, False]), tcp=tcp, smoothing=0.04)  # fmt: skip
        assert find_zones(program, ZONES["fanuc_ls"])[0] == pytest.approx([0.0, wanted, 0.0])


def plan_bends(folder: Path, robot: str, place: str, tolerance: float, programs: list[str], motion: str = "") -> Path:
    """Write a job whose path bends by 7 deg to and fro, too little to be rounded as a corner."""
    heading = np.radians([0.0, 7.0, 0.0, 7.0, 0.0])
    corners = np.vstack([np.zeros(2), np.cumsum(6.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)])
    way = np.vstack([np.linspace(a, b, 7)[k > 0 :] for k, (a, b) in enumerate(pairwise(corners))])
    rows = np.column_stack([way, 0.0 * way[:, 0], np.full(len(way), 20.0)])
    np.savetxt(folder / "p.csv", rows, delimiter=",", header="x_mm,y_mm,z_mm,feed_mm_s", comments="")
    (folder / "job.toml").write_text(
        f'schema = 1\nrobot = "{robot}"\ntoolpath = "p.csv"\n[part]\nposition_mm = [{place}]\n'
        f'[plan]\ntolerance_mm = {tolerance}\n[process]\nmodel = "constant"\nforce_N = [0.0, 0.0, 0.0]\n'
        f"[output]\nprograms = {json.dumps(programs)}\n"
    )
    return folder / "job.toml"


def test_zones_are_smaller_where_the_language_s_own_would_take_a_quarter_of_the_tolerance(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    job = plan_bends(tmp_path, "abb_irb4600_60_205", "1400.0, 0.0, 600.0", 0.008, ["rapid"])
    answer = run_command(["plan", job, "--out", tmp_path / "out", "--json"], monkeypatch, capsys)
    found = json.loads(answer.out)
    assert found["status"] == "solved"
    text = "".join(file.read_text() for file in (tmp_path / "out").rglob("*.mod"))
    zones = {float(zone) for zone in re.findall(r"\[FALSE,([\d.]+)", text)}
    assert zones and min(zones) > 0.05 and max(zones) < 0.2  # z0 has 0.3


#: Postures of arms that bend the wrist. [deg]
POSTURES = {
    "krl": [0, -80, 100, 10, 60, 5], "rapid": [5, 10, 10, 10, 60, 5], "urscript": [5, -100, -110, -60, 90, 5],
    "fanuc_ls": [5, 10, 10, 10, 60, 5], "kawasaki_as": [5, 10, 80, 10, 60, 5], "val3": [5, 10, 80, 10, 60, 5],
    "sinumerik": [5, -80, 100, 10, 60, 5], "inform": [5, 10, 10, 10, 60, 5],
}  # fmt: skip


@pytest.mark.parametrize(
    ("language", "robot", "says", "read"),
    [
        ("krl", "kuka_kr16_2", "$APO.CDIS=0.0", read_krl),
        ("rapid", "abb_irb4600_60_205", "[FALSE,0.0", read_rapid),
        ("urscript", "ur10e", "r=0.0000", read_urscript),
        ("fanuc_ls", "fanuc_m20ia", "CNT", read_fanuc),
        ("kawasaki_as", "kawasaki_rs020n", "ACCURACY 0.0", read_kawasaki),
        ("sinumerik", "kuka_kr16_2", "G641 ADIS=0.0", read_sinumerik),
        ("inform", "yaskawa_gp25", "PL=0", read_inform),
        ("val3", "staubli_tx200", "mPath.leave=0.0", read_val3),
    ],
)
def test_a_corner_has_a_smaller_zone_or_an_exact_stop_and_is_read_back(
    language: str, robot: str, says: str, read, tmp_path: Path
) -> None:
    arm = build_arm(load_robot(robot))
    q = np.repeat(np.radians([POSTURES[language]]), 7, axis=0)
    frames = locate_frames(arm.chain, q)
    way = np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0], [12.0, 0.0], [12.0, 4.0], [12.0, 8.0], [12.0, 12.0]])
    place = frames.tcp_position + 1e-3 * np.column_stack([way, np.zeros(7)])
    q = refine_ik(arm, q, place, frames.tcp_rotation)
    assert np.abs(locate_frames(arm.chain, q).tcp_position - place).max() < 1e-9
    time, rapid = 0.2 * np.arange(7.0), np.r_[True, np.zeros(6, bool)]
    program = build_program(arm.robot, q, np.full(7, 0.02), rapid, name="bend", time=time)
    program = replace(program, tolerance=2e-6, form="linear", corner=np.full(7, 5e-6), cycle=0.004)
    files = {}
    for corner in (program.corner, None):
        folder = tmp_path / ("bound" if corner is not None else "free")
        folder.mkdir()
        write_program(replace(program, corner=corner), language, folder, any_brand=True)
        files[folder.name] = "".join(file.read_text() for file in sorted(folder.rglob("*")) if file.is_file())
    assert says in files["bound"] and files["bound"] != files["free"]
    if language == "rapid":  # z0 has a turn of 0.03 deg at 0.3 mm: a tenth of a degree a millimetre
        size, turn = re.search(r"\[FALSE,(0\.\d+),[^]]*,(\d\.\d+)\]", files["bound"]).groups()
        assert float(turn) == pytest.approx(0.1 * float(size), abs=1e-4)
    main = next(file for file in sorted((tmp_path / "bound").iterdir()) if not file.stem[-1].isdigit())
    moves = [move for move in read(main) if move.kind != "act"]
    assert len(moves) == 3 and moves[1].stops == (language == "inform")
