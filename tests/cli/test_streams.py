"""Closed streams, readers that leave, paths that are no UTF-8: the plan is written and the exit status is right."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GOOD = ROOT / "tests" / "bad_inputs" / "good"
#: A name that no text encoding of today can read.
ODD = os.fsdecode(b"j\xe9b\xff")


def run_shell(line: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run a line of shell; $C is compplan."""
    known = {**os.environ, "PYTHONPATH": str(ROOT), "C": f"{sys.executable} -m compplan", **environment}
    command = ["bash", "-c", f"set -o pipefail; {line}"]
    return subprocess.run(command, cwd=folder, env=known, capture_output=True, timeout=120, check=False)


@pytest.fixture
def work(tmp_path: Path) -> Path:
    shutil.copytree(GOOD, tmp_path / "work")
    return tmp_path / "work"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plan with open streams, once."""
    work = tmp_path_factory.mktemp("open") / "work"
    shutil.copytree(GOOD, work)
    assert run_shell("$C plan job.toml --out out", work).returncode == 0
    return work / "out"


@pytest.mark.parametrize("closing", ["<&- >&- 2>&-", "| true", "> /dev/full 2>&1"])
def test_a_plan_is_written_whatever_becomes_of_the_streams(work: Path, whole: Path, closing: str) -> None:
    answer = run_shell(f"$C plan job.toml --out out {closing}", work)
    assert answer.returncode == (2 if "full" in closing else 0), answer.stderr
    names = {path.name for path in (work / "out").iterdir()}
    assert names == {path.name for path in whole.iterdir()} >= {"plan.json", "joints.csv"}
    assert (work / "out" / "joints.csv").read_bytes() == (whole / "joints.csv").read_bytes()
    assert json.loads((work / "out" / "plan.json").read_text())["status"] == "solved"


@pytest.mark.parametrize("closing", ["<&- >&- 2>&-", "2>/dev/full"])
def test_bad_input_ends_with_2_where_nobody_can_read_why(work: Path, closing: str) -> None:
    assert run_shell(f"$C convert nowhere.nc --out out {closing}", work).returncode == 2


def test_a_full_disk_behind_standard_output_is_said() -> None:
    answer = run_shell("$C --version > /dev/full", ROOT)
    assert answer.returncode == 2
    assert answer.stderr.decode().splitlines() == [
        "error: standard output cannot be written: No space left on device; the output files are complete"
    ]


def test_paths_that_are_no_utf8_are_read_written_and_shown(tmp_path: Path) -> None:
    work = tmp_path / ODD
    shutil.copytree(GOOD, work)
    (work / "job.toml").rename(work / f"{ODD}.toml")
    shutil.copytree(work / "robot", work / ODD)
    odd = "$(printf 'j\\xe9b\\xff')"
    answer = run_shell(f'$C plan "{odd}.toml" --out "{odd} out"', work, PYTHONIOENCODING="ascii")
    assert answer.returncode == 0, answer.stderr
    plan = json.loads((work / f"{ODD} out" / "plan.json").read_text())
    assert not [letter for letter in str(plan) if "\ud800" <= letter <= "\udfff"]
    assert any(name.endswith("j\\xe9b\\xff.toml") for name in plan["made_by"]["inputs_sha256"])
    answer = run_shell(f'$C predict log.csv --robot "{odd}" --out "{odd}.csv"; $C plan "no{odd}" --out out', work)
    assert answer.returncode == 2
    assert (work / f"{ODD}.csv").is_file()
    assert answer.stderr.decode().splitlines() == ["error: noj\\udce9b\\udcff: no such file"]
    answer = run_shell(f'$C plan "{odd}.toml" --robot "{odd}" --out out', work)
    assert answer.returncode == 2
    assert b"not UTF-8" in answer.stderr
