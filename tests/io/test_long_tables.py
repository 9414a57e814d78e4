"""Long tables of nothing but numbers are read at once, and hold the same quantity as others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.io import tables
from compplan.io.columns import FileColumn
from compplan.io.provenance import describe_origin, record_inputs
from compplan.io.tables import read_table, write_table

COLUMNS = (FileColumn("time", "time", required=True), FileColumn("q#", "angle", required=True, missing=True))


def write_long(file: Path) -> Path:
    rng = np.random.default_rng(0)
    write_table(file, {"time_s": np.arange(9000) * 1e-3, "q1_deg": rng.normal(0, 90, 9000), "q2_deg": rng.random(9000)})
    return file


def test_a_long_table_reads_as_the_same_table_read_row_by_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_long(tmp_path / "log.csv")
    with record_inputs():
        fast = read_table(file, COLUMNS)
        assert str(file) in describe_origin()["inputs_sha256"]
    monkeypatch.setattr(tables, "_read_numbers", lambda lines: None)
    slow = read_table(file, COLUMNS)
    assert fast.headers == slow.headers and fast.units == slow.units and (fast.lines == slow.lines).all()
    assert all(np.array_equal(fast.values[key], slow.values[key]) for key in slow.values)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [("\n5.0,", "\n5.0,1,", "5002: row has 4 fields"), ("\n5.0,", "\nx,", "5002: column 'time_s' holds 'x'"),
     ("\n5.0,", "\n1e999,", "5002: column 'time_s' is infinite"), ("\n5.0,", "\n,", "5002: column 'time_s' is empty")],
)  # fmt: skip
def test_what_is_wrong_in_a_long_table_is_told_with_its_line(old: str, new: str, said: str, tmp_path: Path) -> None:
    file = write_long(tmp_path / "log.csv")
    text = file.read_text().replace("\n5,", old).replace(old, new)
    file.write_text(text)
    with pytest.raises(InputError) as told:
        read_table(file, COLUMNS)
    assert said in str(told.value)


def test_a_long_table_with_a_remark_or_a_gap_is_read_too(tmp_path: Path) -> None:
    file = write_long(tmp_path / "log.csv")
    lines = file.read_text().splitlines()
    lines[7], lines[20] = "# a remark", lines[20].rsplit(",", 1)[0] + ","
    file.write_text("\n".join(lines) + "\n")
    table = read_table(file, COLUMNS)
    assert len(table.values["time"]) == 8999 and np.isnan(table.values["q2"][18]) and table.lines[6] == 9


def test_numbers_that_are_labels_stay_text(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("run,time_s\n1,0.5\n2,1.5\n")
    table = read_table(tmp_path / "log.csv", (FileColumn("run", "text"), FileColumn("time", "time")))
    assert table.text["run"].tolist() == ["1", "2"]
