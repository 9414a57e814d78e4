"""Help texts, completion and progress of the command line."""

from __future__ import annotations

import re
import shlex

import pytest
from click.shell_completion import BashComplete
from click.testing import CliRunner

from compplan.cli import COMMANDS, group, load_command


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
