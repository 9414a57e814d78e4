"""What a G-code block makes a machine do: home, M codes' words, work offsets, rotary axes, cycles, macros."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cam_files import read_cam_text
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from compplan.errors import InputError
from compplan.path.cam import CamFile
from compplan.path.cam.gcode_macro import MacroError, Variables, assign, work_out
from compplan.path.cam.gcode_rotary import Machine

HEAD = "G21 G90\nG0 X0 Y0 Z10\n"


@pytest.fixture
def read(tmp_path: Path):
    return partial(read_cam_text, tmp_path)


def rows(cam: CamFile) -> list[tuple[float, ...]]:
    """Waypoints as x, y, z [mm], rapid."""
    path = cam.toolpath
    return [(*(row * 1e3).round(6).tolist(), float(fast)) for row, fast in zip(path.position, path.rapid, strict=True)]


@pytest.mark.parametrize("home", ["G28 G91 Z0.", "G91 G28 Z0.", "G53 G0 Z0.", "G30 G91 Z0", "g91g28z0", "Z0 G91 G28"])
def test_the_way_home_never_ends_at_z_0(read, home: str) -> None:
    cam = read(f"G21 G90\n{home}\nG90\nG0 X75 Y50\nG43 Z15 H1\nG1 Z-9 F600\nX90\n{home}\nG90\nM30\n", ".nc")
    assert rows(cam) == [(75, 50, 15, 1), (75, 50, -9, 0), (90, 50, -9, 0), (90, 50, 15, 1)]


def test_after_the_way_home_the_tool_goes_sideways_above_the_part_before_it_goes_down(read) -> None:
    cam = read(HEAD + "G0 Z30\nG1 Z-5 F60\nG28 G91 Z0\nG90 G0 X50 Y0\nZ2\nG1 Z-5\nM30\n", ".nc")
    assert rows(cam)[3:] == [(0, 0, 30, 1), (50, 0, 30, 1), (50, 0, 2, 1), (50, 0, -5, 0)]
    away = read(HEAD + "G1 Z-5 F60\nG0 Z10\nG28 G91 X0 Y0\nG90 G0 X5 Y5 Z3\nM30\n", ".nc")
    assert rows(away)[-2:] == [(5, 5, 10, 1), (5, 5, 3, 1)]


def test_home_in_absolute_coordinates_goes_through_its_point(read) -> None:
    assert rows(read(HEAD + "G1 Z-1 F9\nG28 Z12\nG0 X1 Y1 Z12\nG1 Z0\n", ".nc"))[2] == (0, 0, 12, 1)


def test_a_cut_from_the_machines_home_is_refused(read) -> None:
    with pytest.raises(InputError, match=r"part.nc:4: a cut begins at the machine's home"):
        read("G21 G90 M3 S900\nG28 G91 Z0\nG90 G0 X0 Y0\nG1 Z-1 F60\nX5\n", ".nc")
    with pytest.raises(InputError, match=r"part.nc:5: an arc begins where nobody knows"):
        read(HEAD + "G28 G91 Z0\nG90\nG2 X10 R5 F60\n", ".nc")


@pytest.mark.parametrize(
    "code", ["M205 X8 Y8", "M201 X500 Y500 Z12 E120", "M92 X80 Y80 Z400 E93", "M203 X200 Y200", "M900 K0.2",
             "M566 X480 Y480 Z24", "M204 P800 R1500 T1500", "M104 S215", "M106 S255", "X8 Y8 M205", "M117 Layer X8 Y8",
             "M862.3 P \"MK3S\"", "G22 X50 Y50 Z50 I0 J0 K0", "G43.1 Z3", "M73 P0 R45", "M115 U3.9.0"],
)  # fmt: skip
def test_words_of_codes_that_own_them_move_nothing(read, code: str) -> None:
    cam = read(f"{HEAD}M3 S500\nG1 Z0 F300\nX50\n{code}\nX60 Y10\n", ".gcode")
    assert rows(cam) == [(0, 0, 10, 1), (0, 0, 0, 0), (50, 0, 0, 0), (60, 10, 0, 0)]
    kinds = [(event.kind, event.value) for event in cam.toolpath.events if event.kind != "comment"]
    assert kinds == [("spindle_cw", 500), ("spindle_off", 0)]


def test_an_m_code_whose_words_are_not_known_is_refused(read) -> None:
    with pytest.raises(InputError, match=r":3: M777 with coordinates and no G code"):
        read(HEAD + "X8 M777\nG1 X1 F9\n", ".nc")
    assert read(HEAD + "G1 X8 F9 M777\n", ".nc").facts.cutting_moves == 1


def test_cuts_in_two_work_offsets_ask_for_the_part_frame(read) -> None:
    text = HEAD + "G1 X10 F9\nG0 Z10\nG55\nG0 X0 Y0 Z10\nG1 X20\nG54\nG0 X0 Y0 Z10\nG1 X30\nM30\n"
    with pytest.raises(InputError, match=r'part.nc:7: the file cuts in G54 and in G55, .* with wcs = "G54"'):
        read(text, ".nc")
    ends = [(10, 0, 10, 0), (30, 0, 10, 0)]
    assert [row for row in rows(read(text, ".nc", wcs="G54")) if row[3] == 0] == ends
    second = read(text, ".nc", wcs="G55")
    assert [row for row in rows(second) if row[3] == 0] == [(20, 0, 10, 0)]
    assert any("other work offsets" in note and "2 of them" in note for note in second.facts.notes)
    with pytest.raises(InputError, match="wcs is G57, which the file does not use; it uses G54, G55"):
        read(text, ".nc", wcs="G57")
    parked = HEAD + "G1 X10 F9\nG0 Z10\nG59 G0 X0 Y0\nM30\n"
    assert read(parked, ".nc").facts.rapid_moves == 1  # a rapid in another offset is no part of the path


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return {"A": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), "B": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            "C": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])}[axis]  # fmt: skip


AXES = {
    "head": lambda t, c, tilt: turn("C", c) @ turn(tilt, t) @ [0, 0, 1],
    "table": lambda t, c, tilt: (turn(tilt, t) @ turn("C", c)).T @ [0, 0, 1],
    "head_table": lambda t, c, tilt: turn("C", c).T @ turn(tilt, t) @ [0, 0, 1],
}


@pytest.mark.parametrize("kind", list(AXES))
@pytest.mark.parametrize("tilt", ["A", "B"])
def test_the_tool_axis_is_that_of_the_stated_machine(read, kind: str, tilt: str) -> None:
    cam = read(f"G21 G90\nG43.4 H1\nG0 X0 Y0 Z5 {tilt}30 C45\nG1 X10 F60\n", ".nc", rotary=kind)
    assert cam.toolpath.axis[-1] == pytest.approx(AXES[kind](30, 45, tilt))
    assert rows(cam)[-1][:3] == (10, 0, 5)  # the tip stays what the file says


def test_the_part_turns_under_the_tool_without_control_of_the_tip(read) -> None:
    """Oracle: a point of the part is carried by C and then by A, each about its own line."""
    centre, offset = np.array([10.0, 20.0, -50.0]), np.array([0.0, 0.0, 30.0])
    options = {"rotary": "table", "rotary_centre_mm": centre.tolist(), "rotary_offset_mm": offset.tolist()}
    cam = read("G21 G90\nG0 A30 C45\nG0 X5 Y6 Z20\nG1 Z7 F60\nG1 X30 A35 C90\n", ".nc", **options)

    def carry(point: np.ndarray, a: float, c: float) -> np.ndarray:
        second = centre + offset
        return centre + turn("A", a) @ (second + turn("C", c) @ (point - second) - centre)

    path = cam.toolpath.position * 1e3
    assert carry(path[0], 30, 45) == pytest.approx([5, 6, 20])
    assert carry(path[1], 30, 45) == pytest.approx([5, 6, 7])
    assert carry(path[-1], 35, 90) == pytest.approx([30, 6, 7])
    shares = np.linspace(0, 1, len(path) - 1)
    for point, share in zip(path[1:], shares, strict=True):  # evenly in between
        assert carry(point, 30 + 5 * share, 45 + 45 * share) == pytest.approx([5 + 25 * share, 6, 7], abs=1e-6)
    assert cam.facts.cutting_moves == 2 and len(path) > 40


def test_a_head_swings_its_tip_about_the_pivot(read) -> None:
    cam = read("G21 G90\nG0 X0 Y0 Z0 B90\nG1 X5 F60\n", ".nc", rotary="head", pivot_mm=100.0)
    assert rows(cam)[-1][:3] == (-95, 0, 100)
    with pytest.raises(InputError, match=r"part.nc:2: B90 without control of the tip .* state pivot_mm"):
        read("G21 G90\nG0 X0 Y0 Z0 B90\nG1 X5 F60\n", ".nc", rotary="head")
    with pytest.raises(InputError, match=r"state rotary_centre_mm .* or tip_control = true"):
        read("G21 G90\nG0 X0 Y0 Z0 B90\nG1 X5 F60\n", ".nc", rotary="table")
    assert rows(read("G21\nG0 X0 Y0 Z0 B9\nG1 X5 F60\n", ".nc", rotary="table", tip_control=True))[-1][:3] == (5, 0, 0)


def test_axes_in_an_order_of_their_own_and_against_the_right_hand() -> None:
    angles = {"A": 20.0, "B": 30.0, "C": 40.0}
    assert Machine(head=(("A", 1.0), ("B", 1.0))).point_tool(angles) == pytest.approx(
        turn("A", 20) @ turn("B", 30) @ [0, 0, 1]
    )
    assert Machine(table=(("B", -1.0), ("C", -1.0))).point_tool(angles) == pytest.approx(
        (turn("B", -30) @ turn("C", -40)).T @ [0, 0, 1]
    )


def test_a_and_b_together_ask_which_carries_the_other(read) -> None:
    text = "G21 G43.4 H1\nG0 X0 Y0 Z5 A30 B45\nG1 Z0 F9\n"
    with pytest.raises(InputError, match=r'which carries the other is not known; state rotary_axes = \["A", "B"\]'):
        read(text, ".nc", rotary="head")
    cam = read(text, ".nc", rotary="head", rotary_axes=["A", "B"])
    assert cam.toolpath.axis[-1] == pytest.approx(turn("A", 30) @ turn("B", 45) @ [0, 0, 1])


def test_a_tilted_plane_turns_path_and_tool(read) -> None:
    plane = "G68.2 X10 Y20 Z30 I90 J40 K-90\nG53.1\nG0 X0 Y0\nG43 Z5 H1\nG1 Z0 F60\nX7\nG2 X9 Y2 R2\nG0 Z5\nG69\n"
    cam = read(f"G21 G90\nG0 X0 Y0 Z100\n{plane}G0 A0 C0\nG0 X0 Y0 Z100\nG1 X5 F60\n", ".nc")
    turned = turn("C", 90) @ turn("A", 40) @ turn("C", -90)
    path, start = cam.toolpath.position * 1e3, np.array([10, 20, 30])
    assert path[1] == pytest.approx(start + turned @ [0, 0, 5])
    assert path[3] == pytest.approx(start + turned @ [7, 0, 0])
    assert cam.toolpath.axis[3] == pytest.approx(turned @ [0, 0, 1])
    arc = (path[4:-4] - start) @ turned
    assert np.hypot(arc[:, 0] - 9, arc[:, 1]) == pytest.approx(2) and arc[:, 2] == pytest.approx(0, abs=1e-9)
    assert rows(cam)[-1][:3] == (5, 0, 100) and cam.toolpath.axis[-1].tolist() == [0, 0, 1]
    with pytest.raises(InputError, match=r"a cut in a tilted plane .* that the tool is not turned to"):
        read("G21 G90\nG0 X0 Y0 Z9\nG68.2 X0 Y0 Z0 I0 J30 K0\nG0 X0 Y0 Z5\nG1 Z0 F9\n", ".nc")


def test_rotations_scales_mirrors_and_polar_coordinates_move_the_path(read) -> None:
    def end(text: str) -> list[float]:
        return [round(v, 6) for v in rows(read(HEAD + text, ".nc"))[-1][:3]]

    assert end("G68 X0 Y0 R90\nG1 X10 Y0 F9\n") == [0, 10, 10]
    assert end("G68 X5 Y0 R90\nG91 G1 X10 F9\n") == [0, 10, 10]
    assert end("G68 X0 Y0 R90\nG1 X10 F9\nG69\nG1 X3 Y0\n") == [3, 0, 10]
    assert end("G51 X0 Y0 Z0 P2.\nG1 X10 Z1 F9\n") == [20, 0, 2]
    assert end("G51 X0 Y0 Z0 P2000\nG1 X10 Z1 F9\n") == [20, 0, 2]
    assert end("G51.1 X5\nG1 X0 Y3 F9\n") == [10, 3, 10]
    assert end("G51.1 X5\nG50.1\nG1 X2 Y3 F9\n") == [2, 3, 10]
    assert end("G16\nG1 X10 Y90 F9\nG15\n") == [0, 10, 10]
    assert end("G16\nG1 X10 Y30 F9\nG91 Y60\nG90 G15\n") == [0, 10, 10]
    mirrored = read(HEAD + "G51.1 X0\nG1 X0 Y0 F9\nG3 X10 Y10 R10\n", ".nc").toolpath.position[2:] * 1e3
    assert np.hypot(mirrored[:, 0], mirrored[:, 1] - 10) == pytest.approx(10)  # it turns the other way, about (0, 10)
    with pytest.raises(InputError, match="would be an ellipse"):
        read(HEAD + "G51 X0 Y0 Z0 I2. J1. K1.\nG2 X10 R5 F9\n", ".nc")


CYCLE = "G21 G90\nG0 X0 Y0 Z20\n{} F60\nX10\nG80 G90\nG1 X0 Y0 F60\n"


@pytest.mark.parametrize(
    ("cycle", "levels"),
    [
        ("G81 G98 Z-5 R2", [2, -5, 20]), ("G81 G99 Z-5 R2", [2, -5, 2]), ("G82 G99 Z-5 R2 P500", [2, -5, 2]),
        ("G85 G99 Z-5 R2", [2, -5, 2]), ("G83 G99 Z-5 R2 Q3", [2, -1, 2, -0.746, -4, 2, -3.746, -5, 2]),
        ("G73 G99 Z-5 R2 Q3", [2, -1, -0.746, -4, -3.746, -5, 2]),
        ("G83 G99 Z-5 R2 I4 J1 K2", [2, -2, 2, -1.746, -5, 2]), ("G86 G98 Z-5 R2", [2, -5, 20]),
        ("G91 G81 G99 Z-7 R-18 L1", [2, -5, 2]),
    ],
)  # fmt: skip
def test_a_cycle_drills_as_its_control_does(read, cycle: str, levels: list[float]) -> None:
    cam = read(CYCLE.format(cycle), ".nc")
    first = [row[2] for row in rows(cam)[1 : 1 + len(levels)]]
    assert first == pytest.approx(levels)
    assert (cam.facts.cycles, cam.facts.cutting_moves) == (2, 1)
    assert rows(cam)[1 + len(levels)] == (10, 0, levels[-1], 1)


def test_the_initial_level_stays_while_cycles_change_and_k_0_drills_nothing(read) -> None:
    cam = read(HEAD + "G99 G81 X5 Z-1 R2 F60\nG98 G82 X6 Z-2 R3 P100\nG0 X0\nG1 X1 F60\n", ".nc")
    assert [row for row in rows(cam) if row[0] == 6][-1] == (6, 0, 10, 1)
    cam = read(HEAD + "G81 X5 Z-1 R2 K0 F60\nX7\nG80\nG1 X1 F60\n", ".nc")
    assert [row[0] for row in rows(cam) if row[2] == -1] == [7]


def test_tapping_turns_the_spindle_back(read) -> None:
    cam = read(HEAD + "M3 S500\nG84 X5 Z-5 R2 F500\nG80\nG1 X9 F60\nM30\n", ".nc")
    assert [(e.kind, e.place) for e in cam.toolpath.events] == [
        ("spindle_cw", 0), ("spindle_ccw", 3), ("spindle_cw", 4), ("spindle_off", 6),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "tools"),
    [
        ("T1 M6\nT2\nG1 X1 F9\nM6\nG1 X2", [1, 2]), ("M6 T3\nG1 X1 F9", [3]), ("M06 T04\nT5\nG1 X1 F9", [4]),
        ("T1\nG1 X1 F9\nT2\nG1 X2", [1, 2]), ("T1 D1\nG1 X1 F9\nT1\nG1 X2", [1]), ("M61 Q7\nG1 X1 F9", [7]),
        ("N5T12M06\nG1 X1 F9", [12]),
    ],
)  # fmt: skip
def test_each_tool_change_is_told_once_with_its_number(read, text: str, tools: list[int]) -> None:
    cam = read(f"{HEAD}{text}\nM30\n", ".nc")
    assert [event.value for event in cam.toolpath.events if event.kind == "tool"] == tools


MACRO = """%
O1000 (HOLES)
G21 G90
G0 X0 Y0 Z10
#100 = 10. (RADIUS)
#1 = 0
WHILE [#1 LT 4] DO 1
#2 = #1 * 90
G0 X[#100 * COS[#2]] Y[#100 * SIN[#2]]
G1 Z-#101 F[60 * 2]
G0 Z10.
#1 = #1 + 1
END 1
IF [#1 NE 4] GOTO 900
M98 P2000 L2
G65 P3000 X7. Y8. Z-1.5
GOTO 950
N900 G1 X999.
N950 M30
O2000
G91 G1 X1. F60
G90
M99
O3000
G0 X#24 Y#25
IF [#26 EQ #0] GOTO 10
G1 Z#26 F60
N10 G0 Z10.
M99
%
"""


def test_macros_loops_jumps_and_subprograms_of_the_file_are_carried_out(read) -> None:
    cam = read(MACRO.replace("#101", "3"), ".nc")
    cuts = np.array([row[:3] for row in rows(cam) if row[3] == 0])
    expected = [(10, 0, -3), (0, 10, -3), (-10, 0, -3), (0, -10, -3), (1, -10, 10), (2, -10, 10), (7, 8, -1.5)]
    assert cuts == pytest.approx(np.array(expected))
    with pytest.raises(InputError, match=r"part.nc:10: #101 is read before the file has set it"):
        read(MACRO, ".nc")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("N1 G1 X1 F9\nGOTO 1", ":4: this jump repeats without end"),
        ("#1=0\nN1 #1=#1+1\nGOTO 1", ":5: more than 20000 jumps"),
        ("WHILE [1 EQ 1] DO 1\nG1 X1 F9\nEND 1", ":5: this jump repeats without end"),
        ("GOTO 77", ":3: jump to block N77, which is not in this program"),
        ("WHILE [1 EQ 2] DO 1\nG1 X1 F9", "loop 1 has no END 1"),
        ("#1=1/0", ":3: division by 0"), ("#1=SQRT[-1]", "has no value"), ("#1=[1", "expected '\\]'"),
        ("G1 X" + "[" * 100 + "1" + "]" * 100, "more than 50 brackets"),
        ("IF [1 EQ 1] THAT", "expected IF \\[..\\] GOTO or THEN"), ("#1=5 AND 3", "of conditions only"),
    ],
)  # fmt: skip
def test_macros_are_bounded_and_refused_with_their_line(read, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read(f"{HEAD}{text}\n", ".nc")


NUMBERS = st.floats(-100, 100).map(lambda x: round(x, 3))


@given(NUMBERS, NUMBERS, NUMBERS)
@settings(max_examples=50, deadline=None)
def test_expressions_are_worked_out_by_the_rules_of_arithmetic(a: float, b: float, c: float) -> None:
    variables = Variables()
    assert assign(f"#1={a:.3f} #2=[{b:.3f}] #<THREE>={c:.3f}", variables)
    value, used = work_out("#1 - #2 * #<THREE> + [#1 + #2] * 2", variables)
    assert value == pytest.approx(a - b * c + (a + b) * 2) and used == 34
    assert work_out("ATAN[1]/[-1] + ABS[#1] + ROUND[2.5] + FIX[2.9] + FUP[2.1]", variables)[0] == pytest.approx(
        135 + abs(a) + 3 + 2 + 3
    )
    assert work_out("[#1 GT #2] OR [#1 LE #2]", variables)[0] == 1.0
    with pytest.raises(MacroError):
        work_out("#1 +", variables)


BLOCKS = [
    ["N10", "G21", "G90", "G17", "G0", "X1.5", "Y-2", "Z10"], ["N20", "T3", "M6"], ["N30", "S900", "M3", "M8"],
    ["N40", "G1", "Z-1", "F300"], ["N50", "X20", "Y5.25"], ["N60", "G2", "X30", "Y15.25", "I0", "J10", "F200"],
    ["N70", "G91", "G1", "X1"], ["N80", "G90", "G3", "X21", "Y15.25", "R10"], ["N85", "G0", "Z10"],
    ["N90", "G98", "G83", "X5", "Y5", "Z-3", "R2", "Q1.5", "F60"], ["N95", "G80", "G0", "X0"],
    ["N100", "G28", "G91", "Z0"], ["N110", "G90", "G53", "G0", "Z0"], ["N120", "M5", "M9"], ["N130", "M30"],
]  # fmt: skip


@given(st.randoms(use_true_random=False))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_order_of_words_spaces_comments_numbers_and_case_change_nothing(read, draw) -> None:
    plain = read("\n".join(" ".join(block) for block in BLOCKS), ".nc")
    lines = []
    for block in BLOCKS:
        number, *words = block
        draw.shuffle(words)
        gap = draw.choice(["", " ", "  ", "\t"])
        line = gap.join([*([number] if draw.random() < 0.5 else []), *words])
        line = draw.choice([line, line.lower(), f"(X99 G0) {line}", f"{line} ;G1 X99", f"{line}(Z-99)"])
        lines += [line, *([""] if draw.random() < 0.2 else []), *(["(G1 X77)"] if draw.random() < 0.2 else [])]
    other = read(draw.choice(["\n", "\r\n"]).join(lines), ".nc")
    assert np.array_equal(plain.toolpath.position, other.toolpath.position)
    assert np.array_equal(plain.toolpath.feed, other.toolpath.feed)
    assert np.array_equal(plain.toolpath.rapid, other.toolpath.rapid)
    told = [[event for event in cam.toolpath.events if event.kind != "comment"] for cam in (plain, other)]
    assert told[0] == told[1]
