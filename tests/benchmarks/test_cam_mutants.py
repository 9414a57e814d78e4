from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.bad_inputs.cam_mutants import PROGRAMS, SLOWEST, run_mutants
from compplan.errors import InputError
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


@pytest.mark.parametrize(("name", "text"), [("a.nc", f"M98 P{'9' * 400}\nM30\n"), ("a.mpf", f"{'ROT' * 100}\nM30\n")])
def test_calls_that_no_control_has_are_refused(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(f"G21 G90 G0 X0 Y0 Z5\nG1 X9 F100\n{text}")
    with pytest.raises(InputError):
        read_cam(tmp_path / name, CamTable())
