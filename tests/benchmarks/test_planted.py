"""The lists of planted mistakes: each can be planted, and a test that fails is found."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from benchmarks.planted import LISTS, ROOT, find_test


@pytest.mark.parametrize("file", LISTS, ids=lambda file: file.stem)
def test_every_mistake_can_be_planted(file: Path) -> None:
    listed = tomllib.loads(file.read_text(encoding="utf-8"))["mistake"]
    assert len({(entry["name"], entry["area"]) for entry in listed}) == len(listed)
    for entry in listed:
        text = (ROOT / "compplan" / entry["file"]).read_text(encoding="utf-8")
        assert entry["old"] in text, f"{entry['name']}: the text is no longer in {entry['file']}"
        assert entry["old"] != entry["new"]
        assert all((ROOT / "tests" / path).exists() for path in entry.get("tests", []))


def test_the_first_failing_test_is_named(tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("def test_one():\n    pass\ndef test_two():\n    assert 0\n")
    assert find_test(tmp_path, ["test_a.py::test_one"]) == ""
    assert find_test(tmp_path, ["test_a.py"]) == "tests/test_a.py::test_two"
