"""The second reader of G-code, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from truth_cases import follow_arc

from tests.oracles.cam.cam import read_gcode
from tests.oracles.cam.follow import Followed, find_difference
from tests.oracles.cam.moves import ARC, LINE, RAPID, CannotTellError
from tests.oracles.cam.tables import read_generator


def _ends(text: str, **options: object) -> list[list[float]]:
    return [[round(value, 6) for value in row] for row in (read_gcode(text, options).end * 1e3).tolist()]


def test_a_move_home_is_no_point_of_the_part() -> None:
    text = "G90\nG28 G91 Z0.\nG90\nG0 X75 Y50\nG43 Z15 H1\nG1 Z-1 F300\nX80\nG28 G91 Z0.\nG28 X0 Y0\nM30\n"
    up = [80, 50, 15]  # home lies above: the way there leads up past the height of rapid moves
    assert _ends(text) == [[75, 50, 15], [75, 50, -1], [80, 50, -1], up]


def test_words_of_an_m_code_never_become_motion() -> None:
    text = "G0 X0 Y0 Z5\nM205 X8 Y8\nM201 X500 Y500\nM92 X80\nG1 X1 F60\n"
    assert _ends(text) == [[0, 0, 5], [1, 0, 5]]


def test_the_order_of_words_in_a_block_does_not_count() -> None:
    head, words = "G90 G0 X1 Y1 Z1\n", ["G91", "G1", "X2.", "F60", "G20"]
    found = {tuple(map(tuple, _ends(head + " ".join(np.random.default_rng(k).permutation(words))))) for k in range(20)}
    assert found == {((1.0, 1.0, 1.0), (51.8, 1.0, 1.0))}


def test_arcs_keep_centre_sense_and_pitch() -> None:
    read = read_gcode("G0 X10 Y0 Z0\nG3 X0 Y10 Z2 I-10 J0 F60\nG2 X10 Y0 R10\nG2 I-5 J0\n", {})
    assert read.kind.tolist() == [RAPID, ARC, ARC, ARC]
    assert np.degrees(read.sweep[1:]) == pytest.approx([90.0, -90.0, -360.0])
    assert read.centre[1:] * 1e3 == pytest.approx(np.array([[0, 0, 0], [0, 0, 2.0], [5, 0, 2]]))
    middle = follow_arc(read.end[0], read.end[1], read.centre[1], read.normal[1], read.sweep[1], np.array([0.5]))[0]
    assert middle * 1e3 == pytest.approx([10 * math.sqrt(0.5), 10 * math.sqrt(0.5), 1.0])


def test_a_negative_radius_takes_the_longer_way() -> None:
    read = read_gcode("G0 X0 Y0 Z0\nG2 X10 Y0 R5.000 F60\nG0 X0\nG3 X10 Y10 R-10 F60\n", {})
    assert np.degrees(read.sweep[[1, 3]]) == pytest.approx([-180.0, 270.0])
    assert read.centre[3] * 1e3 == pytest.approx([10.0, 0.0, 0.0], abs=1e-9)


def test_in_g18_clockwise_is_seen_from_plus_y() -> None:
    read = read_gcode("G18\nG0 X0 Y0 Z10\nG2 X10 Z0 I0 K-10 F60\n", {})
    assert read.normal[1].tolist() == [0.0, 1.0, 0.0]
    assert np.degrees(read.sweep[1]) == pytest.approx(90.0) or np.degrees(read.sweep[1]) == pytest.approx(-270.0)


def test_cycles_are_moves_down_the_hole_and_back() -> None:
    text = "G90 G0 X0 Y0 Z20\nG98 G81 X10 Y0 Z-5 R2 F60\nG99 X20\nG80\nG0 Z20\n"
    assert _ends(text) == [
        [0, 0, 20], [10, 0, 20], [10, 0, 2], [10, 0, -5], [10, 0, 20],
        [20, 0, 20], [20, 0, 2], [20, 0, -5], [20, 0, 2], [20, 0, 20],
    ]  # fmt: skip


def test_loops_variables_and_subprograms_run() -> None:
    text = "O1\nG0 X0 Y0 Z0\n#1=0\nWHILE [#1 LT 3] DO1\n#1=#1+1\nG1 X[#1*2] F60\nEND1\nM98 P2 L2\nM30\n"
    text += "O2\nG91 Y5\nG90\nM99\n"
    assert _ends(text) == [[0, 0, 0], [2, 0, 0], [4, 0, 0], [6, 0, 0], [6, 5, 0], [6, 10, 0]]


def test_a_turned_and_a_shifted_frame_carry_every_point() -> None:
    assert _ends("G0 X0 Y0 Z0\nG68 X0 Y0 R90\nG1 X10 F60\nG69\nX0 Y0\n") == [[0, 0, 0], [0, 10, 0], [0, 0, 0]]
    assert _ends("G0 X0 Y0 Z0\nG52 X5\nG1 X10 F60\nG52 X0\nX0\n") == [[0, 0, 0], [15, 0, 0], [0, 0, 0]]
    assert _ends("G0 X10 Y0 Z0\nG92 X0\nG1 X1 F60\n") == [[10, 0, 0], [11, 0, 0]]
    assert _ends("G0 X10 Y0 Z0\nG92 X0\nG92.2\nG92.3\nG1 X1 F60\n") == [[10, 0, 0], [11, 0, 0]]


def test_what_leads_from_home_is_no_move_of_the_part() -> None:
    assert _ends("G28\nG1 Z2 F60\nX10 Y20\nX30\n") == [[10, 20, 2], [30, 20, 2]]
    with pytest.raises(CannotTellError, match="only the machine knows"):
        _ends("G28\nG1 Z2 F60\nG2 X10 Y20 I5\n")
    with pytest.raises(CannotTellError, match="after G92 is dropped"):
        _ends("G92 X0 Y0 Z0\nG1 X10 F60\nG92.1\nG1 X20\n")


@pytest.mark.parametrize("text", ["G41 D1", "G1 A30 F60", "G2 X5", "G12 I5", "/G1 X5", "G55\nG0 X1", "G1 X1 U2", "?"])
def test_what_is_not_known_is_said(text: str) -> None:
    with pytest.raises(CannotTellError, match="line"):
        read_gcode(f"G54\nG0 X0 Y0 Z0\n{text}\n", {})


def _path(text: str) -> Followed:
    read = read_gcode(text, {})
    rows, rapid = [read.end[0]], [True]
    for k in range(1, len(read)):
        if read.kind[k] == ARC:
            rows += list(follow_arc(read.end[k - 1], read.end[k], read.centre[k], read.normal[k], read.sweep[k],
                                    np.linspace(0.05, 1.0, 20)))  # fmt: skip
            rapid += [False] * 20
        else:
            rows.append(read.end[k])
            rapid.append(bool(read.kind[k] == RAPID))
    return Followed(np.array(rows), np.tile([0.0, 0, 1], (len(rows), 1)), np.array(rapid))


PART = "G0 X0 Y0 Z5\nG1 Z0 F60\nX10\nG3 X20 Y10 I0 J10\nG2 X20 Y10 I5 J0\nG1 Y20\nG0 Z5\nX0\n"


def test_a_path_that_goes_where_the_file_goes_is_the_same() -> None:
    assert find_difference(_path(PART), read_gcode(PART, {})) == ""


@pytest.mark.parametrize(
    "other",
    [
        PART.replace("G1 Y20\n", ""),
        PART.replace("G2", "G3"),
        PART.replace("Y20", "Y19.99"),
        PART.replace("\nX0\n", "\n"),
        PART.replace("G1 Y20\n", "G1 Y20\nY25\nY20\n"),
        PART.replace("G1 Z0", "G0 Z0"),
        PART.replace("G0 X0", "G0 X1"),
        PART + "X5\n",
    ],
)
def test_a_path_that_goes_another_way_is_seen(other: str) -> None:
    assert find_difference(_path(other), read_gcode(PART, {}))


def test_another_axis_and_another_feed_are_seen() -> None:
    path, read = _path(PART), read_gcode(PART, {})
    axis = path.axis.copy()
    axis[2] = [0.0, math.sin(0.01), math.cos(0.01)]
    assert "axis" in find_difference(replace(path, axis=axis), read)
    assert "feed" in find_difference(replace(path, feed=np.full(len(path.rapid), 2e-3)), read)
    assert LINE == 1


def _drilled(*heights: float, fast: str) -> str:
    """Say how a hole to Z-9 from Z2, a row at each height, differs from G83; f: a row at rapid speed."""
    read = read_gcode("G0 X0 Y0 Z2\nG83 Z-9 R2 Q4 F60\n", {})
    rows = np.array([[0.0, 0.0, 2e-3], *([0.0, 0.0, height * 1e-3] for height in heights)])
    rapid = np.array([True, *(letter == "r" for letter in fast)])
    return find_difference(Followed(rows, np.tile([0.0, 0, 1], (len(rows), 1)), rapid), read)


def test_a_drill_draws_back_fast_and_comes_again_no_deeper_than_it_has_cut() -> None:
    assert _drilled(-2, 2, -1.7, -6, 2, -5.7, -9, 2, fast="frrfrrfr") == ""
    assert _drilled(-2, 2, -2.1, -9, 2, fast="frrfr")
    assert _drilled(-2, 2, -1.7, -6, 2, fast="frrfr")
    assert _drilled(-2, 2, -1.7, -9, 2, fast="frrrr")
    assert _drilled(-9, 2, fast="rr")


def test_a_chord_at_the_middle_of_a_spiral_lies_beside_it_by_its_own_height() -> None:
    reading, chord = read_generator(
        {"generator": "spiral", "outer_radius_mm": 250.0, "length_mm": 2700.0, "feed_mm_s": 50.0, "waypoints": 2000}
    )
    sweep, end = float(reading.sweep[1]), 0.25
    angles = np.r_[np.linspace(0.0, 0.3, 4), np.linspace(0.3, sweep, 4000)[1:]]
    points = (end * angles / sweep)[:, None] * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    first = np.linspace(points[0], points[1], 5)[:-1]
    path = np.vstack([first, points[1:]])
    followed = Followed(path, np.tile([0.0, 0.0, 1.0], (len(path), 1)), np.r_[True, np.zeros(len(path) - 1, bool)],
                        chord=chord)  # fmt: skip
    assert find_difference(followed, reading) == ""
    path[3] += [0.0, 2e-4, 0.0]
    assert find_difference(followed, reading) != ""
