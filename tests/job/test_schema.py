"""The JSON schema of a job."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from commandline import run_command

ROOT = Path(__file__).parents[2]


def test_the_schema_takes_every_shipped_job_and_the_commented_one_and_refuses_what_the_reader_refuses(
    tmp_path, monkeypatch, capsys
) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    answer = run_command(["init", "--schema"], monkeypatch, capsys)
    assert answer.status == 0
    schema = json.loads(answer.out)
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    run_command(["init", tmp_path / "new.toml"], monkeypatch, capsys)
    jobs = [*sorted((ROOT / "paths").glob("*.toml")), tmp_path / "new.toml"]
    assert len(jobs) > 5
    for file in jobs:
        faults = list(check.iter_errors(tomllib.loads(file.read_text())))
        assert not faults, (file.name, faults[0].message)
    job = tomllib.loads(jobs[0].read_text())
    for wrong in ({"plan": {"strategy": "hope"}}, {"plan": {"tolerance_mm": -1}}, {"feeed": {}}, {"schema": 2}):
        assert not check.is_valid({**job, **wrong})
    refused = run_command(["init", "job.toml", "--schema"], monkeypatch, capsys)
    assert refused.status == 2 and "has no meaning" in refused.err
