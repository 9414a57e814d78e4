"""Inputs that once ended in an internal fault, a hang, a wrong refusal or an answer without a reason."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commandline import run_command

import compplan as cp
from compplan.simulation.exact_model import read_exact_robot

ROOT = Path(__file__).parents[2]
GOOD = ROOT / "tests" / "bad_inputs" / "good"
JOB = """schema = 1
name = "job"
robot = "{robot}"
toolpath = {toolpath}
[part]
position_mm = [1700.0, 0.0, 900.0]
[process]
model = "constant"
force_N = [0.0, 0.0, -100.0]
frame = "base"
[plan]
strategy = "none"
rotate_about_tool_axis = false
tolerance_mm = {tolerance}
{more}
"""
CIRCLE = '{ generator = "circle", radius_mm = 10.0, feed_mm_s = 10.0, waypoints = 20 }'


def write_job(
    folder: Path, *, robot: str = "kuka_kr270", toolpath: str = CIRCLE, tolerance: float = 10.0, more: str = ""
) -> Path:
    file = folder / "job.toml"
    file.write_text(JOB.format(robot=robot, toolpath=toolpath, tolerance=tolerance, more=more))
    return file


# ---- reading back, reasons and next steps


def test_a_joint_table_of_a_robot_without_controller_toml_is_confirmed(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "robots" / "kuka_kr270", tmp_path / "arm")
    (tmp_path / "arm" / "controller.toml").unlink()
    job = write_job(tmp_path, robot="arm", more='[output]\nprograms = ["csv"]')
    cp.plan(job, out=tmp_path / "out")
    written = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert written["status"] == "solved", written["verdict"]["sentence"]


@pytest.mark.parametrize("spacing", ["step_mm = 2.0", "waypoints = 90"])
def test_a_z_level_cone_is_read_a_second_time(spacing: str, tmp_path: Path) -> None:
    cone = 'generator = "isf_cone", diameter_mm = 60.0, depth_mm = 3.0, wall_angle_deg = 60.0, pitch_mm = 1.0'
    path = f'{{ {cone}, path = "z_level", approach_mm = 5.0, feed_mm_s = 10.0, {spacing} }}'
    plan = cp.plan(write_job(tmp_path, toolpath=path))
    assert plan.status == "solved", plan.explain_failures()
    assert plan.verdict.word == "keeps", plan.verdict.sentence


@pytest.mark.parametrize("tolerance", [0.1, 10.0])
def test_a_plan_that_is_not_confirmed_says_why_and_what_is_next(
    tolerance: float, tmp_path: Path, monkeypatch, capsys
) -> None:
    (tmp_path / "part.nc").write_text(
        "G21 G90 G54\nG0 X0 Y0 Z20\nM3 S1000\nG1 Z0 F600\nG1 X20\nG0 Z20\nG81 X30 Y10 Z-5 R2 F100\nG80\nG0 Z20\nM30\n"
    )
    job = write_job(tmp_path, toolpath='"part.nc"', tolerance=tolerance, more='[cam]\ncycles = "skip"')
    done = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    written = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert done.status == 3 and written["status"] == "not_confirmed"
    reason = "holes of the file are not cut"
    assert reason in written["failure"] and any(reason in note for note in written["notes"])
    assert any(reason in note for note in written["stops"])
    assert reason in done.out and reason in done.err
    for told in (done.out, written["verdict"]["sentence"], written["verdict"]["change"]):
        assert "campaign" not in told and "Measure the robot" not in told, told


#: Where J5 of a FANUC M-10iA passes 0 within the circle.
AT_J5 = {"position_mm": [1107.379771487231, 333.5690009526589, 1071.3402924623526],
         "rotation_deg": [28.59656784745332, -77.0481077999807, 3.590332760943537]}  # fmt: skip


def test_a_circle_through_a_wrist_singularity_is_written_with_a_joint_move_and_confirmed(tmp_path: Path) -> None:
    """J5 passes 0 within the cut: the program swings over by a joint move at the speed of the plan."""
    circle = '{ generator = "circle", radius_mm = 120.0, feed_mm_s = 100.0, waypoints = 40 }'
    job = write_job(tmp_path, robot="fanuc_m10ia", toolpath=circle, more='[output]\nprograms = ["fanuc_ls"]')
    search = {"strategy": "nlp", "rotate_about_tool_axis": True, "start_deg": [16.8, 23.9, 14.3, 0.0, 0.0, -17.3]}
    plan = cp.plan(job, part=AT_J5, plan=search, out=tmp_path / "out")
    assert plan.status == "solved", plan.explain_failures()
    program = (tmp_path / "out" / "JOB_L.LS").read_text()
    swing = program[program.index("!the configuration changes") :].splitlines()[1]
    assert ":J P[" in swing and " 20% " not in swing, swing
    assert "CONFIG : 'N" in program and "CONFIG : 'F" in program


# ---- one rule for all commands


def test_to_frame_without_pandas_names_the_extra(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    plan = cp.plan(write_job(tmp_path))
    with pytest.raises(cp.InputError, match=r"compplan\[frames\]"):
        plan.to_frame()


@pytest.mark.parametrize("verb", ["plan", "compare"])
def test_a_path_without_a_part_frame_is_refused_in_python_as_on_the_command_line(
    verb: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    (tmp_path / "part.nc").write_text("G21 G90 G54\nG0 X0 Y0 Z20\nG1 Z0 F600\nG1 X20\nM30\n")
    for source in (tmp_path / "part.nc", {"position_mm": [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]], "feed_mm_s": 20.0}):
        with pytest.raises(cp.InputError, match="part frame"):
            getattr(cp, verb)(source, robot="kuka_kr270")
    words = ["post", tmp_path / "part.nc", "--robot", "kuka_kr270", "--program", "krl", "--out", tmp_path / "out"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and "--part" in done.err


FOLDERS = {
    "compare": "job.toml", "map": "kuka_kr270 --points 2", "identify": "log.csv --robot kuka_kr270",
    "forces": "job.toml", "plan": "job.toml", "post": "part.nc --robot kuka_kr270 --part 1700,0,900 --program krl",
    "diagnose": "log.csv --robot kuka_kr270", "place": "job.toml", "reproduce": "dumas2011",
}  # fmt: skip


@pytest.mark.parametrize("command", sorted(FOLDERS))
def test_every_command_that_writes_a_folder_writes_to_out(command: str, monkeypatch, capsys) -> None:
    help_text = run_command([command, "--help"], monkeypatch, capsys).out
    assert "default: out" in " ".join(help_text.split()), help_text


def test_a_plan_without_out_is_written_to_out(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    done = run_command(["plan", write_job(tmp_path)], monkeypatch, capsys)
    assert done.status == 0 and (tmp_path / "out" / "plan.json").is_file(), done.err


def test_an_unknown_robot_is_refused_with_the_same_words_everywhere(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write_job(tmp_path)
    (tmp_path / "log.csv").write_text("q1_deg\n0\n")
    (tmp_path / "part.nc").write_text("G21 G0 X0 Y0 Z0\nG1 X1 F60\n")
    lines = [
        "plan job.toml --robot nope", "post part.nc --robot nope --part 1,0,0 --program krl", "map nope",
        "predict log.csv --robot nope --out p.csv", "diagnose log.csv --robot nope", "doctor nope",
    ]  # fmt: skip
    told = {run_command(line.split(), monkeypatch, capsys).err for line in lines}
    with pytest.raises(cp.InputError) as refused:
        cp.plan(write_job(tmp_path), robot="nope")
    with pytest.raises(cp.InputError) as posted:
        cp.post("part.nc", robot="nope", part=[1.0, 0.0, 0.0], program="krl")
    assert told == {f"error: {refused.value}\n"} and str(posted.value) == str(refused.value)


# ---- faults that paths, robots and signals led to


@pytest.mark.parametrize("strategy", ["none", "nlp"])
def test_a_path_that_turns_back_each_millimetre_is_planned(strategy: str) -> None:
    there_and_back = {"x_mm": [0.0, 1.0] * 15, "y_mm": 0.0, "z_mm": 0.0, "feed_mm_s": 20.0}
    plan = cp.plan(there_and_back, robot="kuka_kr270", part=(1700, 0, 900), plan={"strategy": strategy})
    assert plan.status == "solved", plan.explain_failures()


#: A pass of a pocket without area: there and back, with places that stand twice and feeds of two kinds.
POCKET = """G21 G90 G54
G0 X-4.775 Y-2.9 Z5
G1 Z-1 F300
{cuts}
G0 Z5
M30
"""
END_MILL = {"model": "end_mill", "diameter_mm": 6.0, "teeth": 2, "spindle_rpm": 12000.0, "material": "al6082_t6",
            "stock": {"block_mm": [[-30.0, -30.0, -10.0], [30.0, 30.0, 0.0]]}}  # fmt: skip


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "cuts", ["G1 X4.775 F600\nX-4.775", "X4.775\nX4.775\nX-4.775\nX-4.775", "G93\nX4.775 F120\nX-4.775 F120\nG94"]
)
def test_a_pass_without_area_is_planned(cuts: str, tmp_path: Path) -> None:
    (tmp_path / "pocket.nc").write_text(POCKET.format(cuts=cuts))
    search = {"tolerance_mm": 0.5, "rotate_about_tool_axis": False}
    plan = cp.plan(tmp_path / "pocket.nc", robot="kuka_kr240", part=(1700, 0, 900), process=END_MILL, plan=search)
    assert plan.status == "solved", plan.explain_failures()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_feeds_that_differ_by_five_decades_give_no_warning_and_no_fault() -> None:
    """A running mean over 10,000 rows turned negative by rounding, its power NaN, and so the times of the run."""
    path = {"x_mm": [-4.775, 4.775] * 2, "y_mm": -2.9, "z_mm": -1.0, "feed_mm_s": [0.01, 1e3, 0.1, 1e3]}
    plan = cp.plan(path, robot="kuka_kr240", part=(1700, 0, 900), plan={"tolerance_mm": 0.5})
    assert plan.status == "solved", plan.explain_failures()


@pytest.mark.parametrize("flange", ["base_link", "link_3"])
def test_a_flange_above_the_joints_is_refused(flange: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "robots" / "kuka_kr270", tmp_path / "arm")
    file = tmp_path / "arm" / "elasticity.toml"
    lines = [line for line in file.read_text().splitlines() if not line.startswith("flange")]
    at = next(number for number, line in enumerate(lines) if line.startswith("tcp"))
    file.write_text("\n".join([*lines[: at + 1], f'flange = "{flange}"', *lines[at + 1 :]]) + "\n")
    with pytest.raises(cp.InputError, match=r"elasticity\.toml: flange: .*joint_6"):
        cp.load_robot(tmp_path / "arm")


#: Sends SIGTERM to this process while a module is imported; the import fails by it, as those of compiled modules do.
TERMINATED = """
import os, signal, sys, time
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "scipy.spatial":
            try:
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(1.0)
            except SystemExit:
                raise ImportError("initialization failed") from None
sys.meta_path.insert(0, Finder())
from compplan.cli import main
main(["map", "kuka_kr270", "--points", "5"])
"""


def test_a_signal_during_imports_ends_the_run_without_an_internal_fault(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", TERMINATED], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 143 and done.stderr == "", done.stderr


def test_a_program_that_leads_nowhere_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    row = "joint,0,-100,-110,-60,90,0,100"
    head = "move,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,feed_mm_s"
    (tmp_path / "program.csv").write_text("\n".join([head, row, row, row]) + "\n")
    words = ["execute", tmp_path / "program.csv", "--robot", "ur10", "--out", tmp_path / "out.csv"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and "program.csv:4: no row moves the tool" in done.err and done.err.count("\n") == 1


# ---- numbers that no measurement or path holds


@pytest.mark.parametrize("value", [1e13, -1e300])
def test_numbers_beyond_1e12_are_refused_at_the_table(value: float, tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text(f"x_mm,y_mm,z_mm,feed_mm_s\n0,0,0,20\n{value:g},0,0,20\n")
    with pytest.raises(cp.InputError, match=r"path\.csv:3: column 'x_mm'.*at most 1e\+12"):
        cp.read_toolpath(tmp_path / "path.csv")
    with pytest.raises(cp.InputError, match=r"x_mm.*at most 1e\+12"):
        cp.read_toolpath({"x_mm": [0.0, value], "y_mm": 0.0, "z_mm": 0.0, "feed_mm_s": 20.0})


INSTRUMENT = "schema = 1\n[instrument]\n{key}\n"


@pytest.mark.parametrize("key", ["sigma_mm = 1e-300", "position_mm = [1e9, 0, 0]", "position_mm = [0, 0, -1e9]"])
def test_an_instrument_that_cannot_be_is_refused(key: str, tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "instrument.toml").write_text(INSTRUMENT.format(key=key))
    joints = ",".join(f"q{k}_deg" for k in range(1, 7))
    (tmp_path / "log.csv").write_text(f"{joints},contact\n" + "0,-90,90,0,30,0,a\n" * 4)
    words = ["diagnose", tmp_path / "log.csv", "--robot", "kuka_kr270", "--instrument", tmp_path / "instrument.toml"]
    done = run_command([*words, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and f"instrument.{key.split()[0]}" in done.err and done.err.count("\n") == 1, done.err


@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("robot/uncertainty.toml", "scale_mm = 300.0", "scale_mm = 5e-324", "unexplained.scale_mm"),
        ("robot/effects.toml", 'joint = "joint_1"', 'joint = "jo_1"', "effect[0].joint"),
        ("robot/elasticity.toml", "repeatability_mm    = 0.017", "repeatability_mm    = 1e13", "at most 1e+12"),
        ("job.toml", "max_correction_mm = 10.0", "max_correction_mm = 1e300", "at most 1e+12"),
        ("job.toml", "tolerance_mm = 0.1", "tolerance_mm = 5e-324", "plan.tolerance_mm"),
    ],
)
def test_nonsense_in_a_table_is_refused_in_one_line(
    file: str, old: str, new: str, told: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    shutil.copytree(GOOD, tmp_path / "good")
    text = (tmp_path / "good" / file).read_text()
    assert old in text
    (tmp_path / "good" / file).write_text(text.replace(old, new))
    done = run_command(["plan", tmp_path / "good" / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and told in done.err and Path(file).name in done.err, done.err
    assert done.err.count("\n") == 1 and "internal fault" not in done.err


def test_a_trace_in_radians_is_not_read_as_degrees(tmp_path: Path, monkeypatch, capsys) -> None:
    head, *rows = (GOOD / "executed.csv").read_text().splitlines()
    turned = [[row.split(",")[0], *(f"{float(q) / 57.29577951308232:.7f}" for q in row.split(",")[1:])] for row in rows]
    (tmp_path / "log.csv").write_text("\n".join([head, *map(",".join, turned)]) + "\n")
    words = ["trace", tmp_path / "log.csv", "--program", GOOD / "program.csv", "--robot", "ur10", "--out"]
    done = run_command([*words, tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and "log.csv" in done.err and done.err.count("\n") == 1, done.out + done.err


@pytest.mark.parametrize("line", ["learn job.toml measured.csv --robot robot", "campaign job.toml --poses 3"])
def test_a_standard_deviation_below_a_nanometre_is_refused_on_the_command_line(line: str, monkeypatch, capsys) -> None:
    monkeypatch.chdir(GOOD)
    done = run_command([*line.split(), "--sigma-mm", "1e-300"], monkeypatch, capsys)
    assert done.status == 2 and "--sigma-mm" in done.err and "1e-06" in done.err, done.err
    assert done.err.count("\n") == 1


def test_a_standard_deviation_below_a_nanometre_is_refused_in_measured_points(monkeypatch, capsys, tmp_path) -> None:
    (tmp_path / "measured.csv").write_text("x_mm,y_mm,z_mm,sigma_mm\n0,0,0,0.02\n1,0,0,1e-300\n")
    words = ["learn", GOOD / "job.toml", tmp_path / "measured.csv", "--robot", GOOD / "robot"]
    done = run_command([*words, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and "measured.csv:3: sigma_mm is 1e-300, expected 1e-06" in done.err, done.err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('effort="', 'effort="1e300" was="', "limit effort is '1e300'"),
        ('<axis xyz="', '<axis xyz="0 0 1e13" was="', "axis xyz is '0 0 1e13'"),
        ('ixx="', 'ixx="1e13" was="', "inertia ixx is '1e13'"),
    ],
)
def test_numbers_beyond_1e12_in_a_urdf_are_refused(old: str, new: str, told: str, tmp_path: Path) -> None:
    shutil.copytree(GOOD / "robot", tmp_path / "robot")
    file = tmp_path / "robot" / "robot.urdf"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(cp.InputError, match=r"robot\.urdf: .*up to 1e\+12") as refused:
        cp.load_robot(tmp_path / "robot")
    assert told in str(refused.value)


def test_a_urdf_that_pinocchio_cannot_read_is_named_by_its_file(tmp_path: Path) -> None:
    shutil.copytree(GOOD / "robot", tmp_path / "robot")
    file = tmp_path / "robot" / "robot.urdf"
    file.write_text(file.read_text().replace("<parent ", "<uncle ", 1))
    with pytest.raises(cp.InputError, match=r"robot\.urdf: cannot be read as URDF by Pinocchio"):
        read_exact_robot(tmp_path / "robot")


def test_a_map_of_a_plane_that_the_arm_does_not_reach_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    words = ["map", GOOD / "robot", "--points", "5", "--height-mm", "1e5", "--out", tmp_path / "out"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and "reaches no point of the horizontal plane" in done.err, done.out + done.err
    assert done.err.count("\n") == 1


@pytest.mark.parametrize("line", ["/", "/1", " / ", "//", "N10 /"])
def test_a_line_of_skip_marks_alone_is_no_internal_fault(line: str, tmp_path: Path) -> None:
    (tmp_path / "part.nc").write_text(f"G21 G90 G54\nG0 X0 Y0 Z20\n{line}\nG1 Z0 F600\nG1 X20\nM30\n")
    try:
        assert len(cp.read_toolpath(tmp_path / "part.nc")) > 1
    except cp.InputError as refused:
        assert "part.nc:3" in str(refused)
