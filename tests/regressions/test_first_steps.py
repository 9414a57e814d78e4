"""What a newcomer's first job holds: tools, drills and spindle speeds of the CAM file, and what is assumed."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from commandline import run_command

HEAD = "G21 G90 G54 G17\n"
MILL = "T1 M6\nS9000 M3\nG0 X0 Y0 Z20\nG0 Z5\nG1 Z-1 F300\nG1 X10 F600\nG0 Z50\nM5\n"
DRILL = "T2 M6\nS2500 M3\nG0 X5 Y5 Z20\nG98 G83 X5 Y5 Z-4 R2 Q3 F150\nG80\nG0 Z50\n"


def start_job(code: str, monkeypatch, capsys):
    Path("part.nc").write_text(f"{HEAD}{code}M30\n", encoding="utf-8")
    words = ["init", "my.toml", "--toolpath", "part.nc", "--robot", "kuka_kr16_2", "--short"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0, done.err
    return done.out, tomllib.loads(Path("my.toml").read_text(encoding="utf-8"))


def test_a_job_of_mill_and_drill_is_planned_as_init_wrote_it(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    told, job = start_job(MILL + DRILL, monkeypatch, capsys)
    mill, drill = job["tool"]
    assert (mill["number"], mill["process"]) == (1, {"spindle_rpm": 9000.0})
    assert drill["number"] == 2 and drill["process"]["model"] == "drill" and drill["process"]["spindle_rpm"] == 2500.0
    assert "assumed values, replace them by yours" in told
    assert "# assumed: put yours" in Path("my.toml").read_text(encoding="utf-8")
    done = run_command(["plan", "my.toml", "--out", "out"], monkeypatch, capsys)
    assert done.status == 0, done.err
    plan = json.loads(Path("out/plan.json").read_text(encoding="utf-8"))
    assert plan["status"] == "solved" and len(list(Path("out").glob("*_T2_L1.src"))) == 1


@pytest.mark.parametrize(
    ("code", "process"),
    [
        (MILL, {"model": "milling", "spindle_rpm": 9000.0}),
        (DRILL, {"model": "drill", "spindle_rpm": 2500.0, "stock_top_mm": 0.0}),
        (DRILL.replace("S2500 M3\n", ""), {"model": "drill", "spindle_rpm": 3000.0}),
    ],
)
def test_the_cut_of_a_single_tool_stands_in_process(code, process, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    told, job = start_job(code, monkeypatch, capsys)
    assert {key: job["process"][key] for key in process} == process and "assumed values, replace them by yours" in told


def test_a_file_that_is_not_read_as_it_stands_is_told(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    told, job = start_job(MILL.replace("G1 X10", "G41 D1 G1 X10"), monkeypatch, capsys)
    assert "tools and spindle speeds are not taken from part.nc: " in told and job["process"]["model"] == "milling"
