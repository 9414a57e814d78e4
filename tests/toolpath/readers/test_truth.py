"""Programs in the exact form of common posts: every move of both readers is the one that the standards ask for."""

from __future__ import annotations

import numpy as np
import pytest
from truth_cases import Case, find_difference_from, find_wrong_move, list_cases

from benchmarks import reading
from tests.oracles.cam.cam import read_moves

CASES = list_cases()
NAMES = [case.file.name for case in CASES]
#: Programs that the first reader does not read as they are, and what it does instead. Nothing may be added.
OPEN: dict[str, str] = {}


def test_there_are_forty_programs_with_heads_and_ends() -> None:
    assert len(CASES) >= 40
    assert len({case.form for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_the_second_reader_finds_every_move(case: Case) -> None:
    assert find_wrong_move(read_moves(case.file, dict(case.options)), case.moves) == ""


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_the_first_reader_goes_where_the_program_goes(case: Case, request: pytest.FixtureRequest) -> None:
    if case.file.name in OPEN:
        request.applymarker(pytest.mark.xfail(reason=OPEN[case.file.name]))
    assert find_difference_from(case) == ""


def test_the_table_of_what_is_read_is_as_it_would_be_written_now() -> None:
    words = (reading.judge_first(CASES[0]), reading.judge_second(CASES[0]))
    assert all(word in ("as it is", "refused", "otherwise", "cannot tell") for word in words)
    page = reading.PAGE.read_text(encoding="utf-8")
    names = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")][1:]
    assert names == NAMES
    assert page == reading.write_page(), "python -m benchmarks reading writes it"


def test_a_wrong_move_is_seen() -> None:
    case = CASES[0]
    other = np.array(case.moves.end)
    other[2, 0] += 1e-5
    moved = type(case.moves)(**{**vars(case.moves), "end": other})
    assert "move 2" in find_wrong_move(moved, case.moves)
