"""The shipped jobs and campaigns keep their numbers: joints, deviation, cycle and diagnosis, asked on the command line.

`python tests/test_golden_jobs.py` writes tests/golden anew; whoever does it says in the commit which numbers changed.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
GOLDEN = Path(__file__).parent / "golden"
#: Joints agree within this. [deg]
JOINTS_DEG = np.rad2deg(1e-9)
#: Rows of joints.csv that are kept of each job.
ROWS = 9
QUICK = (
    "paths/circle_10mm", "paths/limits_reach", "paths/limits_feed", "examples/first_part/part", "examples/rail/circle",
    "examples/forces/plate", "examples/positioner/groove",
)  # fmt: skip
LONG = (
    "paths/isf_cone", "paths/circle_spindle_90", "paths/gcode", "paths/freeform", "examples/forces/finishing",
    "examples/forces/isf_cone", "examples/forces/pocket", "paths/circle_500mm", "paths/spiral", "examples/forces/weld",
    "examples/two_tools/bracket",
)  # fmt: skip
CAMPAIGNS = {
    "examples/identify": ("examples/identify/measurements.csv", "kuka_kr270"),
    "notebooks/diagnose_campaign": ("notebooks/diagnose_campaign/measurements.csv", "kuka_kr270"),
}


def run(*words: str | Path) -> int:
    command = [sys.executable, "-m", "compplan", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).returncode


def summarise_plan(out: Path) -> dict[str, Any]:
    """Keep status, count, deviation and cycle, and a few rows of joints."""
    plan = json.loads((out / "plan.json").read_text(encoding="utf-8"))
    with (out / "joints.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    axes = [name for name in rows[0] if name[0] == "q" and name[1].isdigit()]
    kept = np.unique(np.linspace(0, len(rows) - 1, ROWS).astype(int))
    return {
        "status": plan["status"],
        "rows": len(rows),
        "cycle_s": float(rows[-1]["time_s"]),
        "after_max_mm": plan["error_after_mm"]["max"],
        "before_max_mm": plan["error_before_mm"]["max"],
        "axes": axes,
        "joints": {int(k): [float(rows[k][name]) for name in axes] for k in kept},
    }


def summarise_diagnosis(out: Path) -> dict[str, Any]:
    """Keep what is claimed, with its sizes, and the gap before and after."""
    said = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return {
        "status": said["verdict"]["status"],
        "effects": [
            {key: effect[key] for key in ("effect", "joint", "axis", "parameters")}
            for effect in said["verdict"]["effects"]
        ],
        "gap": {key: value for key, value in said["gap"].items() if isinstance(value, float)},
    }


def solve(job: str, out: Path) -> dict[str, Any]:
    assert run("plan", f"{job}.toml", "--out", out) in (0, 3)
    return summarise_plan(out)


def diagnose(name: str, out: Path) -> dict[str, Any]:
    log, robot = CAMPAIGNS[name]
    assert run("diagnose", log, "--robot", robot, "--out", out) == 0
    return summarise_diagnosis(out)


def read_golden(name: str) -> dict[str, Any]:
    golden: dict[str, Any] = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    return golden


def check_job(job: str, out: Path) -> None:
    found, golden = solve(job, out), read_golden("jobs")[job]
    assert [found[key] for key in ("status", "rows", "axes")] == [golden[key] for key in ("status", "rows", "axes")]
    assert found["cycle_s"] == pytest.approx(golden["cycle_s"], rel=1e-6)
    assert found["before_max_mm"] == pytest.approx(golden["before_max_mm"], abs=1e-6)
    assert found["after_max_mm"] == pytest.approx(golden["after_max_mm"], abs=1e-6)
    assert found["status"] != "solved" or found["after_max_mm"] < 1e-6
    for row, joints in found["joints"].items():
        assert np.allclose(joints, golden["joints"][str(row)], rtol=0.0, atol=JOINTS_DEG), f"row {row}"


@pytest.mark.parametrize("job", QUICK)
def test_a_shipped_job_keeps_its_joints(job: str, tmp_path: Path) -> None:
    check_job(job, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("job", LONG)
def test_a_long_shipped_job_keeps_its_joints(job: str, tmp_path: Path) -> None:
    check_job(job, tmp_path / "out")


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_shipped_campaign_keeps_its_diagnosis(name: str, tmp_path: Path) -> None:
    found, golden = diagnose(name, tmp_path / "out"), read_golden("campaigns")[name]
    assert found["status"] == golden["status"]
    assert [e["effect"] for e in found["effects"]] == [e["effect"] for e in golden["effects"]]
    for one, other in zip(found["effects"], golden["effects"], strict=True):
        assert (one["joint"], one["axis"]) == (other["joint"], other["axis"])
        numbers = {key: value for key, value in other["parameters"].items() if isinstance(value, float)}
        assert {key: one["parameters"][key] for key in numbers} == pytest.approx(numbers, rel=1e-3, abs=1e-9)
    assert found["gap"] == pytest.approx(golden["gap"], rel=1e-3, abs=1e-6)


def main() -> None:
    """Write the golden files."""
    with tempfile.TemporaryDirectory() as folder:
        jobs = {job: solve(job, Path(folder) / job) for job in (*QUICK, *LONG)}
        campaigns = {name: diagnose(name, Path(folder) / name) for name in CAMPAIGNS}
    for name, golden in (("jobs", jobs), ("campaigns", campaigns)):
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in golden.items())
        (GOLDEN / f"{name}.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
