"""What `compplan plan` prints."""

from __future__ import annotations

from pathlib import Path

import pytest
from commandline import run_command

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("job", ["circle_10mm", "circle_500mm", "limits_reach"])
def test_a_plan_prints_six_lines_of_100_characters_at_most(
    job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = run_command(["plan", ROOT / "paths" / f"{job}.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    lines = answer.out.splitlines()
    assert 3 <= len(lines) <= 6 and max(map(len, lines)) <= 100
    assert "->" in answer.out and "wrote report.html" in answer.out
