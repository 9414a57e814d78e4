"""Lines of the language itself around a program, such as what starts the spindle; programs from arrays alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from commandline import run_command
from program_readers import read_krl
from script_readers import read_urscript

import compplan as cp
from tests.controllers.test_golden_programs import FORMS, make_program

#: What makes the first move of each form, in the file that runs first.
MOVES = {
    "krl": r"^two_[JL]1\(\)", "val3": r"call part1", "fanuc_ls": r"^ *\d+:[JL] P\[1\]", "rapid": r"run_two(_L)?_1;",
    "urscript": r"^  move[jl]", "sinumerik": r"^N\d+ G[01] X", "inform": r"^MOV[JL] C00000",
    "kawasaki_as": r"^  CALL two",
}  # fmt: skip


@pytest.mark.parametrize("form", [form for form in FORMS if not form.startswith("csv")])
def test_header_lines_stand_before_the_first_move_and_footer_lines_after_the_last(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    program = make_program(tmp_path / "cell", language)
    cp.write_program(replace(program, header=("SPINDLE_ON",), footer=("SPINDLE_OFF",)), language, tmp_path / "out")
    upper = language in ("fanuc_ls", "inform", "sinumerik")
    file = tmp_path / "out" / FORMS[form][0].format("TWO" if upper else "two")
    text = (file / "start.pgx" if file.is_dir() else file).read_text()
    moves = [match.start() for match in re.finditer(MOVES[language], text, re.M)]
    assert text.count("SPINDLE_ON") == text.count("SPINDLE_OFF") == 1
    assert text.index("SPINDLE_ON") < moves[0] <= moves[-1] < text.index("SPINDLE_OFF")
    assert "not started here" not in text


@pytest.mark.parametrize("robot", ["kuka_kr270", "ur10"])
def test_the_tool_stands_where_a_cut_begins_that_the_plan_approaches(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    language, name, x = {"kuka_kr270": ("krl", "c_L.src", 1700), "ur10": ("urscript", "c_L.script", -700)}[robot]
    job = tmp_path / "c.toml"
    job.write_text(
        f'schema = 1\nrobot = "{robot}"\n[toolpath]\ngenerator = "circle"\nradius_mm = 10.0\nfeed_mm_s = 10.0\n'
        f"waypoints = 60\n[part]\nposition_mm = [{x}.0, 0.0, 300.0]\n"
        '[process]\nmodel = "constant"\nforce_N = [0.0, 10.0, -35.0]\n'
        f'[plan]\nrotate_about_tool_axis = false\n[output]\nprograms = ["{language}"]\n'
    )
    assert run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys).status == 0
    moves = {"krl": read_krl, "urscript": read_urscript}[language](tmp_path / "out" / name)
    first = next(index for index, move in enumerate(moves) if move.kind != "joint")
    assert moves[first].stops and not moves[first + 1].stops
