"""The cutter of a job from a tool table: cutter_file and cutter_name."""

import json
from pathlib import Path
from typing import Any

import pytest

from compplan.errors import InputError
from compplan.job.job import check_job
from compplan.job.operations import split_job

MILL = {"type": "bull nose end mill", "unit": "millimeters", "description": "4711-12", "post-process": {"number": 1},
        "geometry": {"DC": 12.0, "NOF": 4, "RE": 0.5, "LCF": 26.0}}  # fmt: skip
DRILL = {"type": "drill", "unit": "inches", "description": "D-025", "post-process": {"number": 2},
         "geometry": {"DC": 0.25, "NOF": 2, "SIG": 140.0, "LCF": 1.5}}  # fmt: skip


def write_library(file: Path, *tools: dict[str, Any]) -> None:
    file.write_text(json.dumps({"data": tools}), encoding="utf-8")


def make(tmp_path: Path, process: dict, **tool):
    return check_job({"schema": 1, "robot": "kuka_kr16_2", "toolpath": "x.csv", "process": process,
                      "tool": {"position_mm": [0.0, 0.0, 150.0], **tool}}, tmp_path / "job.toml")  # fmt: skip


def test_the_tool_of_a_job_takes_its_cutter_from_a_file(tmp_path: Path) -> None:
    write_library(tmp_path / "mill.json", MILL)
    process = {"model": "end_mill", "spindle_rpm": 9000.0, "material": "al6082_t6"}
    found = make(tmp_path, process, cutter_file="mill.json").process
    assert (found.diameter_mm, found.corner_radius_mm, found.teeth, found.flute_mm) == (12.0, 0.5, 4, 26.0)
    assert make(tmp_path, {**process, "diameter_mm": 12.0, "teeth": 4}, cutter_file="mill.json").process == found
    with pytest.raises(InputError, match=r"job.toml: tool.cutter_file: says diameter_mm = 12, and \[process\] 10"):
        make(tmp_path, {**process, "diameter_mm": 10.0}, cutter_file="mill.json")
    with pytest.raises(InputError, match=r"is a mill, and process.model is 'drill'"):
        make(tmp_path, {**process, "model": "drill"}, cutter_file="mill.json")
    write_library(tmp_path / "both.json", MILL, DRILL)
    with pytest.raises(InputError, match=r"both.json: holds 2 tools; write cutter_name, one of T1, T2"):
        make(tmp_path, process, cutter_file="both.json")
    assert make(tmp_path, process, cutter_file="both.json", cutter_name="t1").process == found
    with pytest.raises(InputError, match=r"gone.json: no such file"):
        make(tmp_path, process, cutter_file="gone.json")


def test_each_tool_of_a_cam_file_takes_its_cutter_from_its_own_file(tmp_path: Path) -> None:
    write_library(tmp_path / "both.json", MILL, DRILL)
    (tmp_path / "part.nc").write_text("G21 G90\nT1 M6\nS9000 M3\nG0 X0 Y0 Z5\nG1 Z-1 F500\nX40\nG0 Z5\n"
                                      "T2 M6\nG0 X10\nG1 Z-4 F200\nG0 Z5\nM30\n")  # fmt: skip
    process = {"model": "end_mill", "diameter_mm": 20.0, "spindle_rpm": 9000.0, "material": "al6082_t6"}
    tools = [
        {"number": 1, "position_mm": [0.0, 0.0, 150.0], "cutter_file": "both.json", "cutter_name": "4711-12"},
        {"number": 2, "position_mm": [0.0, 0.0, 160.0], "cutter_file": "both.json", "cutter_name": "D-025"},
    ]
    job = check_job({"schema": 1, "robot": "kuka_kr16_2", "toolpath": "part.nc", "process": process, "tool": tools},
                    tmp_path / "job.toml")  # fmt: skip
    mill, drill = split_job(job)
    assert (mill.process.model, mill.process.diameter_mm, mill.process.teeth) == ("end_mill", 12.0, 4)
    assert (drill.process.model, drill.process.point_deg) == ("drill", 140.0)
    assert drill.process.diameter_mm == pytest.approx(6.35)
    tools[1]["process"] = {"diameter_mm": 6.0}
    with pytest.raises(InputError, match=r"job.toml: tool\[1\].cutter_file: says diameter_mm = 6.35"):
        split_job(check_job({**job.data, "tool": tools}, job.file))
