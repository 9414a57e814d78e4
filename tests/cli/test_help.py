"""Help texts, completion and progress of the command line."""

from __future__ import annotations

import re
import shlex

import pytest
from click.shell_completion import BashComplete
from click.testing import CliRunner

from compplan.cli import COMMANDS, group, load_command
from compplan.cli.commands.plan import STAGES
from compplan.cli.terminal import find_stage


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_help_text_ends_with_an_example_that_the_command_takes(name: str) -> None:
    text = " ".join(CliRunner().invoke(group, [name, "--help"]).output.split())
    found = re.search(rf"Example: (compplan {name} .*?) (?:Example|Options):", text)
    assert found, text
    words = [word for word in shlex.split(found.group(1)) if word != ">>"][2:]
    known = {option for parameter in load_command(name).params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known


def test_the_shell_completes_commands_and_options() -> None:
    shell = BashComplete(group, {}, "compplan", "_COMPPLAN_COMPLETE")
    assert [item.value for item in shell.get_completions([], "mon")] == ["montecarlo"]
    assert "--register" in [item.value for item in shell.get_completions(["diagnose"], "--r")]


def test_a_stage_counts_what_is_behind() -> None:
    assert find_stage("robot and toolpath", STAGES) == 0
    assert find_stage("compensation of 4716 waypoints", STAGES) == 3
    assert find_stage("write: programs", STAGES) == len(STAGES) - 1
    assert find_stage("something else", STAGES) == 0
