"""No number of tables and summaries changes unmeant."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from golden_numbers import COMMANDS, GOLDEN, differences, fold_outputs, run_command_line

GOLD = json.loads(GOLDEN.read_text(encoding="utf-8"))


#: Commands of the weekly run: other tests compare what they compute.
WEEKLY = {"place", "map", "learn"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in WEEKLY else name for name in COMMANDS]
)
def test_every_number_that_a_command_writes_is_the_one_that_was_meant(name: str, tmp_path: Path) -> None:
    out, printed = run_command_line(COMMANDS[name], tmp_path)
    found = fold_outputs(out, printed)
    changed = list(differences(found, GOLD[name]))
    assert not changed, "\n".join([*changed[:20], "if all of these are meant: python tests/support/golden_numbers.py"])
