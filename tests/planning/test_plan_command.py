"""The commands plan and compare: files, summaries, exit statuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.io.columns import FileColumn
from compplan.io.tables import read_table
from compplan.robot import load_robot
from compplan.simulation.exact import build_exact_robot, solve_exact_pose

PATHS = Path(__file__).parents[2] / "paths"


@pytest.fixture
def small_job(tmp_path):
    """Write a small job beside no other file."""
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 80")
    assert "[plan]" in text
    text = text.replace("[plan]", "[plan]\ninertia = false")  # the tip at rest is asked for
    file = tmp_path / "circle.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_plan_writes_every_file_of_the_contract(small_job, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    answer = run_command(["plan", small_job, "--out", out], monkeypatch, capsys)
    assert answer.status == 0 and answer.err == ""
    assert {"plan.json", "joints.csv", "report.html"} <= {path.name for path in out.iterdir()}
    assert list(out.rglob("*.src"))
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
    plan = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert plan["schema"] == 1 and plan["status"] == "solved" and plan["waypoints"] == 80
    assert plan["error_after_mm"]["max"] < 1e-3 < plan["error_before_mm"]["max"]
    assert plan["error_before_mm"].keys() == {"rms", "mean", "max"}
    assert {"position_limit_deg", "velocity_ratio", "acceleration_ratio"} <= plan["margins"].keys()
    assert {"strategy", "robot", "configuration", "solve_time_s", "correction_mm"} <= plan.keys()


def test_joints_csv_puts_the_loaded_tool_on_the_path(small_job, tmp_path, monkeypatch, capsys):
    run_command(["plan", small_job, "--out", tmp_path / "out"], monkeypatch, capsys)
    wrench = [FileColumn(f"f{a}", "force") for a in "xyz"] + [FileColumn(f"m{a}", "moment") for a in "xyz"]
    columns = [FileColumn("time", "time"), FileColumn("q#", "angle"), *(FileColumn(a, "length") for a in "xyz")]
    file = tmp_path / "out" / "joints.csv"
    # the kind of the move stands last and is not a number
    lines = [line.rsplit(",", 1) for line in file.read_text(encoding="utf-8").splitlines()]
    assert lines[0][1] == "move"
    moves = [kind for _, kind in lines[1:]]
    file.write_text("\n".join(line for line, _ in lines) + "\n", encoding="utf-8")
    table = read_table(file, [*columns, *(FileColumn(a) for a in "ijk"), *wrench])
    q, load = table.stack(table.numbered("q#")), table.stack(["fx", "fy", "fz", "mx", "my", "mz"])
    position, rotation, _ = solve_exact_pose(build_exact_robot(load_robot("kuka_kr270")), q, load)
    cut = np.array(moves) == "cut"
    assert cut.sum() == 80 and {"approach", "retract"} <= set(moves)
    assert np.abs(position - table.stack(["x", "y", "z"]))[cut].max() < 1e-8
    assert np.abs(-rotation[:, :, 2] - table.stack(["i", "j", "k"]))[cut].max() < 1e-8
    time, wanted = table.values["time"], table.stack(["x", "y", "z"])
    assert time[0] == 0.0 and (np.diff(time) > 0).all()
    speed = np.linalg.norm(np.diff(wanted[cut], axis=0), axis=1) / np.diff(time[cut])
    assert speed[10:-10] == pytest.approx(0.01, rel=1e-3)
    assert_summary(json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8")), q, wanted, time, cut)


def assert_summary(plan, q, wanted, time, cut):
    """Work the figures of plan.json out again, in their units, from joints.csv."""
    robot = load_robot("kuka_kr270")
    rigid = build_exact_robot(replace(robot, springs=(), link_elasticities=()))
    unloaded = solve_exact_pose(rigid, q, np.zeros((len(q), 6)))[0]
    correction = 1e3 * np.linalg.norm(unloaded - wanted, axis=1)[cut].max()
    assert plan["correction_mm"]["max"] == pytest.approx(correction, rel=1e-6) == pytest.approx(2.463, abs=1e-3)
    # what is taken off is what the force would have bent, but for what its lever changes on the way
    assert plan["error_before_mm"]["max"] == pytest.approx(correction, rel=2e-3)
    degrees, lower, upper = np.degrees(q[cut]), np.degrees(robot.lower), np.degrees(robot.upper)
    assert plan["margins"]["position_limit_deg"] == pytest.approx(np.minimum(degrees - lower, upper - degrees).min())
    rates = np.abs(np.diff(q[cut], axis=0) / np.diff(time[cut])[:, None]) / robot.velocity_limits
    assert plan["margins"]["velocity_ratio"] == pytest.approx(rates.max(), rel=1e-2)
    assert plan["duration_s"] == pytest.approx(np.ptp(time[cut]))
    assert plan["tilt_after_deg"]["max"] < 1e-6


def test_plan_prints_its_summary_as_json(small_job, tmp_path, monkeypatch, capsys):
    answer = run_command(["plan", small_job, "--out", tmp_path / "out", "--json"], monkeypatch, capsys)
    assert json.loads(answer.out) == json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))


def test_an_infeasible_plan_leaves_with_3_and_writes_the_marked_compromise(tmp_path, monkeypatch, capsys):
    answer = run_command(["plan", PATHS / "limits_reach.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert answer.status == 3
    assert len(answer.err.strip().splitlines()) == 1
    assert "lower position limit of joint_2" in answer.err and "the first is waypoint 175 " in answer.err
    assert plan["status"] == "infeasible"
    assert {failure["limit"] for failure in plan["failures"]} >= {"correction limit"}
    assert "nfeasible" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_compare_prints_and_writes_the_table(small_job, tmp_path, monkeypatch, capsys):
    answer = run_command(["compare", small_job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0
    for word in ("none", "mirror", "iterated_mirror", "nlp"):
        assert word in answer.out
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"compare.json", "report.html", "manifest.json"}
    found = json.loads((tmp_path / "out" / "compare.json").read_text(encoding="utf-8"))["strategies"]
    # as in plan.json, 2.46 mm; a fifth softer or stiffer is a fifth more or less of what is left alone
    assert found["none"]["max_mm"] == pytest.approx(2.462, rel=1e-3) and found["nlp"]["max_mm"] < 1e-6
    cells = {entry["cell"]: entry for entry in found["none"]["under_mismatch"]}
    for cell, share in (("compliance x 1.2", 1.2), ("compliance x 0.8", 0.8)):
        for name in ("rms_mm", "max_mm"):
            assert cells[cell][name] == pytest.approx(share * found["none"][name], rel=2e-3)
