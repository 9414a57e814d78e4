"""Bad input gives one clear line, exit status 2 and no file; a sound request without a solution 3."""

import re
from pathlib import Path

import pytest
from commandline import run_command

HEADER = "x_mm,y_mm,z_mm,feed_mm_s,fx_N,fy_N,fz_N\n"
ROWS = [[f"{x}", "0", "0", "10", "0", "0", "500"] for x in range(0, 50, 5)]


def write_job(folder: Path, rows=ROWS, header=HEADER, robot="staubli_tx200", part="1500, 0, 300", plan=""):
    (folder / "path.csv").write_text(header + "".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    job = folder / "job.toml"
    head = f'schema = 1\nrobot = "{robot}"\ntoolpath = "path.csv"\n'
    job.write_text(f"{head}[part]\nposition_mm = [{part}]\n[plan]\n{plan}\n", encoding="utf-8")
    return job


def change(column, value, row=3):
    rows = [list(entry) for entry in ROWS]
    rows[row][column] = value
    return rows


CASES = {
    "missing column": (
        {"header": HEADER.replace("z_mm,", ""), "rows": [row[:2] + row[3:] for row in ROWS]},
        r"path\.csv:1: missing column z_mm",
    ),
    "NaN": ({"rows": change(1, "nan")}, r"path\.csv:5: column 'y_mm' is empty \(or NaN\) here"),
    "text for a number": ({"rows": change(6, "much")}, r"path\.csv:5: column 'fz_N' holds 'much', expected a number"),
    "unknown robot": ({"robot": "kuka_kr9"}, r"job\.toml: robot: no robot named 'kuka_kr9', choose from \["),
    "unreachable part": ({"part": "9000, 0, 300"}, r"job\.toml: .*the part is out of reach"),
    "joint start outside limits": (
        {"plan": "start_deg = [0, 49.7, 89.3, 0, 141, 0]"},
        r"job\.toml: plan\.start_deg: joint 'joint_5' starts at 141 deg, limits \[",
    ),
    "start of the wrong length": (
        {"plan": "start_deg = [0, 49.7, 89.3]"},
        r"job\.toml: plan\.start_deg: start has 3 joint positions, the robot has 6",
    ),
    "unknown key": ({"plan": "speed = 3"}, r"job\.toml: plan\.speed: unknown key, choose from \["),
    "zero-length path": ({"rows": [ROWS[0]] * 5}, r"path\.csv.*: toolpath has zero length: all waypoints coincide"),
    "zero feed": ({"rows": change(3, "0")}, r"path\.csv:5: feed is 0 mm/s, expected more than 0 on a cutting move"),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("command", ["plan", "compare"])
def test_bad_input_leaves_with_2_one_line_and_no_file(case, command, tmp_path, monkeypatch, capsys):
    changes, sentence = CASES[case]
    job = write_job(tmp_path, **changes)
    answer = run_command([command, job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    lines = answer.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert re.search(sentence, lines[0]), lines[0]
    assert answer.out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["job.toml", "path.csv"]


def test_the_good_job_beside_the_bad_ones_is_planned(tmp_path, monkeypatch, capsys):
    answer = run_command(["plan", write_job(tmp_path), "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0, answer.err


def test_a_missing_job_is_named(tmp_path, monkeypatch, capsys):
    answer = run_command(["plan", tmp_path / "no.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert "no.toml: no such file" in answer.err


def test_a_path_that_is_partly_out_of_reach_leaves_with_3_and_names_the_waypoints(tmp_path, monkeypatch, capsys):
    rows = [[f"{x}", *row[1:]] for x, row in zip(range(0, 500, 50), ROWS, strict=True)]
    job = write_job(tmp_path, rows=rows, part="1600, 0, 300", plan="[sampling]\nmax_step_mm = 50.0")
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 3
    assert (
        re.search(r"of \d+ waypoints are out of reach", answer.err)
        and "`compplan place` looks for a place" in answer.err
    )
    assert "reach of the arm" in answer.err and "the first is waypoint" in answer.err
    assert (tmp_path / "out" / "plan.json").is_file()
