"""The page of `compplan convert --report`."""

from __future__ import annotations

from pathlib import Path

import pytest
from commandline import run_command


def test_the_page_shows_box_tools_and_assumptions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cam, page = tmp_path / "part.nc", tmp_path / "read" / "report.html"
    cam.write_text("G21 G90\nT1 M6\nG0 X0 Y0 Z5\nG1 Z-1 F600\nG1 X10 Y20\nT2 M6\nG0 Z5\nG1 Z-3\nM30\n")
    words = ["convert", cam, "--out", tmp_path / "part.csv", "--report", page.parent]
    assert run_command(words, monkeypatch, capsys).status == 0
    text = page.read_text()
    assert all(word in text for word in ("part.nc is read", "T1", "T2", "Box of the cut", "rapid"))
