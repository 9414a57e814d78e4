from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.io.columns import UNITS, FileColumn, to_unit
from compplan.io.tables import read_table, write_table, write_text
from compplan.io.transaction import replace_file

COLUMNS = (
    FileColumn("run", "text"),
    *(FileColumn(name, "length", required=True) for name in "xy"),
    FileColumn("q#", ("angle", "length")),
    FileColumn("q#_link", ("angle", "length")),
    *(FileColumn(name, "force", group="force", missing=True) for name in ("fx", "fy")),
    FileColumn("sigma", "length", key="sigma_position"),
    FileColumn("sigma", "angle", key="sigma_angle"),
)


def read(tmp_path: Path, text: str, **options: str):
    file = tmp_path / "table.csv"
    file.write_text(text, encoding="utf-8")
    return read_table(file, COLUMNS, **options)


def test_units_in_column_names_lead_to_si(tmp_path: Path) -> None:
    table = read(tmp_path, "run,x_mm,y_m,q1_deg,q2_mm,q1_link_rad,sigma_mm,sigma_deg\nstatic,1500,2,180,250,1,0.1,90\n")
    assert table.values["x"] == pytest.approx([1.5])
    assert table.values["y"] == pytest.approx([2.0])
    assert table.stack(table.numbered("q#")) == pytest.approx(np.array([[np.pi, 0.25]]))
    assert table.numbered("q#_link") == ["q1_link"]
    assert table.values["sigma_position"] == pytest.approx([1e-4])
    assert table.values["sigma_angle"] == pytest.approx([np.pi / 2])
    assert table.text["run"].tolist() == ["static"]
    assert (table.units["q2"], table.headers["q2"]) == ("mm", "q2_mm")


#: A quantity in each unit, and the same in SI.
SAME = {
    "m": (2.0, 2.0), "mm": (1500.0, 1.5), "um": (250.0, 0.00025), "rad": (1.0, 1.0), "mrad": (5.0, 0.005),
    "deg": (90.0, np.pi / 2), "N": (7.0, 7.0), "kN": (1.5, 1500.0), "Nm": (3.0, 3.0), "Nmm": (2500.0, 2.5),
    "kNm": (0.2, 200.0), "s": (4.0, 4.0), "ms": (40.0, 0.04), "m_s": (0.5, 0.5), "mm_s": (50.0, 0.05),
    "m_min": (12.0, 0.2), "mm_min": (600.0, 0.01), "C": (21.5, 21.5),
}  # fmt: skip


def test_a_quantity_in_each_unit_is_read_and_written_as_what_it_is_in_si(tmp_path: Path) -> None:
    assert set(SAME) == set(UNITS)
    for unit, (value, si) in SAME.items():
        file = tmp_path / "units.csv"
        file.write_text(f"a_{unit}\n{value}\n", encoding="utf-8")
        read_back = read_table(file, [FileColumn("a", UNITS[unit][0])]).values["a"]
        assert read_back == pytest.approx([si], rel=1e-14), unit
        assert to_unit(np.array([si]), f"a_{unit}") == pytest.approx([value], rel=1e-14), unit


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", r"table.csv:1: the file is empty"),
        ("x_mm\n1\n", r"table.csv:1: missing column y_mm or y_m; the columns are \['x_mm'\]"),
        ("x_mm,y_mm\n1,2\n3\n", r"table.csv:3: row has 1 fields, the header has 2"),
        ("x_mm,y_mm\n1,two\n", r"table.csv:2: column 'y_mm' holds 'two', expected a number"),
        ("x_mm,y_mm\n1,2\n,2\n", r"table.csv:3: column 'x_mm' is empty \(or NaN\) here"),
        ("x_mm,y_mm\n1,inf\n", r"table.csv:2: column 'y_mm' is infinite"),
        ("x_mm,y_mm,x_mm\n1,2,3\n", r"table.csv:1: column 'x_mm' occurs twice"),
        ("x_mm,y_mm,x_m\n1,2,3\n", r"columns 'x_mm' and 'x_m' hold the same quantity"),
        ("x,y_mm\n1,2\n", r"column 'x' has no unit; name it x_mm or x_m"),
        ("x_deg,y_mm\n1,2\n", r"column 'x_deg' has the unit deg; name it x_mm"),
        ("x_mm,y_mm,w\n1,2,3\n", r"no column named 'w', choose from"),
        ("x_mm,y_mm,fx_N\n1,2,3\n", r"missing column fy_N or fy_kN; fx_N, fy_N: give all or none"),
        ("x_mm;y_mm\n1;2\n", r"separated by ';'"),
    ],
)
def test_each_mistake_in_a_table_has_its_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, text)


@pytest.mark.parametrize("number", ["1_000", "\u0661", "\uff11", "0x10"])
def test_numbers_that_only_some_programs_read_are_refused(tmp_path: Path, number: str) -> None:
    with pytest.raises(InputError, match=r"table.csv:3: column .x_mm. holds .*, expected a number"):
        read(tmp_path, f"x_mm,y_mm\n1,2\n{number},2\n")


def test_numbered_columns_must_not_leave_one_out(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing column q2: the columns q# count from 1"):
        read(tmp_path, "x_mm,y_mm,q1_deg,q3_deg\n1,2,3,4\n").numbered("q#")


def test_missing_and_binary_files_have_their_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.csv: no such file"):
        read_table(tmp_path / "nowhere.csv", COLUMNS)
    (tmp_path / "binary.csv").write_bytes(b"x\0y")
    with pytest.raises(InputError, match="binary file"):
        read_table(tmp_path / "binary.csv", COLUMNS)


def test_a_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 200))
    write_table(tmp_path / "t.csv", {"x_mm": to_unit(x, "x_mm"), "y_m": y, "run": ['a,"b"'] * 200})
    table = read_table(tmp_path / "t.csv", COLUMNS)
    assert np.abs(table.values["x"] - x).max() < 1e-12
    assert np.abs(table.values["y"] - y).max() < 1e-9
    assert table.text["run"][0] == 'a,"b"'


def test_nothing_is_left_when_writing_fails(tmp_path: Path) -> None:
    write_text(tmp_path / "kept.txt", "old")
    with pytest.raises(RuntimeError), replace_file(tmp_path / "kept.txt") as part:
        part.write_text("half")
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["kept.txt"]
    assert (tmp_path / "kept.txt").read_text() == "old"
