"""Tools as data: a file of two tools becomes two plans and programs, tables are read, what is missing is refused."""

from __future__ import annotations

import json
import re
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run_command

import compplan as cp
import compplan.reporting.writers.plan as outputs
from compplan.controllers.readback.languages import read_krl, read_rapid
from compplan.controllers.writers import build_program, write_program, write_sequence
from compplan.errors import InputError
from compplan.job.job import check_job, load_job
from compplan.job.operations import require_single_operation, split_job
from compplan.job.tool_tables import read_tool_library, take_tool
from compplan.reporting.operations import deliver_operations
from compplan.toolpath.operations import split_operations
from compplan.toolpath.reading import read_toolpath

HEAD = "%\nO0007 (BRACKET)\nG90 G94 G17 G49 G40 G80\nG21\n"
MILL = ("T1 M6\nS9000 M3\nG54\nM8\nG0 X20. Y15.\nG43 Z15. H1\nZ2.\nG1 Z-1. F400.\nX30. F900.\nY25.\nX20. Y15.\n"
        "G0 Z15.\nM9\nM5\n")  # fmt: skip
DRILL = "T2 M6\nS3000 M3\nG0 X5. Y5.\nG43 Z15. H2\nG98 G81 X5. Y5. Z-6. R3. F200.\nX35.\nG80\nM5\n"
TWO = f"{HEAD}{MILL}{DRILL}M30\n%\n"
TOOLS = [
    {"number": 1, "frame": "pendant", "position_mm": [0.0, 0.0, 180.0], "mass_kg": 4.0,
     "centre_of_mass_mm": [0.0, 0.0, 70.0]},
    {"number": 2, "frame": "pendant", "position_mm": [3.0, 0.0, 215.0], "abc_deg": [30.0, 0.0, 0.0],
     "process": {"model": "drill", "diameter_mm": 5.0, "teeth": 2}},
]  # fmt: skip
PROCESS = {"model": "end_mill", "diameter_mm": 8.0, "teeth": 2, "spindle_rpm": 12000.0, "corner_radius_mm": 0.5,
           "material": "al6082_t6", "stock": {"block_mm": [[-5.0, -5.0, -10.0], [45.0, 35.0, 0.0]]}}  # fmt: skip
HOLES = [[5.0, 5.0, -6.0], [35.0, 5.0, -6.0]]


def write_path(folder: Path, text: str = TWO) -> Path:
    (folder / "two.nc").write_text(text)
    return folder / "two.nc"


def make_job(folder: Path, text: str = TWO, **tables: Any) -> cp.Job:
    write_path(folder, text)
    data = {"schema": 1, "name": "Bracket", "robot": "kuka_kr16_2", "toolpath": "two.nc",
            "part": {"position_mm": [900.0, -20.0, 700.0]}, "cam": {"cycles": "expand"}, **tables}  # fmt: skip
    return check_job(data, folder / "job.toml")


def test_each_operation_is_a_job_with_its_own_tool_force_and_spindle_speed(tmp_path: Path) -> None:
    first, second = split_job(make_job(tmp_path, tool=TOOLS, process=PROCESS))
    assert (first.label, first.cam.operation, second.label, second.cam.operation) == ("T1", 1, "T2", 2)
    assert first.tool is not None and first.tool.position_mm == (0.0, 0.0, 180.0) and first.tool.mass_kg == 4.0
    assert second.tool is not None and second.tool.abc_deg == (30.0, 0.0, 0.0) and second.tool.mass_kg is None
    mill, drill = first.process, second.process
    assert mill.model == "end_mill" and mill.spindle_rpm == 9000.0 and mill.corner_radius_mm == 0.5  # S of the file
    assert drill.model == "drill" and drill.spindle_rpm == 3000.0 and drill.diameter_mm == 5.0
    assert drill.material == "al6082_t6" and drill.stock is not None  # what holds for both


def test_operations_begin_with_their_own_change_and_end_with_spindle_and_coolant_off(tmp_path: Path) -> None:
    text = TWO.replace("M9\nM5\nT2", "T2")
    path = read_toolpath(write_path(tmp_path, text), cam=cp.check_job({
        "schema": 1, "robot": "ur10", "toolpath": "a.nc", "cam": {"cycles": "expand"}}).cam)  # fmt: skip
    first, second = split_operations(path)
    assert [(e.kind, e.value) for e in second.toolpath.events[:2]] == [("tool", 2.0), ("spindle_cw", 3000.0)]
    assert second.toolpath.events[0].place == -1
    assert [e.kind for e in first.toolpath.events][-2:] == ["spindle_off", "coolant_off"]
    assert 1e3 * first.toolpath.position[-1] == pytest.approx([20.0, 15.0, 15.0])
    whole, parts = path.position[~path.rapid], [one.toolpath for one in (first, second)]
    assert np.vstack([part.position[~part.rapid] for part in parts]) == pytest.approx(whole)  # no cut is lost
    assert parts[1].rapid[0] and 1e3 * parts[1].position[0] == pytest.approx([5.0, 5.0, 15.0])


def test_a_tool_that_cuts_again_is_an_operation_of_its_own_and_one_that_cuts_nothing_is_none(tmp_path: Path) -> None:
    idle = "T7 M6\nG0 X1. Y1.\n"
    job = make_job(tmp_path, f"{HEAD}{MILL}{idle}{DRILL}{MILL}M30\n", tool=TOOLS, process=PROCESS)
    assert [one.label for one in split_job(job)] == ["T1", "T2", "T1_run2"]
    same = make_job(tmp_path, f"{HEAD}{MILL}{MILL}M30\n", tool=TOOLS, process=PROCESS)
    (only,) = split_job(same)
    assert only.label == "" and only.cam.operation is None and only.name == "Bracket"


@pytest.mark.parametrize(("tables", "said"), [
    ({}, r"cuts with T1, T2, and the job describes one tool; write \[\[tool\]\] for number = 1 and number = 2"),
    ({"tool": {"position_mm": [0.0, 0.0, 150.0]}}, "the job describes one tool"),
    ({"tool": TOOLS[:1]}, r"cuts with T2, and no \[\[tool\]\] describes it; write \[\[tool\]\] with number = 2"),
])  # fmt: skip
def test_a_cut_whose_tool_nobody_describes_is_refused_in_one_line(tmp_path, tables, said, monkeypatch, capsys) -> None:
    import tomli_w

    job = make_job(tmp_path, **tables)
    (tmp_path / "job.toml").write_text(tomli_w.dumps(job.context.data))
    done = run_command(["plan", tmp_path / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 2 and re.search(said, done.err) and done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("tools", "said"), [
    ([{"position_mm": [0.0, 0.0, 1.0]}], r"tool\[0\]: has neither number nor name"),
    ([*TOOLS, TOOLS[0]], r"tool\[2\]: describes T1 again"),
    ([], "tool: is empty"),
    ([{"number": 1, "lenght": 3.0}], r"tool\[0\].lenght: unknown key"),
    ([{"number": 1}, {"number": 2, "process": {"model": "drill", "teeths": 2}}], r"process.*T2: tool\[1\]"),
    ([3], r"tool\[0\]: is 3, expected a section"),
])  # fmt: skip
def test_tools_that_cannot_be_are_refused_with_their_place(tmp_path: Path, tools: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        split_job(make_job(tmp_path, tool=tools, process=PROCESS))


def test_a_command_of_one_tool_takes_the_operation_that_the_job_names(tmp_path: Path, monkeypatch, capsys) -> None:
    import tomli_w

    data = make_job(tmp_path, tool=TOOLS, process=PROCESS).context.data
    file = tmp_path / "job.toml"
    file.write_text(tomli_w.dumps(data))
    with pytest.raises(InputError, match=r"2 operations \(1 T1, 2 T2\) and this takes one; write"):
        require_single_operation(load_job(file))
    file.write_text(tomli_w.dumps({**data, "cam": {"cycles": "expand", "operation": 2}}))
    job = require_single_operation(load_job(file))
    assert job.tool is not None and job.tool.position_mm[2] == 215.0
    assert 1e3 * job.T_base_part[:3, 3] == pytest.approx([900.0, -20.0, 700.0])
    file.write_text(tomli_w.dumps({**data, "cam": {"cycles": "expand", "operation": 3}}))
    with pytest.raises(InputError, match=r"cam.operation: is 3, the CAM file has 2 \(tools T1, T2\)"):
        require_single_operation(load_job(file))
    with pytest.raises(InputError, match="describes tools by number"):
        cp.plan_job(cp.check_job(data, file))
    with pytest.raises(InputError, match="this takes one"):
        cp.plan(cp.check_job(data, file))


@pytest.fixture(scope="module")
def posted(tmp_path_factory: pytest.TempPathFactory) -> cp.Posted:
    """Two tools in two languages, as planned without a correction, so that positions are those of the file."""
    folder = tmp_path_factory.mktemp("two")
    return cp.post(
        write_path(folder), robot="kuka_kr16_2", part=[900.0, -20.0, 700.0], program=["krl", "rapid"], tools=TOOLS,
        process=PROCESS, cam={"cycles": "expand"}, plan={"strategy": "none", "tolerance_mm": 5.0},
        output={"any_brand": True}, out=folder / "out",
    )  # fmt: skip


@pytest.mark.parametrize("language", ["krl", "rapid"])
def test_two_tools_and_their_holes_are_read_back_from_the_programs(posted: cp.Posted, language: str) -> None:
    read, ending = (read_krl, ".src") if language == "krl" else (read_rapid, ".mod")
    for label, length, aside, action in (("T1", 180.0, 0.0, "tool T1"), ("T2", 215.0, 3.0, "tool T2")):
        text = "".join(file.read_text() for file in posted.folder.glob(f"two_{label}*{ending}"))
        assert action in text and "HALT" in text if language == "krl" else action in text
        moves = [move for move in read(posted.folder / f"two_{label}_L{ending}") if move.kind != "act"]
        tool = next(move.tool for move in moves if move.tool is not None)
        assert tool[:3, 3] == pytest.approx([aside, 0.0, length], abs=1e-5)
        tips = np.array([move.pose[:3, 3] for move in moves if move.pose is not None])
        if label == "T2":
            for hole in HOLES:
                assert np.linalg.norm(tips - hole, axis=1).min() < 1e-4
            assert tips[:, 2].min() == pytest.approx(-6.0, abs=1e-4)
        else:
            assert tips[:, 2].min() == pytest.approx(-1.0, abs=1e-4)


def test_a_main_program_calls_the_programs_of_all_tools_where_the_language_has_calls(posted: cp.Posted) -> None:
    lines = (posted.folder / "two_ALL_L.src").read_text().splitlines()
    assert [line for line in lines if line.startswith("two_")] == ["two_T1_L()", "two_T2_L()"]
    assert "DEF two_ALL_L()" in lines[:5] and lines[-1] == "END"
    assert not list(posted.folder.glob("*ALL*.mod"))  # RAPID modules have a main program each
    whole = json.loads((posted.folder / "plan.json").read_text())
    assert whole["main_programs"] == ["two_ALL_L.src"]
    assert "two_ALL_L.src" in (posted.folder / "report.html").read_text()


@pytest.mark.parametrize(("language", "call"), [
    ("krl", "{}()"), ("fanuc_ls", "CALL {} ;"), ("inform", "CALL JOB:{}"), ("kawasaki_as", "CALL {}"),
    ("sinumerik", "{}"),
])  # fmt: skip
def test_a_main_program_names_what_no_other_program_calls(language: str, call: str, tmp_path: Path) -> None:
    """Long programs are cut into parts that their own main program calls; that of the job calls those alone."""
    robot = cp.load_robot("kuka_kr16_2")
    q = np.linspace([0.1, -1.2, 1.5, 0.1, 0.8, 0.1], [0.3, -1.1, 1.4, 0.2, 0.9, 0.2], 30)
    feed, rapid = np.full(30, 10.0e-3), np.arange(30) == 0
    programs = [build_program(robot, q, feed, rapid, name=f"bracket_{label}") for label in ("T1", "T2")]
    words = {key: np.full(30, value) for key, value in (("shoulder", "front"), ("elbow", "up"), ("wrist", "flip"))}
    programs = [replace(program, words=words) if language == "inform" else program for program in programs]
    groups = [write_program(program, language, tmp_path, most=10, any_brand=True) for program in programs]
    mains = write_sequence(programs[0], language, "bracket", groups, tmp_path)
    for main in mains:
        kind = main.stem.upper().removeprefix("BRACKET_ALL") if language != "kawasaki_as" else main.stem[-2:].upper()
        kind = kind if kind in ("_J", "_L") else ""
        called = [file.stem for files in groups for file in files if file.suffix == main.suffix
                  and re.fullmatch(rf"BRACKE?T?_T[12]{kind}", file.stem.upper())]  # fmt: skip
        text = main.read_text()
        assert len(called) == 2 and text.index(call.format(called[0])) < text.index(call.format(called[1]))
        assert not re.search(r"T[12](_[JL])?_?\d", text, re.IGNORECASE)
    assert mains


def test_the_folder_holds_the_whole_and_each_tool(posted: cp.Posted) -> None:
    whole = json.loads((posted.folder / "plan.json").read_text())
    parts = [json.loads((posted.folder / label / "plan.json").read_text()) for label in ("T1", "T2")]
    assert whole["status"] == "solved" == posted.status and len(whole["tools"]) == 2
    assert whole["waypoints"] == sum(part["waypoints"] for part in parts)
    assert whole["error_after_mm"]["max"] == max(part["error_after_mm"]["max"] for part in parts)
    assert whole["error_band_mm"]["p95_max"] == max(part["error_band_mm"]["p95_max"] for part in parts)
    assert [tool["folder"] for tool in whole["tools"]] == ["T1", "T2"]
    assert all((posted.folder / name).is_file() for tool in whole["tools"] for name in tool["programs"])
    assert [round(tool["length_mm"], 3) for tool in whole["tools"]] == [180.0, round(float(np.hypot(3, 215)), 3)]
    head, *rows = (posted.folder / "joints.csv").read_text().splitlines()
    assert head.startswith("time_s,q1_deg") and head.endswith(",tool")
    time = np.array([float(row.partition(",")[0]) for row in rows])
    assert (np.diff(time) >= 0.0).all() and [row.rpartition(",")[2] for row in rows[:: len(rows) - 1]] == ["T1", "T2"]
    page = (posted.folder / "report.html").read_text()
    assert "run time of 2 operations, without the tool" in page and "two_T2_L.src" in page


def test_what_was_written_for_several_tools_is_read_back(
    posted: cp.Posted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = outputs.write_joints

    def write_late(plan: cp.Plan, path: Path) -> None:
        true(replace(plan, timing=replace(plan.timing, time=2.0 * plan.timing.time)), path)

    plans, _ = deliver_operations(posted.plans, tmp_path / "sound", "two")
    assert [plan.status for plan in plans] == ["solved", "solved"]
    monkeypatch.setattr(outputs, "write_joints", write_late)
    plans, _ = deliver_operations(posted.plans, tmp_path / "late", "two")
    assert [plan.status for plan in plans] == ["not_confirmed", "not_confirmed"]
    assert all("time is" in plan.breaches[-1] for plan in plans)
    assert json.loads((tmp_path / "late" / "plan.json").read_text())["status"] == "not_confirmed"
    assert "NOT CONFIRMED" in (tmp_path / "late" / "two_T2_L.src").read_text()


CSV = "number,name,length_mm,diameter_mm,teeth,kind\n1,rough,120.5,12,3,end mill\n2,hole,150,5,2,drill\n"
FUSION = {"version": 1, "data": [
    {"type": "holder", "description": "HSK"},
    {"type": "flat end mill", "unit": "millimeters", "description": "12 mm", "post-process": {"number": 1},
     "geometry": {"DC": 12.0, "NOF": 3, "LB": 40.0, "LCF": 26.0, "RE": 0.0, "assemblyGaugeLength": 120.5}},
    {"type": "drill", "unit": "inches", "description": "5 mm", "post-process": {"number": 2},
     "geometry": {"DC": 5 / 25.4, "NOF": 2, "LB": 3.0, "SIG": 118}, "holder": {"gaugeLength": 150 / 25.4 - 3.0}},
]}  # fmt: skip


def write_table(folder: Path, form: str) -> Path:
    rows = [dict(zip(CSV.split("\n")[0].split(","), row.split(","), strict=True)) for row in CSV.split("\n")[1:3]]
    toml = "".join(
        "[[tool]]\n"
        + "".join(f"{key} = {value if value[0].isdigit() else repr(value)}\n" for key, value in row.items())
        for row in rows
    )
    texts = {"t.csv": CSV, "t.toml": toml, "t.json": json.dumps(FUSION)}
    file = folder / form
    if form == "t.tools":
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("tools.json", texts["t.json"])
    else:
        file.write_text(texts[form])
    return file


@pytest.mark.parametrize("form", ["t.csv", "t.toml", "t.json", "t.tools"])
def test_every_form_of_tool_table_says_the_same_two_tools(tmp_path: Path, form: str) -> None:
    file = write_table(tmp_path, form)
    tools = read_tool_library(file)
    one, two = (take_tool(tools, number, "", file) for number in (1, 2))
    assert one is not None and two is not None and take_tool(tools, 3, "", file) is None
    assert one.length_mm == pytest.approx(120.5) and two.length_mm == pytest.approx(150.0)
    assert one.diameter_mm == pytest.approx(12.0) and two.diameter_mm == pytest.approx(5.0)
    assert (one.kind, two.kind) == ("mill", "drill")
    assert (one.teeth, two.teeth) == (3, 2)


def test_a_table_gives_each_tool_its_length_from_the_spindle_and_its_cutter(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(CSV.replace("kind\n", "kind,mass_kg\n").replace("end mill\n", "end mill,2\n"))
    spindle = {"frame": "pendant", "position_mm": [100.0, 0.0, 80.0], "abc_deg": [0.0, 90.0, 0.0], "mass_kg": 10.0,
               "centre_of_mass_mm": [50.0, 0.0, 60.0]}  # fmt: skip
    job = make_job(tmp_path, tool=spindle, tools={"file": "t.csv"}, process=PROCESS)
    mill, drill = split_job(job)
    assert mill.tool is not None and drill.tool is not None
    assert mill.tool.position_mm == pytest.approx([220.5, 0.0, 80.0])  # z of the spindle points along x of the flange
    assert mill.tool.mass_kg == 12.0
    assert mill.tool.centre_of_mass_mm[0] == pytest.approx((10 * 50 + 2 * (100 + 60.25)) / 12)
    assert drill.tool.position_mm == pytest.approx([250.0, 0.0, 80.0]) and drill.tool.mass_kg == 10.0
    assert (mill.process.diameter_mm, mill.process.teeth, mill.process.model) == (12.0, 3, "end_mill")
    assert (drill.process.diameter_mm, drill.process.teeth, drill.process.model) == (5.0, 2, "drill")
    constant = make_job(tmp_path, tools={"file": "t.csv"}, process={"model": "constant", "force_N": [0.0, 0.0, 50.0]})
    assert {one.process.model for one in split_job(constant)} == {"constant"}


@pytest.mark.parametrize(("text", "said"), [
    ("number,length_mm\n1,120\n", "cuts with T2, and t.csv has no such tool"),
    ("number,length_mm\n1,120\n2,150\n2,151\n", "t.csv: describes T2 2 times"),
    ("number,length_mm\n1,120\n2,abc\n", "t.csv:3: length_mm is 'abc', must be a number"),
    ("number,length_mm\n1,120\n2,\n", "T2 has no length from the gauge line"),
    ("number,length_mm\n1,120\n2,-4\n", "t.csv:3: length_mm is '-4', must be greater than or equal to 0"),
    ("number,diameter_mm\n1,120\n", "T1 has no length from the gauge line"),
    ("number,length\n1,120\n", "t.csv:2: length unknown key, choose from"),
    ("T1 P1 Z10 D3\nT2 P2 Z20\n", r"is not a tool table, expected a Fusion tool library \(.json, .tools\), TOML"),
    ('{"data": [{"type": "drill", "post-process": {"number": 1}, "geometry": {"DC": 3, "assemblyGaugeLength": 90}}]}',
     "T1 states no unit of its lengths"),
    ("hello\n", "is not a tool table"),
    ('{"data": 3, "x": "post-process"}', "is not a tool library"),
    ('{"data": [{"unit": "millimeters", "type": "drill", "post-process": {"number": 1}, "geometry": {"DC": 3}}]}',
     "T1 has no length from the gauge line; write length_mm"),
])  # fmt: skip
def test_tables_that_do_not_say_what_is_needed_are_refused(tmp_path: Path, text: str, said: str) -> None:
    name = "t.json" if text.startswith("{") else "t.csv"
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        split_job(make_job(tmp_path, tools={"file": name}))


def test_post_takes_tools_on_the_command_line(tmp_path: Path, monkeypatch, capsys) -> None:
    write_path(tmp_path)
    (tmp_path / "tools.csv").write_text(CSV)
    (tmp_path / "spindle.toml").write_text('frame = "pendant"\nposition_mm = [0.0, 0.0, 60.0]\n')
    (tmp_path / "cam.toml").write_text('cycles = "expand"\n')
    (tmp_path / "quick.toml").write_text('strategy = "none"\ntolerance_mm = 5.0\n')
    words = ["post", tmp_path / "two.nc", "--robot", "kuka_kr16_2", "--part", "900,-20,700", "--program", "krl"]
    more = ["--cam", tmp_path / "cam.toml", "--plan", tmp_path / "quick.toml", "--out", tmp_path / "out"]
    done = run_command([*words, *more, "--tool", tmp_path / "spindle.toml"], monkeypatch, capsys)
    assert done.status == 2 and "cuts with T1, T2" in done.err
    done = run_command([*words, *more, "--tool", tmp_path / "spindle.toml", "--tools", tmp_path / "tools.csv"],
                       monkeypatch, capsys)  # fmt: skip
    assert done.status == 0, done.err
    assert "run time of 2 operations" in done.out and "then those of T2" in done.out
    main = (tmp_path / "out" / "two_T2_L.src").read_text()
    assert re.search(r"\$TOOL=\{X 0.0+,Y 0.0+,Z 210.0+,", main)


def test_a_plan_that_leaves_holes_out_is_not_solved(tmp_path: Path) -> None:
    job = make_job(tmp_path, f"{HEAD}G0 X0. Y0. Z9.\nG1 Z1. F600.\nX9.\n{DRILL.replace('T2 M6', '')}M30\n",
                   cam={"cycles": "skip"}, plan={"strategy": "none", "tolerance_mm": 5.0},
                   process={"model": "constant", "force_N": [0.0, 0.0, 0.0]})  # fmt: skip
    plan = cp.plan_job(job)
    assert plan.status == "not_confirmed" and 'write cycles = "expand"' in plan.explain_failures()


@pytest.mark.slow
def test_the_example_of_two_tools_is_solved(tmp_path: Path, monkeypatch, capsys) -> None:
    file = Path(__file__).parents[2] / "examples" / "two_tools" / "bracket.toml"
    done = run_command(["plan", file, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert done.status == 0, done.err
    tools = json.loads((tmp_path / "out" / "plan.json").read_text())["tools"]
    assert [tool["status"] for tool in tools] == ["solved", "solved"]


def test_init_writes_a_tool_for_each_number_that_the_file_cuts_with(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write_path(tmp_path)
    done = run_command(["init", "my.toml", "--robot", "kuka_kr16_2", "--toolpath", "two.nc"], monkeypatch, capsys)
    assert done.status == 0, done.err
    tools = cp.load_job("my.toml").context.tools
    assert [tool.number for tool in tools] == [1, 2] and {tool.frame for tool in tools} == {"pendant"}
    assert "put yours" in (tmp_path / "my.toml").read_text() and "the part is at [" in done.out
