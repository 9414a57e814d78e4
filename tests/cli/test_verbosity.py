"""How much a command says: bare help, -v, -q."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from commandline import run_command

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"


def test_compplan_alone_shows_its_help_on_several_lines(monkeypatch, capsys) -> None:
    answer = run_command([], monkeypatch, capsys)
    assert answer.status == 0
    assert answer.out.startswith("Usage: ")
    assert len(answer.out.splitlines()) > 25
    assert answer.err == ""


@pytest.mark.parametrize("words", [["-q", "forces"], ["forces", "-q"]])
def test_quiet_prints_nothing_and_still_writes(words, tmp_path, monkeypatch, capsys) -> None:
    answer = run_command([*words, GOOD / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer == (0, "", "")
    assert (tmp_path / "out" / "forces.json").is_file()


def test_quiet_prints_the_summary_that_json_asks_for_and_errors(tmp_path, monkeypatch, capsys) -> None:
    answer = run_command(["-q", "doctor", GOOD / "robot", "--json"], monkeypatch, capsys)
    assert answer.out.startswith("{")
    answer = run_command(["-q", "plan", GOOD / "nowhere.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert answer.err.startswith("error: ")


@pytest.mark.parametrize(("words", "files"), [(["-v", "forces"], False), (["forces", "-vv"], True)])
def test_verbose_tells_what_is_done_on_stderr(words, files, tmp_path, monkeypatch, capsys) -> None:
    answer = run_command([*words, GOOD / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0
    assert f"wrote {tmp_path / 'out'}" in answer.err
    assert ("read " in answer.err) == files
    assert logging.getLogger("compplan").handlers == []
    assert "wrote" in answer.out
