"""Lines and arcs that stand for many rows of a program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.controllers.readback.fitted import PlannedRows, follow_moves
from compplan.controllers.readback.languages import read_krl, read_rapid
from compplan.controllers.readback.poses import Move
from compplan.controllers.shapes import find_arc
from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.fit import fit_moves
from compplan.robot import load_robot
from compplan.toolpath.readers import CamTable, read_cam
from compplan.toolpath.toolpath import resample_toolpath


def make_program(position: np.ndarray, time: np.ndarray, turn: float = 0.0) -> Program:
    """Return a program whose tip goes through places [mm], its tool turned about z by `turn` from end to end. [rad]"""
    n = len(position)
    q = np.tile(np.radians([10.0, 20, 30, 40, 50, 60]), (n, 1))
    program = build_program(load_robot("ur10"), q, np.full(n, 0.02), np.arange(n) == 0, name="path", time=time)
    tcp, angle = np.tile(np.eye(4), (n, 1, 1)), turn * np.linspace(0.0, 1.0, n)
    tcp[:, :3, 3] = 1e-3 * position
    tcp[:, 0, 0] = tcp[:, 1, 1] = np.cos(angle)
    tcp[:, 1, 0], tcp[:, 0, 1] = np.sin(angle), -np.sin(angle)
    return replace(program, tcp=tcp, tolerance=2e-6, cycle=0.004)


def circle(angles: np.ndarray, radius: float = 20.0) -> np.ndarray:
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), 5.0)])


def test_three_quarters_of_a_circle_at_one_speed_are_two_arcs() -> None:
    angles = np.linspace(0.0, 1.5 * np.pi, 501)
    program = make_program(circle(angles), np.linspace(0.0, 10.0, 501), turn=0.5)
    fitted = fit_moves(program)
    assert len(fitted.program) <= 4 and fitted.program.arcs[1:].all()
    assert fitted.program.feed[1:] == pytest.approx(1.5 * np.pi * 20.0 / 10.0, rel=1e-4)
    assert fitted.rows[-1] == 500


def test_every_row_lies_within_the_tolerance_and_every_move_has_its_time() -> None:
    rng = np.random.default_rng(5)
    s = np.sort(np.r_[0.0, rng.uniform(0.0, 6.0, 800), 6.0])
    position = np.column_stack([30 * np.cos(s) + 3 * np.sin(5 * s), 30 * np.sin(s), 4 * np.cos(3 * s)])
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    time = np.r_[0.0, np.cumsum(step / (20.0 + 5.0 * np.sin(s[1:])))]
    program = make_program(position, time)
    fitted = fit_moves(program)
    few = fitted.program
    assert few.time is not None and few.via is not None and program.tcp is not None
    assert len(few) < 0.5 * len(program) and few.arcs.sum() > 20
    assert np.diff(few.time).min() >= 0.004
    for k in range(1, len(few)):
        a, b = fitted.rows[k - 1], fitted.rows[k]
        if not few.arcs[k]:
            chord = (position[b] - position[a]) / np.linalg.norm(position[b] - position[a])
            off = np.linalg.norm(np.cross(position[a : b + 1] - position[a], chord), axis=1)
        else:
            found = find_arc(position[a], 1e3 * few.via[k, :3, 3], position[b])
            assert found is not None
            arm, normal = position[a : b + 1] - found.centre, np.array(found.normal)
            radius, height = np.linalg.norm(arm[0]), arm @ normal
            off = np.hypot(np.linalg.norm(arm - height[:, None] * normal, axis=1) - radius, height)
        assert off.max() <= 2e-3 + 1e-9


def test_rows_nearer_than_a_cycle_are_joined_where_the_path_is_straight_and_slowed_where_it_is_not() -> None:
    line = np.column_stack([np.linspace(0.0, 10.0, 101), np.zeros(101), np.zeros(101)])
    uneven = np.cumsum(np.tile([0.001, 0.002], 51)[:101]) - 0.001  # every speed differs from the one before
    fitted = fit_moves(make_program(line, uneven))
    assert fitted.program.time is not None and np.diff(fitted.program.time).min() >= 0.004
    zigzag = line + np.column_stack([np.zeros(101), np.tile([0.0, 1.0], 51)[:101], np.zeros(101)])
    fitted = fit_moves(make_program(zigzag, 0.001 * np.arange(101.0)))
    assert len(fitted.program) == 101
    assert fitted.program.feed[1:] == pytest.approx(np.hypot(0.1, 1.0) / 0.004)


def test_rows_that_bring_in_a_correction_at_rest_are_one_move_with_a_speed_that_no_language_writes_as_zero() -> None:
    """Nine rows go 1e-8 mm and turn by 3e-7 rad, then a line begins: 0.000000 m/s would stand in a program."""
    line = np.column_stack([np.linspace(0.0, 10.0, 41), np.zeros(41), np.zeros(41)])
    still = np.linspace(0.0, 1e-8, 9)[:, None] * [0.0, 0.0, 1.0]
    eased = np.cumsum([0.0, 0.06, 0.02, 0.016, 0.015, 0.015, 0.016, 0.02, 0.06])  # no speed is that of the row before
    time = np.r_[eased, eased[-1] + 0.05 * np.arange(1.0, 41.0)]
    program = make_program(np.vstack([still, line[1:]]), time, turn=1.8e-6)
    stays = np.arange(49) <= 8
    fitted = fit_moves(replace(program, free=stays & (np.arange(49) > 0), exact=np.arange(49) == 8))
    assert fitted.rows.tolist() == [0, 8, 48]
    assert fitted.program.feed[1] == pytest.approx(1.0 / 6.0)  # 1 cm/min
    assert float(f"{1e-3 * fitted.program.feed[1]:.6f}") > 0.0  # as KRL writes it


def plan_rows(x: np.ndarray, rotation: np.ndarray, time: np.ndarray, *, free: bool) -> PlannedRows:
    """Rows of a cut without corners, from its tips [mm], orientations and times."""
    n = len(x)
    no, zero = np.zeros(n, bool), np.zeros(n)
    return PlannedRows(x, rotation, np.zeros((n, 6)), time, zero, no, no | free, None, np.zeros((n, 3)), 2e-3)


def test_a_way_back_below_the_rounding_of_written_positions_is_none_and_one_above_it_is_read() -> None:
    for size, said in ((1e-4, ""), (1e-2, "the path turns back")):
        x = size * np.array([[0.0, 0, 0], [2.0, 0, 0], [1.0, 0, 0]])
        turns = np.tile(np.eye(3), (3, 1, 1))
        rows = plan_rows(x, turns, np.arange(3.0), free=True)
        pose = np.eye(4)
        pose[:3, 3] = x[-1]
        moves = [Move("line", True, pose=np.eye(4)), Move("line", True, pose=pose)]
        found = follow_moves(rows, 0.004, np.array([0, 2]), moves, [np.eye(4)] * 2)
        assert found == ([f"{said} between rows 0 and 2"] if said else [])


def test_speed_stop_and_event_part_moves() -> None:
    line = np.column_stack([np.linspace(0.0, 10.0, 101), np.zeros(101), np.zeros(101)])
    time = np.r_[np.linspace(0.0, 1.0, 51), 1.0 + np.linspace(0.0, 2.0, 51)[1:]]  # half as fast from row 50
    program = make_program(line, time)
    fitted = fit_moves(replace(program, exact=np.arange(101) == 20))
    assert fitted.rows.tolist() == [0, 20, 50, 100]
    assert fitted.program.feed[1:] == pytest.approx([5.0, 5.0, 2.5])
    assert fitted.program.stops(linear=True).tolist() == [True, True, False, True]
    free = fit_moves(replace(program, free=np.ones(101, bool)))
    assert free.rows.tolist() == [0, 100]


@pytest.mark.parametrize(
    ("language", "name", "read"), [("krl", "path_L.src", read_krl), ("rapid", "path_L.mod", read_rapid)]
)
def test_arcs_are_read_back_with_the_place_they_go_through(
    language: str, name: str, read: object, tmp_path: Path
) -> None:
    program = make_program(circle(np.linspace(0.0, 2.5, 301)), np.linspace(0.0, 6.0, 301))
    program = replace(program, status=np.zeros(301, int), joint_names=("A1", "A2", "A3", "A4", "A5", "A6"))
    write_program(program, language, tmp_path / "out", any_brand=True)
    first, arc = read(tmp_path / "out" / name)  # type: ignore[operator]
    assert (first.kind, arc.kind) == ("joint", "arc")
    assert arc.via[:3, 3] == pytest.approx(circle(np.array([1.25]))[0], abs=1e-4)
    assert arc.pose[:3, 3] == pytest.approx(circle(np.array([2.5]))[0], abs=1e-4)
    assert arc.feed == pytest.approx(2.5 * 20.0 / 6.0, rel=1e-4)


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
    return plan_rows(1e3 * program.tcp[:, :3, 3], program.tcp[:, :3, :3], program.time, free=False)


def test_the_reader_knows_starts_from_rest_by_itself() -> None:
    way = np.r_[0.0, np.cumsum(np.r_[0.05, 0.1, 0.3, np.full(20, 1.0)])]
    time = np.r_[0.0, np.cumsum(np.diff(way) / np.r_[1.0, 5.0, 12.0, np.full(20, 20.0)])]
    program = make_program(np.column_stack([way, 0 * way, 0 * way]), time)
    rows, ends = rows_of(program), np.array([0, 23])
    start, end = np.eye(4), np.eye(4)
    end[:3, 3] = [way[-1], 0.0, 0.0]
    for feed, fine in ((20.0, True), (19.0, False)):
        moves = [Move("joint", True, pose=start), Move("line", True, pose=end, feed=feed)]
        assert (follow_moves(rows, 0.004, ends, moves, [np.eye(4)] * 2) == []) == fine
    assert follow_moves(
        rows, 0.004, ends, [moves[0]._replace(stops=False), moves[1]._replace(feed=20.0)], [np.eye(4)] * 2
    )


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
