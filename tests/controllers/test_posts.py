"""Templates of programs: the cell's own data stay, a user's template stands in, a post of one's own is one file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from golden_cell import write_job

from compplan.controllers.readback.languages import read_fanuc, read_krl
from compplan.controllers.readback.scripts import read_inform, read_sinumerik
from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.post import read_post
from compplan.controllers.writers.program import Post
from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.planning.plan import plan_job
from compplan.planning.result import Plan
from compplan.reporting.writers.plan import deliver_plan, note_programs
from compplan.robot import load_robot

#: What a program would set in the cell's own data.
REGISTERS = re.compile(r"UTOOL\[|UFRAME\[|PR\[|MFRAME|SETTOOL|TC_DP|TOOL_DATA\[\d\]=|BASE_DATA\[\d\]=")
OWN = {"krl": (5, 7), "fanuc_ls": (5, 7), "inform": (5, 7), "sinumerik": (5, "G55"),
       "rapid": ("tMill", "wVice"), "urscript": ("mill", "vice"), "kawasaki_as": ("mill", "vice")}  # fmt: skip
#: Robots whose folders have the words that a language needs.
ROBOTS = {"fanuc_ls": "fanuc_m20ia"}


def make_program(robot_name: str = "kuka_kr270", **changes: object) -> Program:
    robot = load_robot(robot_name)
    q = np.radians(np.linspace([0.0, -80, 100, 0, 60, 0], [4, -78, 98, 1, 58, 2], 6))
    program = build_program(robot, q, np.full(6, 0.02), np.arange(6) == 0, name="three", part=np.eye(4))
    return replace(program, form="linear", **changes)  # type: ignore[arg-type]


def plan_cell(folder: Path, language: str, output: str = "") -> tuple[Plan, Path]:
    job = load_job(append(write_job(folder, language, fills=False), output))
    plan, _ = deliver_plan(note_programs(plan_job(job)), folder / "out")
    return plan, folder / "out"


def append(file: Path, output: str) -> Path:
    text = file.read_text().replace("cell = { overwrite = false }\n", output or "")
    file.write_text(text.replace('form = "both"', 'form = "linear"'))
    return file


def code(folder: Path) -> str:
    """All programs of a folder without their comments."""
    files = [file for file in folder.iterdir() if file.suffix.lower() in (".src", ".ls", ".jbi", ".mpf", ".mod", ".as",
                                                                         ".script")]  # fmt: skip
    return re.sub(r"(?m)^\s*(?:\d+: *!|[;!#']).*$", "", "\n".join(file.read_text() for file in files))


@pytest.mark.parametrize("language", ["fanuc_ls", "inform", "sinumerik", "krl"])
def test_programs_leave_the_cells_registers_alone_and_say_what_they_have_to_hold(language: str, tmp_path: Path) -> None:
    plan, folder = plan_cell(tmp_path, language)
    assert plan.status == "solved" and not REGISTERS.search(code(folder))
    told = [note for note in plan.notes if "of the cell have to hold" in note]
    assert len(told) == (language != "krl")
    if language != "krl":
        head = "".join(file.read_text() for file in folder.iterdir() if file.suffix in (".LS", ".JBI", ".MPF"))
        x, y, _ = (1e3 * plan.job.T_base_part[:3, 3]).tolist()  # type: ignore[union-attr]
        inform, lengths = rf"' {x:.3f} {y:.3f} ", "lengths of D1"
        stated = {"fanuc_ls": rf"X {x:.3f} Y {y:.3f}", "inform": inform, "sinumerik": lengths}
        assert re.search(stated[language], head)


@pytest.mark.parametrize("language", list(OWN))
def test_programs_count_from_the_tool_and_frame_of_the_cell_that_the_job_names(language: str, tmp_path: Path) -> None:
    tool, base = OWN[language]
    program = make_program(ROBOTS.get(language, "kuka_kr270"), post=Post(tool=tool, base=base))
    written = write_program(program, language, tmp_path, any_brand=True)
    text = code(tmp_path)
    words = {
        "krl": ["$TOOL=TOOL_DATA[5]", "$BASE=BASE_DATA[7]"], "fanuc_ls": ["UTOOL_NUM=5", "UFRAME_NUM=7"],
        "inform": ["///TOOL 5", "///USER 7"], "sinumerik": ["T5 D1", "G710 G55"], "rapid": ["tMill\\WObj:=wVice;"],
        "urscript": ["part = vice", "pose_trans(part"], "kawasaki_as": ["TOOL mill", "POINT part = vice"],
    }[language]  # fmt: skip
    assert written and all(word in text for word in words) and not REGISTERS.search(text)
    assert "tooldata" not in text and "set_tcp" not in text and "TOOL TRANS" not in text and "$TOOL={" not in text


@pytest.mark.parametrize(
    ("language", "read", "file"),
    [("fanuc_ls", read_fanuc, "THREE_L.LS"), ("inform", read_inform, "THREE_L.JBI"),
     ("sinumerik", read_sinumerik, "THREE.MPF"), ("krl", read_krl, "three_L.src")],
)  # fmt: skip
def test_asked_to_programs_fill_the_numbers_that_the_job_names(language, read, file, tmp_path: Path) -> None:
    tool, base = OWN[language] if language != "sinumerik" else (5, None)
    robot = ROBOTS.get(language, "kuka_kr270")
    asked = make_program(robot, post=Post(tool=tool, base=base, overwrite=True))
    write_program(asked, language, tmp_path, any_brand=True)
    move = read(tmp_path / file)[-1]
    assert asked.tool is not None and asked.tcp is not None
    assert move.tool[:3, 3] == pytest.approx(1e3 * asked.tool[:3, 3], abs=1e-3)
    tip = np.linalg.inv(asked.world) @ asked.tcp[-1]
    assert (move.base @ move.pose)[:3, 3] == pytest.approx(1e3 * tip[:3, 3], abs=1e-2)


@pytest.mark.parametrize(("language", "post"), [("krl", Post(tool="mill")), ("rapid", Post(base=3)),
                                                ("val3", Post(tool=1)), ("rapid", Post(tool="t;STOP"))])  # fmt: skip
def test_tool_data_that_a_language_does_not_know_are_refused(language: str, post: Post, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"output.cell (tool|base) is"):
        write_program(make_program(post=post), language, tmp_path, any_brand=True)


@pytest.mark.parametrize("language", ["krl", "rapid", "fanuc_ls", "urscript", "sinumerik"])
def test_the_job_names_the_main_program_and_it_is_read_back(language: str, tmp_path: Path) -> None:
    plan, folder = plan_cell(tmp_path, language, 'main = "POCKET_OP1"\n')
    assert plan.status == "solved", plan.breaches
    names = {file.stem for file in folder.iterdir()}
    if language == "rapid":
        assert "PROC POCKET_OP1()" in code(folder) and "PROC main" not in code(folder)
    else:
        assert "POCKET_OP1" in names and not any(name.endswith("_L") for name in names)


def test_a_template_of_the_users_stands_in_place_of_the_packages(tmp_path: Path) -> None:
    own = tmp_path / "cell.jinja"
    own.write_text(read_post("krl").replace("BAS(#INITMOV,0)", "BAS(#INITMOV,0)\nWAIT FOR $IN[17]"))
    write_program(make_program(post=Post(template=own)), "krl", tmp_path, any_brand=True)
    assert "BAS(#INITMOV,0)\nWAIT FOR $IN[17]\n" in (tmp_path / "three_L.src").read_text()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("DEF {{ nmae }}()", "'nmae' is undefined"), ("{% for x in %}", "Expected an expression"),
        ("DEF x()\n{{ parts.missing.more }}", "no attribute"), ("; \u00e9", "plain ASCII"),
        ("{{ ''.__class__.__mro__ }}", "unsafe"), ("; " + "x" * 600, "602 characters, at most 471"),
        ("{{ 1 / 0 }}", "division by zero"), ("{{ name.nope() }}", "no attribute"),
    ],
)  # fmt: skip
def test_a_template_that_is_none_is_refused_with_its_file(text: str, said: str, tmp_path: Path) -> None:
    own = tmp_path / "cell.jinja"
    own.write_text(text)
    with pytest.raises(InputError) as told:
        write_program(make_program(post=Post(template=own)), "krl", tmp_path / "out", any_brand=True)
    assert str(told.value.file) == str(own) and said in told.value.message, told.value.message


def test_a_missing_template_ends_the_plan_in_one_line_and_nothing_is_written(tmp_path, monkeypatch, capsys) -> None:
    file = append(write_job(tmp_path, "krl", fills=False), 'templates = { krl = "nowhere.jinja" }\n')
    done = run_command(["plan", str(file), "--out", str(tmp_path / "out")], monkeypatch, capsys)
    assert done.status == 2 and "nowhere.jinja: " in done.err and done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_post_of_ones_own_is_one_file_that_knows_every_move(tmp_path: Path) -> None:
    own = tmp_path / "mine.tap.jinja"
    own.write_text("{% for m in moves %}\n{{ m.kind }} {{ m.end.x }} {{ m.end.quaternion[0] }} {{ m.feed_mm_s }} "
                   "{{ m.stop }}\n{% endfor %}\n")  # fmt: skip
    program = make_program(post=Post(template=own, main="part_7"))
    (file,) = write_program(program, "own", tmp_path / "out")
    rows = [line.split() for line in file.read_text().splitlines()]
    assert file.name == "part_7.tap" and program.tcp is not None
    assert [row[0] for row in rows] == ["rapid", *["line"] * 5] and rows[-1][4] == "True" and rows[2][4] == "False"
    assert [float(row[1]) for row in rows] == pytest.approx((1e3 * program.tcp[:, 0, 3]).tolist(), abs=1e-6)
    with pytest.raises(InputError, match=r"output\.templates own"):
        write_program(make_program(), "own", tmp_path)


def test_init_writes_the_template_to_start_from(tmp_path, monkeypatch, capsys) -> None:
    done = run_command(["init", "template", "own", "--out", str(tmp_path / "mine.nc.jinja")], monkeypatch, capsys)
    assert done.status == 0 and (tmp_path / "mine.nc.jinja").read_text() == read_post("own")
    post = Post(template=tmp_path / "mine.nc.jinja")
    (file,) = write_program(make_program(post=post), "own", tmp_path)
    assert file.suffix == ".nc" and file.read_text().count("LINE X") == 5
    assert run_command(["init", "template", "krll"], monkeypatch, capsys).status == 2
