from __future__ import annotations

import json
from pathlib import Path

from commandline import run_command


def test_one_command_goes_from_the_cam_file_to_the_program(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z20\nG41\nG1 Z0 F600\nX20\nY20\n")
    (tmp_path / "force.toml").write_text('[process]\nmodel = "constant"\nforce_N = [0.0, 0.0, 100.0]\n')
    words = ["post", tmp_path / "cut.nc", "--robot", "staubli_tx200", "--part", "1500,0,183", "--process",
             tmp_path / "force.toml", "--program", "csv", "--program", "val3",
             "--compensation", "centre_line", "--out", tmp_path / "out", "--json"]  # fmt: skip
    done = run_command(words, monkeypatch, capsys)
    summary = json.loads(done.out)
    assert done.status in (0, 3) and (done.status == 0) == (summary["status"] == "solved")
    assert summary["error_after_mm"]["max"] < 0.2 * summary["error_before_mm"]["max"]
    assert any("cut.nc, line 2: G41 compensates wear alone" in note for note in summary["notes"])
    written = {path.name for path in (tmp_path / "out").rglob("*")}
    assert {"plan.json", "joints.csv", "report.html"} <= written and any("cut" in name for name in written)


def test_a_part_that_is_no_frame_is_refused_in_one_line(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z0\nG1 X1 F60\n")
    words = ["post", tmp_path / "cut.nc", "--robot", "staubli_tx200", "--program", "val3", "--part", "1,2"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and "--part is '1,2', expected X,Y,Z in mm" in done.err
    assert [file.name for file in tmp_path.iterdir()] == ["cut.nc"]


def test_signals_of_the_cell_come_with_the_command(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "cut.nc").write_text("G21 G0 X0 Y0 Z20\nM3 S9000\nG1 Z0 F600\nX20\nM5\n")
    (tmp_path / "cell.toml").write_text("io = { spindle = 2 }\n")
    (tmp_path / "quick.toml").write_text('strategy = "none"\n')
    words = ["post", tmp_path / "cut.nc", "--robot", "ur10", "--program", "urscript", "--part", "-700,0,300"]
    files = ["--output", tmp_path / "cell.toml", "--plan", tmp_path / "quick.toml", "--out", tmp_path / "out"]
    assert run_command([*words, *files], monkeypatch, capsys).status in (0, 3)
    text = (tmp_path / "out" / "cut_L.script").read_text()
    order = [text.index(word) for word in ("movej", "set_standard_digital_out(2, True)", "sleep(5.000)", "movel",
                                           "set_standard_digital_out(2, False)")]  # fmt: skip
    assert order == sorted(order)
