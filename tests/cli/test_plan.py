"""What `compplan plan` prints: six lines, then every note that must be settled, whole."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from commandline import run_command

from compplan.io.notes import Stop
from compplan.planning.checks import state_notes
from compplan.reporting.plan_summary import WIDTH, format_plan
from tests.reporting.test_report import make_plan

PATHS = Path(__file__).parents[2] / "paths"
README = (PATHS.parent / "README.md").read_text(encoding="utf-8")
SETTLE = "before the machine moves: "


@pytest.mark.parametrize("job", ["circle_10mm", "limits_reach"])
def test_a_plan_prints_six_lines_and_ends_with_the_next_step(
    job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("jobs").mkdir()
    given = str(shutil.copy(PATHS / f"{job}.toml", "jobs"))
    answer = run_command(["plan", given, "--out", "out"], monkeypatch, capsys)
    lines = answer.out.splitlines()
    raised = r"the other \d+ need plan.max_correction_mm above [\d.]+"
    move = rf"next: run compplan place {given} \(\d+ waypoints\)"
    assert job != "limits_reach" or re.fullmatch(f"{move}; {raised}", lines[-1])
    stops = json.loads(Path("out/plan.json").read_text(encoding="utf-8"))["stops"]
    settle = [line.removeprefix(SETTLE) for line in lines if line.startswith(SETTLE)]
    others = [line for line in lines if not line.startswith(SETTLE)]
    assert settle == stops
    assert len(others) == 6 and max(map(len, others)) <= WIDTH
    assert "95 %" in others[1] and lines[-2].startswith("wrote report.html") and lines[-1].startswith("next: ")


def test_long_notes_that_must_be_settled_are_not_cut_and_remarks_are_counted() -> None:
    stops = [Stop("check every axis against the display " * 9), Stop("is z of the part turned over?")]
    plan = make_plan().add_checks(state_notes([stops[0], "a remark", stops[1], "another remark"]))
    lines = format_plan(plan, Path("out"), [Path("out/plan.json")])
    assert lines[-4:-2] == [f"{SETTLE}{stop}" for stop in stops]
    assert any(line.startswith("wrote plan.json") for line in lines)
    assert "wrote report.html (2 notes), plan.json to out" in format_plan(
        plan, Path("out"), [Path("out/plan.json"), Path("out/report.html")]
    )
    assert not any("a remark" in line for line in lines)


def test_the_first_plan_of_the_readme_ends_with_keeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = next(line for line in README.splitlines() if line.startswith("    compplan plan ")).split()[2]
    answer = run_command(["plan", PATHS.parent / job, "--out", tmp_path / "out"], monkeypatch, capsys)
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert answer.status == 0 and answer.out.startswith("Keeps 0.5 mm: ")
    assert plan["error_before_mm"]["max"] > 5.5 and plan["error_band_mm"]["whole_path_p95"] < 0.5
    assert f"up to {plan['error_before_mm']['max']:.1f} mm" in README
    assert f"within {plan['error_band_mm']['whole_path_p95']:.2f} mm" in README


def test_keys_of_a_job_are_set_on_the_command_line_and_stand_among_the_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "--set",
        "plan.tolerance_mm=3",
        "--set",
        "plan.strategy=mirror",
        "--set",
        "part.position_mm=[1650, 0, 900]",
    ]
    answer = run_command(["plan", PATHS / "circle_10mm.toml", *words, "--out", tmp_path / "out"], monkeypatch, capsys)
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    assert answer.status == 0 and " 3 mm" in answer.out.splitlines()[0] and plan["strategy"] == "mirror"
    assert "--set plan.tolerance_mm=3" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    table = (tmp_path / "out" / "joints.csv").read_text(encoding="utf-8").splitlines()
    x = [float(row.split(",")[7]) for row in table if row.endswith(",cut")]
    assert max(x) == pytest.approx(1660.0, abs=1e-3)


@pytest.mark.parametrize("command", ["plan", "compare", "montecarlo", "forces", "place", "campaign", "learn"])
def test_a_key_or_value_that_no_job_has_is_refused_by_every_command_in_a_line(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    more = {"campaign": ["--poses", "5"], "learn": ["part.csv", "--robot", "kuka_kr270"]}.get(command, [])
    for change, fault in (
        ("plan.tolerence_mm=3", "--set plan.tolerence_mm: unknown key, choose from ['tolerance_mm', 'strategy'"),
        ("plan=3", "--set plan: is 3, must be a section of keys; give one of them, such as plan.KEY = VALUE"),
        ("plan.speed=3", "--set plan.speed: unknown key, choose from ['strategy'"),
        ("plan.tolerance_mm=[1", "--set plan.tolerance_mm: is '[1', expected a TOML value"),
        ("part.position_mm=[1.0]", "--set part.position_mm[1]: missing number"),
        ("robot.x=1", "--set robot.x: 'robot' is not a section of the job"),
        ("plan", "--set is 'plan', expected KEY=VALUE such as plan.tolerance_mm=0.05"),
    ):
        words = [command, PATHS / "circle_10mm.toml", *more, "--set", change, "--out", tmp_path / "out"]
        answer = run_command(words, monkeypatch, capsys)
        assert answer.status == 2 and answer.err.startswith(f"error: {fault}") and answer.err.count("\n") == 1
        assert not (tmp_path / "out").exists()
