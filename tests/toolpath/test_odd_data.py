"""Logs and paths that are odd without being illegible: rows pasted again, sigma of nothing, one row, metres for mm."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.measurement.reading import read_campaign
from compplan.robot import load_robot
from compplan.toolpath.generators import CircleTable
from compplan.toolpath.toolpath import check_toolpath

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"
ROBOT = load_robot(GOOD / "robot")


def write_log(folder: Path, rows: list[list[str]]) -> Path:
    with (folder / "log.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return folder / "log.csv"


def read_rows() -> list[list[str]]:
    with (GOOD / "log.csv").open() as stream:
        return list(csv.reader(stream))


def drop(rows: list[list[str]], name: str) -> list[list[str]]:
    at = rows[0].index(name)
    return [row[:at] + row[at + 1 :] for row in rows]


@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("times", [2, 3])
def test_rows_that_are_pasted_again_count_once(times, clock, tmp_path) -> None:
    head, *rows = read_rows() if clock else drop(read_rows(), "time_s")
    once = read_campaign(write_log(tmp_path, [head, *rows]), ROBOT)
    pasted = read_campaign(write_log(tmp_path, [head, *(rows * times)]), ROBOT)
    assert once.usable.sum() == pasted.usable.sum() == len(rows)
    assert pasted.usable[: len(rows)].all()
    assert any(f"{(times - 1) * len(rows)} of {times * len(rows)} rows" in note for note in pasted.notes)
    assert not any("repeat earlier rows" in note for note in once.notes)


def test_a_few_rows_that_are_pasted_again_are_seen_by_the_clock(tmp_path) -> None:
    head, *rows = read_rows()
    campaign = read_campaign(write_log(tmp_path, [head, *rows, rows[-1], rows[-1]]), ROBOT)
    assert campaign.usable.sum() == len(rows)


def test_repeats_that_agree_by_rounding_are_measurements(tmp_path) -> None:
    head, *rows = drop(read_rows(), "time_s")
    campaign = read_campaign(write_log(tmp_path, [head, *rows, rows[0]]), ROBOT)
    assert campaign.usable.sum() == len(rows) + 1


def test_pasted_rows_narrow_no_interval(tmp_path, monkeypatch, capsys) -> None:
    head, *rows = read_rows()
    said = []
    for times in (1, 3):
        log = write_log(tmp_path, [head, *(rows * times)])
        words = ["identify", log, "--robot", GOOD / "robot", "--out", tmp_path / f"out{times}"]
        answer = run_command(words, monkeypatch, capsys)
        assert answer.status == 0
        line = next(line for line in answer.out.splitlines() if line.strip().startswith("joint_1 "))
        low, high = line.rpartition("(95 %: ")[2].rstrip(")").split(" to ")
        said.append(float(high) - float(low))
    assert answer.out.count("repeat earlier rows") == 1
    assert "repeat earlier rows" in json.loads((tmp_path / "out3" / "identify.json").read_text())["log_notes"][0]
    assert said[1] == pytest.approx(said[0], rel=0.1)


@pytest.mark.parametrize(("sigma", "allowed"), [("1e-30", False), ("1e-7", False), ("1e-6", True), ("0.05", True)])
def test_a_sigma_below_a_nanometre_is_refused(sigma, allowed, tmp_path) -> None:
    head, *rows = read_rows()
    at = head.index("sigma_mm")
    log = write_log(tmp_path, [head, *([*row[:at], sigma, *row[at + 1 :]] for row in rows)])
    if allowed:
        assert read_campaign(log, ROBOT).sigma is not None
        return
    with pytest.raises(InputError, match=r"log\.csv:2: sigma_mm is .* expected 1e-09 to 1"):
        read_campaign(log, ROBOT)


@pytest.mark.parametrize(("keep", "said"), [(1, "at least 3 rows"), (2, "at least 3 rows"), (0, "different poses")])
def test_frames_are_not_fitted_to_rows_that_leave_them_open(keep, said, tmp_path, monkeypatch, capsys) -> None:
    head, *rows = drop(read_rows(), "time_s")
    log = write_log(tmp_path, [head, *(rows[:keep] if keep else [rows[0]] * 5 + [["x", *rows[0][1:]]])])
    out = tmp_path / "out.csv"
    words = ["predict", log, "--robot", GOOD / "robot", "--register", "base,tool", "--out", out]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 2
    assert said in answer.err
    assert not out.exists()


def make_circle(radius: float) -> CircleTable:
    return CircleTable(generator="circle", radius_mm=radius, feed_mm_s=10.0, waypoints=50)


def test_a_path_of_a_few_atoms_is_refused_and_a_small_one_asked_about() -> None:
    with pytest.raises(InputError, match="is it in metres"):
        check_toolpath(make_circle(1e-9).generate())
    small = check_toolpath(check_toolpath(make_circle(0.04).generate()))
    assert [note for note in small.notes if "is it in metres" in note] == list(small.notes[-1:])
    assert not any("in metres" in note for note in check_toolpath(make_circle(40.0).generate()).notes)


@pytest.mark.parametrize("free", [True, False])
def test_an_x_along_the_tool_axis_is_refused_unless_the_tool_may_turn(free, tmp_path, monkeypatch, capsys) -> None:
    work = tmp_path / "work"
    shutil.copytree(GOOD, work)
    text = (work / "job.toml").read_text()
    new = f"rotate_about_tool_axis = {str(free).lower()}\ntool_x = [0.0, 0.001, -1.0]"
    (work / "job.toml").write_text(text.replace("rotate_about_tool_axis = true", new))
    answer = run_command(["plan", work / "job.toml", "--out", work / "out"], monkeypatch, capsys)
    assert answer.status == (0 if free else 2)
    assert ("plan.tool_x: points along the tool axis at 46 of 46 waypoints" in answer.err) != free


def test_the_angle_that_counts_as_along_is_a_degree() -> None:
    from compplan.toolpath.contact import SIDE

    assert pytest.approx(np.sin(np.pi / 180)) == SIDE
