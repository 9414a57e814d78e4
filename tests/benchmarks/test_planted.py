"""The lists of planted mistakes: each can be planted, has a job, and what comes of it is counted."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from benchmarks.planted import JOBS, LISTS, ROOT, tell_outcome, write_counts, write_job


@pytest.mark.parametrize("file", LISTS, ids=lambda file: file.stem)
def test_every_mistake_can_be_planted_and_has_a_job(file: Path, tmp_path: Path) -> None:
    listed = tomllib.loads(file.read_text(encoding="utf-8"))
    own = {job["name"]: job for job in listed.get("job", [])}
    assert len({(entry["name"], entry["area"]) for entry in listed["mistake"]}) == len(listed["mistake"])
    for entry in listed["mistake"]:
        text = (ROOT / "compplan" / entry["file"]).read_text(encoding="utf-8")
        assert entry["old"] in text, f"{entry['name']}: the text is no longer in {entry['file']}"
        assert entry["old"] != entry["new"]
        assert entry["job"] in own or entry["job"] in JOBS
    for name in own:
        assert write_job(tmp_path / name, name, own).is_file()


def test_faults_and_refusals_are_not_seen_mistakes() -> None:
    statuses = ["not_confirmed", "infeasible", "exit 3", "exit 2", "exit 1", "too long", "solved"]
    assert [tell_outcome(status) for status in statuses] == [
        "seen", "seen", "seen", "refused", "internal fault", "internal fault", "called solved",
    ]  # fmt: skip
    rows = [{"area": "reader", "status": status} for status in statuses] + [{"area": "writer", "status": "solved"}]
    assert write_counts(rows).splitlines()[2:] == [
        "| reader | 7 | 3 | 1 | 2 | 1 | 0 |", "| writer | 1 | 0 | 0 | 0 | 1 | 0 |",
        "| all | 8 | 3 | 1 | 2 | 2 | 0 |",
    ]  # fmt: skip
