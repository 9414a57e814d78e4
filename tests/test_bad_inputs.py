"""Every bad input of the tables in tests/bad_inputs gets one line, the right exit status and no file."""

import json
from collections import Counter

import pytest

from benchmarks.bad_inputs.running import load_commands, run_case
from benchmarks.bad_inputs.tables import COMMANDS, BadInput, read_tables

CASES = read_tables()
#: A spread of the cheap ones: commands that only read.
QUICK = [case for case in CASES if case.command.startswith(("predict", "convert", "map")) and "repeat" not in case.edit]


@pytest.fixture(scope="module", autouse=True)
def loaded():
    load_commands()


def test_the_tables_hold_a_thousand_different_bad_inputs():
    inputs = [(case.command, json.dumps(case.edit, sort_keys=True)) for case in CASES]
    assert len(set(inputs)) >= 1000
    tables = Counter((case.name.partition("[")[0], *edit) for case, edit in zip(CASES, inputs, strict=True))
    assert [name for name, count in tables.items() if count > 1] == []


@pytest.mark.parametrize("run", ["predict", "convert", "convert apt", "map"])
def test_the_good_workspace_that_they_are_made_from_is_accepted(run):
    good = BadInput(run, "good", COMMANDS[run], {}, (0,), "")
    answer = run_case(good)
    assert answer.judge(good) == "", answer.err


@pytest.mark.parametrize("case", QUICK[::15], ids=lambda case: case.name)
def test_a_bad_input_is_answered_in_one_line(case):
    answer = run_case(case)
    assert answer.judge(case) == "", f"{answer.status}: {answer.err or answer.out}"


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_bad_input_is_answered_in_one_line(case):
    answer = run_case(case)
    assert answer.judge(case) == "", f"{answer.status}: {answer.err or answer.out}"
