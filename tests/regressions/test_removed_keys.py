"""A job that holds a key of a removed capability is refused with one line that says what to do."""

from __future__ import annotations

from pathlib import Path

import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.job import check_job

JOB = Path(__file__).parents[2] / "examples" / "forces" / "pocket.toml"


@pytest.mark.parametrize(
    ("table", "name"),
    [
        ("[stability]\ndamping = 0.03", "[stability]"),
        ("[surface]", "[surface]"),
        ("[coupling]\nfrom_model = true", "[coupling]"),
        ('[[tool]]\nnumber = 1\nprocess = { part = { mesh = "part.stl" } }', "tool.process.part"),
        ("[tool_beam]\nstickout_mm = 50.0", "[tool_beam]"),
    ],
)
def test_a_removed_key_is_refused_in_one_line(table: str, name: str, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "job.toml").write_text(f"{JOB.read_text(encoding='utf-8')}\n{table}\n", encoding="utf-8")
    answer = run_command(["forces", tmp_path / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert f"{name} is no longer supported; " in answer.err and len(answer.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_key_that_went_from_one_force_model_is_refused_there_and_stays_elsewhere() -> None:
    job = {"schema": 1, "robot": "ur10", "toolpath": "path.csv"}
    sheet = {"model": "isf_regression", "thickness_mm": 1.0, "tool_diameter_mm": 10.0, "tensile_N_mm2": 300.0}
    with pytest.raises(InputError, match=r"process\.ramp_mm is no longer supported"):
        check_job({**job, "process": {**sheet, "ramp_mm": 2.0}})
    assert check_job({**job, "process": {"model": "isf", "axial_N": 10.0, "ramp_mm": 2.0}}).process.ramp_mm == 2.0
