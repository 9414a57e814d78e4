"""Every study that can be run stands under a question."""

from __future__ import annotations

from pathlib import Path

from benchmarks import QUESTIONS

ROOT = Path(__file__).parents[2]


def test_every_study_stands_under_its_question_and_in_contributing() -> None:
    folder = ROOT / "benchmarks"
    told = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    listed = {name for names in QUESTIONS.values() for name in names}
    runs = [file for file in folder.rglob("*.py") if '__name__ == "__main__"' in file.read_text(encoding="utf-8")]
    names = {".".join(file.relative_to(folder).with_suffix("").parts).removesuffix(".__main__") for file in runs}
    assert names - {"__main__", "figaroh_peer"} == listed  # the latter runs under another interpreter
    assert [name for name in sorted(listed) if f"python -m benchmarks {name}" not in told] == []
