"""Programs in the exact form of common posts: every move that is read is the one that the standards ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from truth_cases import Case, find_difference_from, list_cases

from benchmarks import reading

CASES = list_cases()
NAMES = [case.file.name for case in CASES]


def test_there_are_forty_programs_with_heads_and_ends() -> None:
    assert len(CASES) >= 40
    assert len({case.form for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_the_reader_goes_where_the_program_goes(case: Case) -> None:
    assert find_difference_from(case) == ""


def test_the_table_of_what_is_read_is_as_it_would_be_written_now() -> None:
    page = reading.PAGE.read_text(encoding="utf-8")
    assert page == reading.fill_page(page), "python -m benchmarks reading writes it"


@pytest.mark.parametrize("column", ["end", "axis", "feed"])
def test_a_move_that_is_another_is_seen(column: str) -> None:
    moves = CASES[0].moves
    other = np.array(getattr(moves, column))
    row = int(np.flatnonzero(moves.feed > 0)[1])
    if column == "axis":
        other[:] = [np.sin(0.1), 0.0, np.cos(0.1)]
    else:
        other[row] += 1e-4 if column == "end" else 0.1
    assert find_difference_from(CASES[0], replace(moves, **{column: other}))
