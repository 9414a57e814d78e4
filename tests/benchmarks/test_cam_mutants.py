from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.bad_inputs.cam_mutants import PROGRAMS, SLOWEST, run_mutants
from compplan.toolpath.readers import READERS, CamTable, read_cam


@pytest.mark.parametrize("language", list(READERS))
def test_mutants_are_read_or_refused_in_one_line(language: str) -> None:
    tally = run_mutants(language, 150, seed=3)
    assert tally.failures == [] and tally.slowest < SLOWEST
    assert tally.read > 5 and tally.refused > 5


@pytest.mark.slow
@pytest.mark.parametrize("language", list(READERS))
def test_ten_thousand_mutants_are_read_or_refused(language: str) -> None:
    tally = run_mutants(language, 10_000, seed=1)
    assert tally.failures == [] and tally.slowest < SLOWEST


@pytest.mark.parametrize("language", list(PROGRAMS))
def test_the_programs_that_mutants_are_drawn_from_are_read(language: str, tmp_path: Path) -> None:
    file = tmp_path / f"part{READERS[language].suffixes[0]}"
    file.write_text(PROGRAMS[language])
    assert read_cam(file, CamTable(rotary="head", compensation="centre_line")).facts.cutting_moves > 3
