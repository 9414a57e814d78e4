"""Run the command line in this process."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

import pytest

from compplan.cli import main


class Answer(NamedTuple):
    """What a command left with, and what it printed."""

    status: int
    out: str
    err: str


def run_command(
    arguments: Sequence[object], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Answer:
    """Run `compplan` with arguments."""
    monkeypatch.setattr(sys, "argv", ["compplan", *(str(argument) for argument in arguments)])
    with pytest.raises(SystemExit) as leaving:
        main()
    captured = capsys.readouterr()
    return Answer(int(leaving.value.code or 0), captured.out, captured.err)
