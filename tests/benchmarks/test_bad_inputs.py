"""Every bad input of the tables in tests/bad_inputs gets one line, the right exit status and no file."""

import json
from collections import Counter

import pytest

from benchmarks.bad_inputs.mutating import draw_mutants
from benchmarks.bad_inputs.running import HUNG, KILLED, Answer, load_commands, run_case
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


# the map of the same workspace is asked for by tests/test_golden_numbers.py, too
@pytest.mark.parametrize("run", ["predict", "convert", "convert apt", pytest.param("map", marks=pytest.mark.slow)])
def test_the_good_workspace_that_they_are_made_from_is_accepted(run):
    good = BadInput(run, "good", COMMANDS[run], {}, (0,), "")
    answer = run_case(good)
    assert answer.judge(good) == "", answer.err


@pytest.mark.parametrize("case", QUICK[::15], ids=lambda case: case.name)
def test_a_bad_input_is_answered_in_one_line(case):
    answer = run_case(case)
    assert answer.judge(case) == "", f"{answer.status}: {answer.err or answer.out}"


@pytest.mark.parametrize("case", list(draw_mutants(400, 7, first=0))[::50], ids=lambda case: case.name)
def test_a_mutant_ends_in_no_fault(case):
    answer = run_case(case)
    assert answer.judge(case) == "", f"{answer.status}: {answer.err or answer.out}"


def test_a_mutant_is_the_same_whatever_else_is_drawn():
    assert [case.edit for case in draw_mutants(3, 5, first=20)] == [case.edit for case in draw_mutants(23, 5)][20:]


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        (Answer(-11, "", "", 1.0, 1, (), ""), "status -11"),
        (Answer(KILLED, "", "", 1.0, 1, (), ""), "traceback"),
        (Answer(HUNG, "", "", 1.0, 1, (), ""), "too long"),
        (Answer(0, "", "", 1.0, 1, (), ""), "silent"),
        (Answer(2, "", "", 1.0, 1, (), ""), "not one line"),
        (Answer(2, "", "error: internal fault KeyError: x (y.py:1)\n", 1.0, 1, (), ""), "internal fault"),
        (Answer(2, "", "error: x\n", 1.0, 1, ("out/plan.json",), ""), "left files"),
        (Answer(2, "", "error: x\n", 1.0, 1, (), ""), ""),
        (Answer(0, "", "", 1.0, 1, ("out/plan.json",), ""), ""),
    ],
)
def test_every_kind_of_fault_is_told_apart(said, fault):
    assert said.judge(BadInput("x", "mutants", "plan", {}, (0, 2, 3), "")) == fault
