from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.cam_chain import INPUTS, LANGUAGES, run_chain


@pytest.mark.parametrize(("source", "language"), [("gcode", "krl"), ("apt", "sinumerik")])
def test_a_cam_file_becomes_a_program_that_another_reader_reads(source: str, language: str, tmp_path: Path) -> None:
    assert [row.faults for row in run_chain(source, language, tmp_path) if row.faults] == []


@pytest.mark.slow
@pytest.mark.parametrize("source", INPUTS)
@pytest.mark.parametrize("language", LANGUAGES)
def test_every_cam_language_becomes_every_program_language(source: str, language: str, tmp_path: Path) -> None:
    rows = run_chain(source, language, tmp_path)
    assert rows and [row.faults for row in rows if row.faults] == []
