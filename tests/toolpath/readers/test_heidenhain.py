"""Heidenhain conversational programs: moves worked out by hand or by closed forms, in the forms that posts write."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from cam_files import cuts, ends, read_cam_text

from compplan.errors import InputError
from compplan.toolpath.readers.cnc import flow

SUFFIX = ".h"
START = "BEGIN PGM P MM\nTOOL CALL 1 Z S3000\nL X+0 Y+0 Z+10 R0 FMAX M3\n"


def close(body: str) -> str:
    return f"{START}{body}\nL Z+50 R0 FMAX M30\nEND PGM P MM\n"


FUSION = """0  BEGIN PGM slot MM
1  BLK FORM 0.1 Z  X+0  Y-25  Z-35
2  BLK FORM 0.2  X+220  Y+0  Z+0
3  ;-------------------------------------
4  ;  #3 D=10 - ZMIN=-4.5 - flat end mill
8  * - Slot1 (3)
9  M5
10 TOOL CALL 3 Z S4043
11 L M140 MB MAX
12 M3
13 L  X+10  Y-12.5 R0 FMAX
14 L  Z+85 R0 FMAX
15 M8
16 CYCL DEF 32.0 TOLERANCE
17 CYCL DEF 32.1
18 FN 0: Q50 =+600 ; Cutting
19 FN 0: Q57 =+300 ; Ramping
20 L  Z+5 FMAX
21 L  X+40  Z-1 FQ57
22 L  X+10 FQ50
23 L  Z+85 FMAX
24 M9
25 M5
26 L M140 MB MAX
27 M30
28 END PGM slot MM
"""


def test_a_program_in_the_form_of_a_generic_post_is_read_move_by_move(read) -> None:
    cam = read(FUSION)
    assert ends(cam) == [[10, -12.5, 85], [10, -12.5, 5], [40, -12.5, -1], [10, -12.5, -1], [10, -12.5, 85]]
    assert cam.toolpath.rapid.tolist() == [True, True, False, False, True]
    assert (cam.toolpath.feed * 1e3).tolist() == pytest.approx([0, 0, 5, 10, 0])
    kinds = [(event.kind, event.value) for event in cam.toolpath.events if event.kind != "comment"]
    assert kinds == [("spindle_off", 0), ("tool", 3), ("spindle_cw", 4043), ("coolant", 0), ("coolant_off", 0),
                     ("spindle_off", 0)]  # fmt: skip
    assert cam.facts.unit == "mm" and any("M140 MB MAX" in note for note in cam.facts.notes)


def test_moves_in_machine_coordinates_are_never_waypoints(read) -> None:
    cam = read(close("L Z-2 F300\nL X+20\nL Z+0 R0 FMAX M91\nL X-500 Y+0 R0 FMAX M91\nL X+5 Y+5 R0 FMAX\nL Z+8 FMAX"))
    up = [[20, 0, 10], [5, 5, 10]]  # straight up to the highest rapid, back sideways, then down
    assert ends(cam) == [[0, 0, 10], [0, 0, -2], [20, 0, -2], *up, [5, 5, 8], [5, 5, 50]]


ARCS = {
    "about a centre": ("L X+10 F600\nCC X+10 Y+10\nC X+20 Y+10 DR+", [20, 10, 10], math.pi / 2 * 10),
    "the long way": ("L X+10 F600\nCC X+10 Y+10\nC X+20 Y+10 DR-", [20, 10, 10], 1.5 * math.pi * 10),
    "a full circle": ("L X+10 F600\nCC X+10 Y+10\nC X+10 Y+0 DR-", [10, 0, 10], 2 * math.pi * 10),
    "by its radius": ("L X+10 F600\nCR X+20 Y+10 R+10 DR+", [20, 10, 10], math.pi / 2 * 10),
    "by its radius, long": ("L X+10 F600\nCR X+20 Y+10 R-10 DR-", [20, 10, 10], 1.5 * math.pi * 10),
    "smoothly": ("L X+10 F600\nCT X+20 Y+10", [20, 10, 10], math.pi / 2 * 10),
    "incremental": ("L IX+10 F600\nCC IX+0 IY+10\nC IX+10 IY+10 DR+", [20, 10, 10], math.pi / 2 * 10),
    "polar": ("L X+10 F600\nCC X+10 Y+10\nCP PA+0 DR+", [20, 10, 10], math.pi / 2 * 10),
    "helix": ("L X+10 F600\nCC X+10 Y+10\nCP IPA+720 IZ-4 DR+", [10, 0, 6], math.hypot(40 * math.pi, 4)),
    "helix and a part": ("L X+10 F600\nCC X+10 Y+10\nCP IPA-450 IZ-5 DR-", [0, 10, 5], math.hypot(25 * math.pi, 5)),
    "smoothly, polar": ("CC X+10 Y+10\nL X+10 F600\nCTP PR+10 PA+0", [20, 10, 10], math.pi / 2 * 10),
}


@pytest.mark.parametrize("case", ARCS)
def test_arcs_have_the_length_of_their_closed_form(read, case: str) -> None:
    body, end, length = ARCS[case]
    cam = read(close(body))
    assert ends(cam)[-2] == pytest.approx(end)
    assert cam.facts.arc_length_mm == pytest.approx(length) and cam.facts.arcs == 1


def test_straight_lines_to_polar_places_and_with_parameters(read) -> None:
    cam = read(close("CC X+10 Y+10\nQ1 = 20 * SIN 30\nLP PR+Q1 PA+90 F600\nLP IPA-90\nL X+Q1 Y-Q1"))
    assert cuts(cam) == [[10, 20, 10], [20, 10, 10], [10, -10, 10]]


CORNERS = {
    # 90 degrees: a rounding takes r of either move, a chamfer its side
    "RND R5": ([[15, 0, 0], [20, 5, 0]], 15 + 2.5 * math.pi + 5),
    "RND5 F100": ([[15, 0, 0], [20, 5, 0]], 15 + 2.5 * math.pi + 5),
    "CHF 4": ([[16, 0, 0], [20, 4, 0]], 16 + math.hypot(4, 4) + 6),
}


@pytest.mark.parametrize("corner", CORNERS)
def test_corners_between_straight_moves_are_rounded_and_cut(read, corner: str) -> None:
    places, length = CORNERS[corner]
    cam = read(close(f"L Z+0 FMAX\nL X+20 F600\n{corner}\nL Y+10"))
    assert all(place in cuts(cam) for place in places)
    assert cam.facts.cutting_length_mm == pytest.approx(length)


APPROACHES = {
    # contour from (20, 20) along +x; RL: the tool is left of it (+y)
    "APPR LT X+20 Y+20 LEN10 RL F500": ([10, 20], [20, 20], 10.0),
    "APPR LN X+20 Y+20 LEN10 RL F500": ([20, 30], [20, 20], 10.0),
    "APPR LN X+20 Y+20 LEN10 RR F500": ([20, 10], [20, 20], 10.0),
    "APPR CT X+20 Y+20 CCA90 R+10 RL F500": ([10, 30], [20, 20], 5 * math.pi),
    "APPR CT X+20 Y+20 CCA180 R+10 RR F500": ([20, 0], [20, 20], 10 * math.pi),
    "APPR LCT X+20 Y+20 R10 RL F500": (None, [20, 20], None),
    "APPR PLT PR+20 PA+90 LEN10 RL F500": ([10, 20], [20, 20], 10.0),
}


@pytest.mark.parametrize("block", APPROACHES)
def test_a_contour_is_approached_as_the_manual_says(read, block: str) -> None:
    begin, first, length = APPROACHES[block]
    text = close(f"L X+0 Y+40 Z+0 FMAX\nCC X+20 Y+0\n{block}\nL X+40\nDEP LT LEN15 F900")
    cam = read(text, compensation="centre_line")
    places = [point[:2] for point in ends(cam)]
    assert first in places and places[-2] == [55, 20]
    if begin is not None:
        assert begin in places and cam.facts.cutting_length_mm == pytest.approx(length + 20 + 15)
    else:
        # from (0, 40) straight to the circle of radius 10 about (20, 30), then on it counter-clockwise
        straight = math.sqrt(20**2 + 10**2 - 10**2)
        angle = math.atan2(10, -20) + math.acos(10 / math.hypot(20, 10))
        turn = (math.radians(270) - angle) % (2 * math.pi)
        assert cam.facts.cutting_length_mm == pytest.approx(straight + 10 * turn + 35)
    assert any(" compensates wear alone" in note for note in cam.facts.notes)


@pytest.mark.parametrize(
    ("block", "end"),
    [
        ("DEP LN LEN10 F500", [40, 30]),
        ("DEP CT CCA90 R+10 F500", [50, 30]),
        ("DEP LCT X+60 Y+40 R10 F500", [60, 40]),
        ("DEP LT LEN+5", [45, 20]),
    ],
)
def test_a_contour_is_left_as_the_manual_says(read, block: str, end: list[float]) -> None:
    cam = read(close(f"L X+20 Y+20 Z+0 FMAX\nL X+40 RL F500\n{block}"), compensation="centre_line")
    assert ends(cam)[-2][:2] == pytest.approx(end)


def test_subprograms_repeats_jumps_and_parameters_carry_the_program_on(read) -> None:
    body = """Q1 = 0
LBL 1
L IX+5 F600
Q1 = Q1 + 1
CALL LBL 1 REP 2
CALL LBL "DOWN"
FN 9: IF +Q1 EQU +3 GOTO LBL 7
L X+999
LBL 7
LBL 8
FN 1: Q1 = +Q1 + +1
FN 12: IF +Q1 LT +6 GOTO LBL 8
L Y+Q1
STOP M30
LBL "DOWN"
L IZ-2
LBL 0"""
    assert cuts(read(close(body))) == [[5, 0, 10], [10, 0, 10], [15, 0, 10], [15, 0, 8], [15, 6, 8]]


def test_endless_jumps_and_calls_of_other_programs_are_refused(read, monkeypatch) -> None:
    monkeypatch.setattr(flow, "MOST_LETTERS", 50_000)
    with pytest.raises(InputError, match=r"part.h:5: more than 50000 letters of blocks"):
        read(close("LBL 1\nFN 9: IF +0 EQU +0 GOTO LBL 1"))
    with pytest.raises(InputError, match=r"part.h:4: call 'CALL PGM SUB.H' is not read"):
        read(close("CALL PGM SUB.H"))


FORMULAS = {
    "Q9 = ( 3 + 2 ) * 4 - 6 / 2": 17.0, "Q9 = SQRT 16 + 2 ^ 3": 12.0, "Q9 = INT 7.9 + FRAC 1.25": 7.25,
    "Q9 = - SIN 30 * 10": -5.0, "FN 2: Q9 = +10 - +4": 6.0, "FN 3: Q9 = +3 * +3": 9.0, "FN 4: Q9 = +8 DIV +2": 4.0,
    "FN 5: Q9 = SQRT +25": 5.0, "FN 6: Q9 = SIN +30": 0.5, "FN 7: Q9 = COS +60": 0.5, "FN 8: Q9 = +3 LEN +4": 5.0,
    "FN 13: Q9 = +10 ANG +10": 45.0, "QL1 = 4 QR1": None, "Q9 = SQ 3 - ABS -2": 7.0, "Q9=PI*0": 0.0,
}  # fmt: skip


@pytest.mark.parametrize("formula", FORMULAS)
def test_parameters_take_the_value_of_their_formula(read, formula: str) -> None:
    if FORMULAS[formula] is None:
        with pytest.raises(InputError, match=r"part.h:4: "):
            read(close(formula))
        return
    assert cuts(read(close(f"{formula}\nL X+100 F600\nL X+Q9")))[-1][0] == pytest.approx(FORMULAS[formula])


DRILL = """CYCL DEF 200 DRILLING ~
  Q200=2 ;SET-UP CLEARANCE ~
  Q201=-15 ;DEPTH ~
  Q206=120 ;FEED RATE FOR PLNGNG ~
  Q202=5 ;PLUNGING DEPTH ~
  Q210=0 ;DWELL AT TOP ~
  Q203=+1 ;SURFACE COORDINATE ~
  Q204=20 ;2ND SET-UP CLEARANCE"""


def test_holes_are_drilled_from_the_clearance_to_the_depth_and_left_rapidly(read) -> None:
    cam = read(close(f"{DRILL}\nL X+10 Y+5 R0 FMAX M99\nL X+30 FMAX\nCYCL CALL M8"))
    hole = [[10, 5, 10], [10, 5, 3], [10, 5, -14], [10, 5, 3], [10, 5, 21]]
    assert ends(cam)[1:11] == hole + [[30, *point[1:]] for point in [[0, 5, 21], *hole[1:]]]
    assert cam.facts.cycles == 2 and cam.facts.cutting_moves == 0
    assert (cam.toolpath.feed * 1e3)[~cam.toolpath.rapid].tolist() == pytest.approx([2, 2])
    assert "retracts between the pecks" in cam.facts.notes[0]


def test_modal_calls_patterns_and_positions_drill_every_hole(read) -> None:
    def holes(body: str) -> list[list[float]]:
        return [point[:2] for point in cuts(read(close(f"{DRILL}\n{body}")))]

    assert holes("L X+10 Y+5 R0 FMAX M89\nL X+20 FMAX\nL X+30 FMAX M99\nL X+40 FMAX") == [[10, 5], [20, 5], [30, 5]]
    assert holes("CYCL CALL POS X+7 Y+8 Z+0 FMAX") == [[7, 8]]
    assert holes("PATTERN DEF POS1 (X+1 Y+2 Z+0) POS2 (X+3 Y+4 Z+0)\nCYCL CALL PAT FMAX M3") == [[1, 2], [3, 4]]
    circle = "CYCL DEF 220 POLAR PATTERN ~\nQ216=+50 ~\nQ217=+50 ~\nQ244=80 ~\nQ245=+0 ~\nQ246=+360 ~\nQ247=+0 ~\n"
    circle += "Q241=4 ~\nQ200=2 ~\nQ203=+0 ~\nQ204=30 ~\nQ301=1"
    assert holes(circle) == [[90, 50], [50, 90], [10, 50], [50, 10]]
    rows = "CYCL DEF 221 ~\nQ225=+5 ~\nQ226=+5 ~\nQ237=10 ~\nQ238=20 ~\nQ242=2 ~\nQ243=2 ~\nQ224=+0 ~\n"
    rows += "Q200=2 ~\nQ203=0 ~\nQ204=9"
    assert holes(rows) == [[5, 5], [15, 5], [15, 25], [5, 25]]


def test_parameters_of_a_cycle_may_change_before_its_call_and_stand_below_its_name(read) -> None:
    deeper = cuts(read(close(f"{DRILL}\nL X+10 Y+5 FMAX M99\nQ201=-20\nL X+30 FMAX M99")))
    assert [point[2] for point in deeper] == [-14, -19]
    below = DRILL.replace("DRILLING ~", "DRILLING")
    assert below != DRILL and cuts(read(close(f"{below}\nCYCL CALL"))) == cuts(read(close(f"{DRILL}\nCYCL CALL")))


def test_tapping_leaves_with_the_pitch_and_old_pecking_starts_where_the_tool_is(read) -> None:
    tap = "CYCL DEF 207 RIGID TAPPING ~\n Q200=2 ~\n Q201=-10 ~\n Q239=+1.5 ~\n Q203=0 ~\n Q204=50"
    cam = read(close(f"{tap}\nL X+10 FMAX M99"))
    assert cuts(cam) == [[10, 0, -10], [10, 0, 2]] and cam.toolpath.feed.max() * 1e3 == pytest.approx(1.5 * 50)
    inches = read(close(f"{tap}\nL X+10 FMAX M99").replace("PGM P MM", "PGM P INCH"))
    assert inches.toolpath.feed.max() * 1e3 == pytest.approx(25.4 * 1.5 * 50)
    old = "CYCL DEF 1.0 PECKING\nCYCL DEF 1.1 SET UP 2\nCYCL DEF 1.2 DEPTH -20\nCYCL DEF 1.3 PECKG 5\n"
    old += "CYCL DEF 1.4 DWELL 0\nCYCL DEF 1.5 F90"
    cam = read(close(f"{old}\nL Z+2 FMAX\nL X+10 FMAX M99"))
    assert cuts(cam) == [[10, 0, -20]] and cam.toolpath.feed.max() * 1e3 == pytest.approx(1.5)


FRAMES = {
    "shift": ("CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+100\nCYCL DEF 7.2 IY+5\nL X+1 Y+2", [101, 7, 10]),
    "shift back": ("CYCL DEF 7.0\nCYCL DEF 7.1 X+100\nCYCL DEF 7.0\nCYCL DEF 7.1 X+0\nL X+1 Y+2", [1, 2, 10]),
    "rotation": ("CYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+90\nL X+10 Y+2", [-2, 10, 10]),
    "more rotation": ("CYCL DEF 10.0\nCYCL DEF 10.1 ROT+60\nCYCL DEF 10.1 IROT+30\nL X+10 Y+2", [-2, 10, 10]),
    "mirror": ("CYCL DEF 8.0 MIRRORING\nCYCL DEF 8.1 X\nL X+10 Y+2", [-10, 2, 10]),
    "mirror back": ("CYCL DEF 8.0\nCYCL DEF 8.1 X\nCYCL DEF 8.0\nCYCL DEF 8.1\nL X+10 Y+2", [10, 2, 10]),
    "scale": ("CYCL DEF 11.0 SCALING\nCYCL DEF 11.1 SCL0.5\nL X+10 Y+2", [5, 1, 10]),
    "both": ("CYCL DEF 7.0\nCYCL DEF 7.1 X+50\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+180\nL X+10 Y+2", [40, -2, 10]),
    "TRANS": ("TRANS DATUM AXIS X+10 Y+20\nL X+1 Y+2", [11, 22, 10]),
    "machine datum": ("CYCL DEF 247 DATUM SETTING ~\n Q339=+1 ;DATUM NUMBER\nL X+1 Y+2", [1, 2, 10]),
}  # fmt: skip


@pytest.mark.parametrize("case", FRAMES)
def test_frames_move_what_follows(read, case: str) -> None:
    body, end = FRAMES[case]
    assert cuts(read(close(f"{body} F600")))[-1] == pytest.approx(end)


def test_a_mirror_turns_the_sense_of_arcs(read) -> None:
    cam = read(close("L X+0 Y+0 Z+0 FMAX\nCYCL DEF 8.0\nCYCL DEF 8.1 X\nCC X+10 Y+0\nC X+10 Y+10 DR- F600"))
    assert ends(cam)[-2] == [-10, 10, 0] and cam.facts.arc_length_mm == pytest.approx(5 * math.pi)


PLANES = {
    "PLANE SPATIAL SPA+0 SPB+90 SPC+0 TURN FMAX SEQ- TABLE ROT": ([3, 2, -1], [1, 0, 0]),
    "PLANE SPATIAL SPA+90 SPB+0 SPC+0 STAY": ([1, -3, 2], [0, -1, 0]),
    "PLANE SPATIAL SPA+45 SPB+0 SPC+90 MOVE DIST50 F2000": (None, [math.sqrt(0.5), 0, math.sqrt(0.5)]),
}


@pytest.mark.parametrize("plane", PLANES)
def test_tilted_planes_turn_the_coordinates_and_the_tool(read, plane: str) -> None:
    place, axis = PLANES[plane]
    body = "L A+Q120 C+Q122 R0 FMAX\nL X+1 Y+2 FMAX\nL Z+3 FMAX\nL IX+1 F600\nPLANE RESET STAY\nL X+0 Y+0 FMAX"
    cam = read(close(f"{plane}\n{body}"))
    if place is not None:
        assert ends(cam)[1] == pytest.approx(place)
    assert cam.toolpath.axis[1] == pytest.approx(axis, abs=1e-12) and cam.toolpath.axis[2] == pytest.approx(axis)
    assert cam.toolpath.axis[-1] == pytest.approx([0, 0, 1])


def test_cycle_19_asks_what_its_angles_are(read) -> None:
    body = "CYCL DEF 19.0 WORKING PLANE\nCYCL DEF 19.1 A+90 B+0 C+0\nL X+1 Y+2 Z+3 FMAX\nL IX+1 F600"
    with pytest.raises(InputError, match=r"part.h:5: cycle 19 states spatial angles on some machines"):
        read(close(body))
    assert read(close(body), tilt_angles="spatial").toolpath.axis[1] == pytest.approx([0, -1, 0])
    assert ends(read(close(body.replace("A+90", "A+0"))))[1] == [1, 2, 3]


def test_vectors_of_ln_blocks_turn_the_tool(read) -> None:
    cam = read(close("LN X+10 Y+0 Z+0 NX+0 NY+0 NZ+1 TX+0.6 TY+0 TZ+0.8 F600 M128\nLN X+20 Y+0 Z+0 TX+0 TY+0 TZ+1"))
    at = np.flatnonzero(np.isclose(cam.toolpath.position[:, 0], 0.01))[0]
    assert cam.toolpath.axis[at] == pytest.approx([0.6, 0, 0.8]) and cam.toolpath.axis[-2] == pytest.approx([0, 0, 1])
    assert cam.facts.cutting_moves == 2 and len(cam.toolpath) > 70


def test_spatial_angles_under_tcpm_need_no_machine(read) -> None:
    cam = read(close("FUNCTION TCPM F TCP AXIS SPAT PATHCTRL VECTOR\nL X+10 A+0 B+30 C+90 F600\nFUNCTION RESET TCPM"))
    assert cam.toolpath.axis[-1] == pytest.approx([0, 0.5, math.sqrt(0.75)], abs=1e-12)


def test_programs_in_inches_count_feeds_in_tenths_of_an_inch(read) -> None:
    text = "BEGIN PGM P INCH\nL X+0 Y+0 Z+1 FMAX\nL X+2 F120\nEND PGM P INCH\n"
    cam = read(text)
    assert ends(read(text.replace("INCH", "IN"))) == ends(cam)  # a post writes it short
    assert ends(cam) == [[0, 0, 25.4], [50.8, 0, 25.4]] and cam.toolpath.feed[-1] * 1e3 == pytest.approx(5.08)
    assert cam.facts.unit == "inch"


def test_tools_are_events_by_number_or_name_and_a_speed_alone_is_no_tool(read) -> None:
    cam = read(close('L X+5 F600\nTOOL CALL S5000\nL X+6\nTOOL CALL "MILL_10" Z S2000 F900 DR+0.1\nM3\nL X+9 FAUTO'))
    told = [(event.kind, event.value, event.text) for event in cam.toolpath.events if event.kind != "comment"]
    assert told[:5] == [("tool", 1, ""), ("spindle_cw", 3000, ""), ("spindle_cw", 5000, ""), ("tool", 0, "MILL_10"),
                        ("spindle_cw", 2000, "")]  # fmt: skip
    assert cam.toolpath.feed[-2] * 1e3 == pytest.approx(15) and any("DL, DR" in note for note in cam.facts.notes)


REFUSED = [
    ("FL X+10", "FL (free contours) is not read"), ("SPL X+1 K3X0", "SPL (splines) is not read"),
    ("CYCL DEF 251 RECTANGULAR POCKET ~\n Q215=0", "CYCL DEF 251 is not read"), ("CYCL DEF 4.0 POCKET", "CYCL DEF 4"),
    ("L X+1O F9", "cannot read"), ("L X+Q77 F9", "parameter Q77 has no value"), ("L X+1 X+2 F9", "word X stands twice"),
    ("C X+1 Y+1 DR+", "no pole or centre"), ("CC X+5 Y+5\nC X+1 Y+1", "arc without a sense"),
    ("CC X+5 Y+5\nC X+1 Y+9 DR+ F9", "arc starts"), ("CR X+9 R+1 DR+ F9", "cannot join ends"),
    ("CT X+9 Y+9", "tangentially"),
    ("L X+5 M130", "M130"), ("RND R5", "does not stand between"),
    ("L X+9 F9\nRND R5\nL Y+9 FMAX", "no cutting move after"),
    ("L X+9 F9\nRND R50\nL Y+9", "takes"), ("PLANE AXIAL B+30 STAY", "PLANE AXIAL is not read"),
    ("LBL 1\nLBL 1", "label 1 occurs twice"), ("CALL LBL 9", "label 9 is not in"),
    ("CALL LBL 1 REP 2\nM30\nLBL 1\nL X+1 F9", "REP before its label"),
    ("M99", "before a supported cycle is defined"), ("CYCL DEF 200 Q200=2 Q201=9 Q206=9\nM99", "depth Q201 above"),
    ("HELLO X+5", "is not read and may move"), ("L X+1 B+30 F9", "rotary"),
    ("FN 18: SYSREAD Q1 = ID20\nL X+Q1", "FN 18"),
    ("CYCL DEF 10.0\nCYCL DEF 10.1 ROT+9\nCYCL DEF 7.0\nCYCL DEF 7.1 X+9", "after a rotation"),
    ("L X+9 FZ0.1", "per tooth"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "sentence"), REFUSED, ids=[body.split("\n")[0] for body, _ in REFUSED])
def test_what_is_not_read_is_refused_with_its_line(read, body: str, sentence: str) -> None:
    with pytest.raises(InputError) as fault:
        read(close(body))
    assert sentence in str(fault.value) and "part.h:" in str(fault.value)


def test_din_iso_programs_of_the_same_controls_are_refused_clearly(read) -> None:
    with pytest.raises(InputError, match=r"part.h:1: a DIN/ISO program of a Heidenhain control is not read"):
        read("%PART G71 *\nN10 G00 G40 G90 Z+250 *\n")


def test_the_text_says_the_language_whatever_the_ending(tmp_path: Path) -> None:
    assert read_cam_text(tmp_path, FUSION, ".nc").facts.kind == "heidenhain"


def test_a_compensated_contour_asks_what_the_file_holds(read) -> None:
    with pytest.raises(InputError, match=r":4: RL compensates .* --compensation centre_line"):
        read(close("L Z-2 F300 RL"))
    assert cuts(read(close("L Z-2 F300 RL\nL X+20 R0"), compensation="centre_line")) == [[0, 0, -2], [20, 0, -2]]


def test_a_plain_block_is_read_as_any_other(read) -> None:
    """Blocks of X Y Z F alone are read the short way; with R0 F900 M8 they are not: both make the same path."""
    plain = "L Z-2 F300\nL X+10\nL X+20 Y-5.5 F900\nL Z+.5 M90\nRND R2\nL Y+7\nL X-3"
    other = plain.replace("\nL X", "\nL R0 X").replace("\nL Z+.5 M90", "\nL R0 Z+.5 M90")
    one, two = (read(close(f"CYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+3\n{body}")) for body in (plain, other))
    assert ends(one) == ends(two) and one.toolpath.feed.tolist() == two.toolpath.feed.tolist()


def test_marked_blocks_are_read_and_cycle_numbers_may_stand_close(read) -> None:
    """hyperMILL writes /81 M30 and CYCL DEF9 .0; what an operator may skip is carried out, and said."""
    cam = read(close("CYCL DEF9 .0 DWELL TIME\nCYCL DEF9.1 DWELL5\n/7 L Z-2 F300\n8 / L X+20"))
    assert cuts(cam) == [[0, 0, -2], [20, 0, -2]]
    assert "line 6: blocks marked with / are read (2 times)" in cam.facts.notes
