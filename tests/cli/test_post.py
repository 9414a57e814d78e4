from __future__ import annotations

import json
from pathlib import Path

import pytest

from compplan.cli import main


def run(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["compplan", "post", *arguments])
    with pytest.raises(SystemExit) as done:
        main()
    return int(done.value.code or 0)


def test_one_command_goes_from_the_cam_file_to_the_program(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z20\nG41\nG1 Z0 F600\nX20\nY20\n")
    (tmp_path / "force.toml").write_text('[process]\nmodel = "constant"\nforce_N = [0.0, 0.0, 100.0]\n')
    status = run(
        monkeypatch, str(tmp_path / "cut.nc"), "--robot", "staubli_tx200", "--part", "1500,0,183", "--process",
        str(tmp_path / "force.toml"), "--program", "csv", "--program", "val3",
        "--compensation", "centre_line", "--out", str(tmp_path / "out"), "--json",
    )  # fmt: skip
    summary = json.loads(capsys.readouterr().out)
    assert status in (0, 3) and (status == 0) == (summary["status"] == "solved")
    assert summary["error_after_mm"]["max"] < 0.2 * summary["error_before_mm"]["max"]
    assert any("cut.nc, line 2: G41 compensates wear alone" in note for note in summary["notes"])
    written = {path.name for path in (tmp_path / "out").rglob("*")}
    assert {"plan.json", "joints.csv", "report.html"} <= written and any("cut" in name for name in written)


def test_a_part_that_is_no_frame_is_refused_in_one_line(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z0\nG1 X1 F60\n")
    words = (str(tmp_path / "cut.nc"), "--robot", "staubli_tx200", "--program", "val3")
    assert run(monkeypatch, *words, "--part", "1,2") == 2
    assert "--part is '1,2', expected X,Y,Z in mm" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["cut.nc"]


def test_signals_of_the_cell_come_with_the_command(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z20\nM3 S9000\nG1 Z0 F600\nX20\nM5\n")
    (tmp_path / "cell.toml").write_text("io = { spindle = 2 }\n")
    (tmp_path / "quick.toml").write_text('strategy = "none"\n')
    words = (str(tmp_path / "cut.nc"), "--robot", "ur10", "--program", "urscript", "--part", "-700,0,300")
    files = ("--output", str(tmp_path / "cell.toml"), "--plan", str(tmp_path / "quick.toml"))
    assert run(monkeypatch, *words, *files, "--out", str(tmp_path / "out")) in (0, 3)
    text = (tmp_path / "out" / "cut_L.script").read_text()
    order = [text.index(word) for word in ("movej", "set_standard_digital_out(2, True)", "sleep(5.000)", "movel",
                                           "set_standard_digital_out(2, False)")]  # fmt: skip
    assert order == sorted(order)
