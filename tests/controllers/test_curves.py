"""Arcs of the CAM file, and starts from rest in programs of few moves; and what the second reader says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.fitted import PlannedRows, find_rows, follow_moves
from compplan.controllers.readback.poses import Move
from compplan.controllers.writers import Program, write_program
from compplan.controllers.writers.fit import fit_moves
from compplan.toolpath.readers import CamTable, read_cam
from compplan.toolpath.toolpath import resample_toolpath
from tests.controllers.test_fit import make_program

GCODE = "G21 G90 G17 G94\nG0 X0 Y0 Z5\nG1 Z0 F600\nG1 X40\nG3 X60 Y20 I0 J20\nG1 Y40\nG2 X60 Y40 I15 J0\nM30\n"
APT = (
    "UNITS / MM\nFROM / 0, 0, 5\nRAPID\nGOTO / 0, 0, 5\nFEDRAT / 600, MMPM\nGOTO / 0, 0, 0\nGOTO / 40, 0, 0\n"
    "CIRCLE / 40, 20, 0, 0, 0, -1, 20, 0.01, 0.5, 10, 0\nGOTO / 60, 20, 0\nGOTO / 60, 40, 0\nFINI\n"
)


def read_program(text: str, suffix: str, folder: Path, bend: float = 0.0) -> Program:
    """Return the program of a CAM file, each waypoint moved outwards from (40, 20) by .05 mm and a little more in x."""
    file = folder / f"part{suffix}"
    file.write_text(text)
    path = resample_toolpath(read_cam(file, CamTable()).toolpath, 0.5e-3)
    place = 1e3 * path.position
    arm = place[:, :2] - [40.0, 20.0]
    place[:, :2] += 0.05 * arm / np.maximum(np.linalg.norm(arm, axis=1, keepdims=True), 1.0)
    place[:, 0] += bend * np.sin(place[:, 1])
    time = np.r_[0.0, np.cumsum(np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-6) / 10.0)]
    return replace(make_program(place, time), arc_of=path.arc, rapid=path.rapid)


@pytest.mark.parametrize(("text", "suffix", "wanted"), [(GCODE, ".nc", [1, 2]), (APT, ".apt", [1])])
def test_arcs_of_the_file_stay_arcs_where_the_correction_leaves_them_round(
    text: str, suffix: str, wanted: list[int], tmp_path: Path
) -> None:
    program = read_program(text, suffix, tmp_path)
    fitted = fit_moves(program)
    drawn = program.arc_of
    assert drawn is not None and sorted(set(drawn.tolist())) == [0, *wanted]
    first = np.flatnonzero(drawn == 1)
    k = fitted.rows.tolist().index(int(first[-1]))
    assert fitted.rows[k - 1] == first[0] - 1 and fitted.program.arcs[k]  # one move, from its start to its end
    assert fitted.program.via is not None
    via = 1e3 * fitted.program.via[k, :2, 3] - [40.0, 20.0]
    assert np.linalg.norm(via) == pytest.approx(20.05, abs=1e-3)


def test_a_full_circle_of_the_file_is_three_arcs(tmp_path: Path) -> None:
    program = read_program(GCODE, ".nc", tmp_path)
    fitted, drawn = fit_moves(replace(program, tolerance=2e-5)), program.arc_of
    assert drawn is not None
    ends = [k for k, row in enumerate(fitted.rows) if drawn[row] == 2]
    assert len(ends) == 3 and fitted.program.arcs[ends].all()


def test_an_arc_that_the_correction_bends_is_divided(tmp_path: Path) -> None:
    program = read_program(GCODE, ".nc", tmp_path, bend=0.02)
    fitted, drawn = fit_moves(program), program.arc_of
    assert drawn is not None and sum(drawn[row] == 1 for row in fitted.rows) > 2
    unmarked = fit_moves(replace(program, arc_of=None))
    assert len(fitted.rows) <= len(unmarked.rows) + 4


def rows_of(program: Program) -> PlannedRows:
    assert program.tcp is not None and program.time is not None
    n = len(program)
    kept = np.zeros(n, bool)
    kept[[0, -1]] = True
    tip = program.tcp
    return PlannedRows(
        1e3 * tip[:, :3, 3], tip[:, :3, :3], program.time, kept, np.zeros(n, bool), np.full(n, 2e-3), 4e-3
    )


def test_the_reader_knows_starts_from_rest_by_itself() -> None:
    way = np.r_[0.0, np.cumsum(np.r_[0.05, 0.1, 0.3, np.full(20, 1.0)])]
    time = np.r_[0.0, np.cumsum(np.diff(way) / np.r_[1.0, 5.0, 12.0, np.full(20, 20.0)])]
    program = make_program(np.column_stack([way, 0 * way, 0 * way]), time)
    rows, ends = rows_of(program), np.array([0, 23])
    start, end = np.eye(4), np.eye(4)
    end[:3, 3] = [way[-1], 0.0, 0.0]
    for feed, fine in ((20.0, True), (19.0, False)):
        moves = [Move("joint", True, pose=start), Move("line", True, pose=end, feed=feed)]
        assert (follow_moves(rows, ends, moves, [np.eye(4)] * 2) == []) == fine
    assert follow_moves(rows, ends, [moves[0]._replace(stops=False), moves[1]._replace(feed=20.0)], [np.eye(4)] * 2)


def test_moves_name_the_line_of_the_cam_file_at_which_they_end(tmp_path: Path) -> None:
    path = read_cam(_write(tmp_path / "part.nc", GCODE), CamTable()).toolpath
    assert path.line is not None and path.line[path.arc == 1].tolist() == [5] * int((path.arc == 1).sum())
    assert resample_toolpath(path, 1e-3).line[-1] == 7  # type: ignore[index]
    apt = read_cam(_write(tmp_path / "part.apt", APT), CamTable()).toolpath
    assert apt.line is not None and apt.line[-1] == 10 and set(apt.line[apt.arc == 1].tolist()) == {9}
    program = replace(make_program(1e3 * path.position, np.arange(len(path)) * 0.1), line_of=path.line)
    write_program(program, "rapid", tmp_path / "out", any_brand=True)
    text = (tmp_path / "out" / "path_L_1.mod").read_text()
    lines = [line.strip() for line in text.splitlines()]
    assert lines.count("! CAM line 4") == 1 and lines.count("! CAM line 7") == 1  # on lines of their own
    assert lines[lines.index("! CAM line 5") + 1].startswith("MoveC [[")


def _write(file: Path, text: str) -> Path:
    file.write_text(text)
    return file


def test_moves_that_turn_the_tool_in_place_are_found_by_their_turn() -> None:
    # eleven rows within written digits of one place, the tool turning by a degree: three moves end among them
    n = 15
    position = np.zeros((n, 3))
    position[:2, 0], position[2:13, 0], position[13:, 0] = [-2.0, -1.0], 1e-4 * np.arange(11), [1.0, 2.0]
    angle = np.radians(np.r_[0.0, 0.0, 0.1 * np.arange(11), 1.0, 1.0])
    turn = Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    kept = np.zeros(n, bool)
    kept[[0, -1]] = True
    rows = PlannedRows(position, turn, np.arange(n) * 0.02, kept, np.zeros(n, bool), np.full(n, 2e-3), 0.012)
    ends = np.array([0, 3, 5, 10, 13, 14])
    tips = np.round(position[ends], 3)
    assert find_rows(rows, tips, turn[ends]).tolist() == ends.tolist()
    assert list(find_rows(rows, tips, np.full((6, 3, 3), np.nan))) != ends.tolist()


def test_rows_nearer_than_a_written_digit_are_found_in_order() -> None:
    # two rows .6 um apart, written with three digits: the first one's place lies nearer to the second
    position = np.array([[0.0, 0.0, 0.0], [-0.08, 0.0, 0.0], [-0.17250, 0.00526, 0.00012], [-0.17311, 0.00531, 0.00011],
                         [-0.316, 0.026, 0.002]])  # fmt: skip
    n = len(position)
    kept = np.zeros(n, bool)
    kept[[0, -1]] = True
    turn = np.tile(np.eye(3), (n, 1, 1))
    rows = PlannedRows(position, turn, np.arange(n) * 0.02, kept, np.zeros(n, bool), np.full(n, 2e-3), 0.012)
    tips = position.copy()
    tips[2], tips[3] = [-0.1730, 0.00480, 0.0005], [-0.1730, 0.0058, 0.0005]
    assert list(find_rows(rows, tips, turn)) == [0, 1, 2, 3, 4]
    assert "waypoint 3 " in str(find_rows(rows, tips[[0, 1, 2, 3, 3, 4]], turn[[0, 1, 2, 3, 3, 4]]))
