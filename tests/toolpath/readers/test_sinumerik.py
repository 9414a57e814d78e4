"""Sinumerik 840D programs: moves worked out by hand or by closed forms, in the forms that posts write."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from cam_files import cuts, ends, read_cam_text

from compplan.errors import InputError
from compplan.toolpath.readers.cnc import flow

SUFFIX = ".mpf"
HEAD = "G17 G71 G90 G40 G54\nT1 M6\nS3000 M3\nG0 X0 Y0\nG0 Z10\n"


POST = """%_N_POCKET_MPF
;$PATH=/_N_WKS_DIR/_N_PART_WPD
; Programm: POCKET
N10 G40 G17 G710 G94 G90 G60 G601 FNORM
N20 WORKPIECE(,"",,"BOX",112,0,-20,-80,0,0,100,100)
N30 T="FRAESER_D10"
N40 M6
N50 S8000 D1 M3
N60 G0 G54 X10 Y10 M8
N70 Z50
N80 CYCLE832(0.05,3,1)
N90 MSG("Schruppen")
N100 SUPA G0 Z0 D0
N110 G0 X10 Y10 D1
N120 Z2
N130 G1 Z-2 F300
N140 G64 X30 F1200
N150 G3 X40 Y20 I0 J10
N160 G2 X50 Y30 CR=10 RND=0
N170 G0 Z50
N180 CYCLE832()
N190 M9
N200 M30
"""


def test_a_program_in_the_form_of_a_post_is_read_move_by_move(read) -> None:
    cam = read(POST)
    assert ends(cam)[:5] == [[10, 10, 50], [10, 10, 2], [10, 10, -2], [30, 10, -2], ends(cam)[4]]
    assert [40, 20, -2] in ends(cam) and ends(cam)[-2:] == [[50, 30, -2], [50, 30, 50]]
    assert cam.facts.arc_length_mm == pytest.approx(10 * math.pi) and cam.facts.cutting_moves == 4
    assert (cam.toolpath.feed[[2, 3]] * 1e3).tolist() == pytest.approx([5, 20])
    told = [(event.kind, event.value, event.text) for event in cam.toolpath.events if event.kind != "comment"]
    assert told == [("tool", 0, "FRAESER_D10"), ("spindle_cw", 8000, ""), ("coolant", 0, ""), ("coolant_off", 0, ""),
                    ("spindle_off", 0, "")]  # fmt: skip
    assert cam.facts.unit == "mm" and any("SUPA" in note for note in cam.facts.notes)


ARCS = {
    "G3 X20 Y10 I=AC(10) J=AC(10)": ([20, 10, 10], 5 * math.pi),
    "G2 X20 Y10 I0 J10": ([20, 10, 10], 15 * math.pi),
    "G3 X=IC(10) Y=IC(10) CR=10": ([20, 10, 10], 5 * math.pi),
    "G2 X20 Y10 CR=-10": ([20, 10, 10], 15 * math.pi),
    "G3 X10 Y0 I0 J10": ([10, 0, 10], 20 * math.pi),
    "CIP X20 Y10 I1=17.0710678 J1=2.9289322": ([20, 10, 10], 5 * math.pi),
    "CT X20 Y10": ([20, 10, 10], 5 * math.pi),
    "G111 X10 Y10\nG3 AP=0 RP=10": ([20, 10, 10], 5 * math.pi),
    "G3 X10 Y0 Z4 I0 J10 TURN=2": ([10, 0, 4], math.hypot(60 * math.pi, 6)),
    "G3 X20 Y10 Z6 I0 J10 TURN=2": ([20, 10, 6], math.hypot(45 * math.pi, 4)),
}


@pytest.mark.parametrize("block", ARCS)
def test_arcs_have_the_length_of_their_closed_form(read, block: str) -> None:
    end, length = ARCS[block]
    cam = read(f"{HEAD}G1 X10 F600\n{block}\nM30\n")
    assert ends(cam)[-1] == pytest.approx(end, abs=1e-5)
    assert cam.facts.arc_length_mm == pytest.approx(length, rel=1e-6) and cam.facts.arcs == 1


def test_poles_lead_to_polar_places(read) -> None:
    cam = read(f"{HEAD}G111 X10 Y10\nG1 RP=10 AP=90 F600\nAP=IC(-90)\nG110 X5 Y0\nG1 AP=180 RP=5\nG112 X0 Y10\nAP=0\n")
    assert cuts(cam) == [[10, 20, 10], [20, 10, 10], [30, 20, 10]]


def test_corners_are_rounded_and_cut(read) -> None:
    def length(words: str) -> float:
        return read(f"{HEAD}G0 Z0\nG1 X20 F600 {words}\nY10\n").facts.cutting_length_mm

    assert length("RND=5") == pytest.approx(20 + 2.5 * math.pi)
    assert length("CHR=4") == pytest.approx(22 + math.hypot(4, 4))
    assert length("CHF=4") == pytest.approx(30 - 8 * math.sqrt(0.5) + 4)
    slower = read(f"{HEAD}G0 Z0\nG1 X20 F600 CHR=4 FRC=90\nY10\n").toolpath  # mm/min on the chamfer alone
    assert (1e3 * slower.feed[~slower.rapid]).tolist() == pytest.approx([10.0, 1.5, 10.0])


FRAMES = {
    "TRANS X100\nG1 X1 Y2 F60": [101, 2, 10],
    "TRANS X100\nATRANS X5 Y1\nG1 X1 Y2 F60": [106, 3, 10],
    "TRANS X100\nTRANS Y5\nG1 X1 Y2 F60": [1, 7, 10],
    "ROT RPL=90\nG1 X10 Y2 F60": [-2, 10, 10],
    "ROT Z90\nG1 X10 Y2 F60": [-2, 10, 10],
    "TRANS X50\nAROT Z90\nG1 X10 Y2 F60": [48, 10, 10],
    "MIRROR X0\nG1 X10 Y2 F60": [-10, 2, 10],
    "SCALE X2 Y2 Z2\nG1 X10 Y2 F60": [20, 4, 10],
    "TRANS X100\nROT\nG1 X10 Y2 F60": [10, 2, 10],
    "R1=3 R2=R1*2\nTRANS X=R1+R2\nG1 X1 Y2 F60": [10, 2, 10],
    "ROT X90\nG0 X0 Y0 Z0\nG1 X1 Y2 Z3 F60": [1, -3, 2],
    "ROT Z90 X90\nG0 X0 Y0 Z0\nG1 X1 Y2 Z3 F60": [3, 1, 2],
}


@pytest.mark.parametrize("case", FRAMES)
def test_programmed_frames_move_what_follows(read, case: str) -> None:
    assert cuts(read(f"{HEAD}{case}\nM30\n"))[-1] == pytest.approx(FRAMES[case])


def test_a_mirror_turns_the_sense_of_arcs(read) -> None:
    cam = read(f"{HEAD}MIRROR X0\nG0 X0 Y0 Z0\nG2 X10 Y10 I10 J0 F600\nM30\n")
    assert ends(cam)[-1] == [-10, 10, 0] and cam.facts.arc_length_mm == pytest.approx(5 * math.pi)


SWIVELS = {
    'CYCLE800(1,"TC1",0,57,0,0,0,0,90,0,0,0,0,1,0,1)': ([3, 2, -1], [1, 0, 0]),
    'CYCLE800(0,"TC1",0,57,10,20,30,90,0,0,0,0,0,-1)': ([11, 17, 32], [0, -1, 0]),
    'CYCLE800(0,"TC1",0,27,0,0,0,90,0,90,0,0,0,-1)': ([3, 1, 2], [1, 0, 0]),
    'CYCLE800(0,"TC1",0,57,0,0,0,90,0,0,1,2,3,-1)': ([2, -6, 4], [0, -1, 0]),
}


@pytest.mark.parametrize("call", SWIVELS)
def test_swivelled_planes_turn_the_coordinates_and_the_tool(read, call: str) -> None:
    place, axis = SWIVELS[call]
    cam = read(f"{HEAD}{call}\nG0 X1 Y2\nZ3\nG1 X2 F600\nCYCLE800()\nG0 X0 Y0\nZ50\nM30\n")
    assert ends(cam)[1] == pytest.approx(place, abs=1e-9)
    assert cam.toolpath.axis[1] == pytest.approx(axis, abs=1e-12)
    assert ends(cam)[-1] == [0, 0, 50] and cam.toolpath.axis[-1].tolist() == [0, 0, 1]


def test_swivelling_by_rotary_axes_is_refused(read) -> None:
    with pytest.raises(InputError, match=r"part.mpf:6: CYCLE800 with mode 192"):
        read(f'{HEAD}CYCLE800(1,"TC1",0,192,0,0,0,30,0,0,0,0,0,-1)\nG1 X1 F9\n')


HOLE = [[5, 0, 2], [5, 0, -15], [5, 0, 20]]
CYCLES = {
    "CYCLE81(20,0,2,-15)": HOLE, "CYCLE81(20,0,2,,15)": HOLE, "CYCLE82(20,0,2,-15,0,0.5)": HOLE,
    "CYCLE83(20,0,2,-15,,-5,,2,0,0,1,1)": HOLE, "CYCLE85(20,0,2,-15,,0,300,600)": [HOLE[0], HOLE[1], HOLE[0], HOLE[2]],
    "CYCLE84(20,0,2,-15,,,3,,1.5,0,500,600)": [HOLE[0], HOLE[1], HOLE[0], HOLE[2]], "CYCLE86(20,0,2,-15)": HOLE,
}  # fmt: skip


@pytest.mark.parametrize("call", CYCLES)
def test_drilling_cycles_go_from_the_safety_distance_to_their_depth_and_back(read, call: str) -> None:
    assert ends(read(f"{HEAD}F120\nG0 X5 Y0\n{call}\nM30\n"))[2:] == CYCLES[call]


def test_z_without_tool_length_is_no_place_of_the_tip(read) -> None:
    cam = read(f"{HEAD}G1 Z-1 F9\nG0 Z300 D0\nX20 Y0\nZ5 D1\nM30\n")
    assert 300 not in [z for _, _, z in ends(cam)] and ends(cam)[-1] == [20, 0, 5]
    with pytest.raises(InputError, match="without tool length compensation"):
        read(f"{HEAD}G1 Z-1 F9 D0\nM30\n")


def test_tapping_cuts_with_its_pitch(read) -> None:
    cam = read(f"{HEAD}CYCLE84(20,0,2,-15,,,3,,1.5,0,500,600)\nM30\n")
    assert (cam.toolpath.feed[~cam.toolpath.rapid] * 1e3).tolist() == pytest.approx([12.5, 15])


def test_modal_calls_drill_every_place_until_they_end(read) -> None:
    cam = read(f"{HEAD}MCALL CYCLE81(20,0,2,-5)\nX10 Y10 F120\nX20\nMCALL\nX30\nM30\n")
    assert [point[:2] for point in cuts(cam) if point[2] == -5] == [[10, 10], [20, 10]]

    def holes(pattern: str) -> list[list[float]]:
        cam = read(f"{HEAD}F120\nMCALL CYCLE82(20,0,2,-5)\n{pattern}\nMCALL\nG0 X99\nM30\n")
        return [point[:2] for point in cuts(cam)]

    assert holes("HOLES1(10,20,90,5,10,3)") == [[10, 25], [10, 35], [10, 45]]
    assert holes("HOLES2(0,0,10,0,90,4)") == [[10, 0], [0, 10], [-10, 0], [0, -10]]
    assert holes("HOLES2(0,0,10,45,0,2)") == [[7.071068, 7.071068], [-7.071068, -7.071068]]


FLOWS = {
    "R1=0\nWHILE R1<3\nR1=R1+1\nG1 X=R1*10 F60\nENDWHILE": [10, 20, 30],
    "DEF INT I\nFOR I=1 TO 3\nG1 X=I*10 F60\nENDFOR": [10, 20, 30],
    "FOR R1=1 TO 2\nFOR R2=1 TO 2\nG1 X=R1*10+R2 F60\nENDFOR\nENDFOR": [11, 12, 21, 22],
    "R1=5\nIF R1==5\nG1 X10 F60\nELSE\nG1 X20 F60\nENDIF\nG1 X30": [10, 30],
    "R1=4\nIF R1==5\nG1 X10 F60\nELSE\nG1 X20 F60\nENDIF\nG1 X30": [20, 30],
    "IF 1>2 GOTOF ENDE\nG1 X10 F60\nGOTOF ENDE\nG1 X20\nENDE:\nG1 X30": [10, 30],
    "R1=0\nAGAIN: R1=R1+1\nG1 X=10*R1 F60\nIF R1<3 GOTOB AGAIN": [10, 20, 30],
    "G1 X10 F60\nGOTOF N200\nN100 X20\nN200 X30": [10, 30],
    "R1=0\nREPEAT\nR1=R1+10\nG1 X=R1 F60\nUNTIL R1>=30": [10, 20, 30],
    "R1=0\nLOOP\nR1=R1+10\nG1 X=R1 F60\nIF R1==30 GOTOF OUT\nENDLOOP\nOUT:": [10, 20, 30],
    "G91\nBEGIN:\nG1 X10 F60\nREPEAT BEGIN P=2\nG90": [10, 20, 30],
    "DEF REAL A=5, B\nB=A*SIN(30)+SQRT(9)*2-POT(2)\nG1 X=B F60\nX=A*(B-2)": [4.5, 12.5],
    "R1=10 R2=2\nG1 X=R1/R2 F60\nX=R1 DIV 3\nX=R1 MOD 4\nX=-R1+ABS(-3)": [5, 3, 2, -7],
    "DEF REAL P[3]\nP[1]=7\nG1 X=P[1] F=R9+60\nX=P[2]": None,
    "L10 P2\nM30\n%_N_L10_SPF\nG91\nG1 X10 F60\nG90\nM17": [10, 20],
    "SLOT(5,2)\nM30\n%_N_SLOT_SPF\nPROC SLOT(REAL LEN, INT N)\nG1 X=LEN*N F60\nRET": [10],
    "SLOT(,2)\nM30\n%_N_SLOT_SPF\nPROC SLOT(REAL LEN=4, INT N)\nG1 X=LEN*N F60\nRET": [8],
    "SLOT\nG1 X9\nM30\n%_N_SLOT_SPF\nPROC SLOT SAVE\nG91 G1 X5 F60\nTRANS X7\nRET": [5, 9],
}


@pytest.mark.parametrize("body", FLOWS)
def test_variables_loops_jumps_and_subprograms_carry_the_program_on(read, body: str) -> None:
    if FLOWS[body] is None:
        with pytest.raises(InputError, match="R\\[9\\] has no value that is known"):
            read(f"{HEAD}{body}\n")
        return
    text = body if "M30" in body else f"{body}\nM30"
    assert [point[0] for point in cuts(read(f"%_N_MAIN_MPF\n{HEAD}{text}\n"))] == pytest.approx(FLOWS[body])


def test_endless_loops_are_refused(read, monkeypatch) -> None:
    monkeypatch.setattr(flow, "MOST_LETTERS", 50_000)
    with pytest.raises(InputError, match=r"part.mpf:\d: more than 50000 letters of blocks"):
        read(f"{HEAD}A1:\nGOTOB A1\nM30\n")


def test_inches_and_feeds_by_the_turn_and_the_dwell(read) -> None:
    cam = read("G700 G90 G17\nS600 M3\nG0 X0 Y0 Z1\nG95 G1 X1 F0.01\nG94 X2 F60\nG4 F2.5\nG4 S30\nM30\n")
    assert ends(cam) == [[0, 0, 25.4], [25.4, 0, 25.4], [50.8, 0, 25.4]]
    assert (cam.toolpath.feed[1:] * 1e3).tolist() == pytest.approx([2.54, 25.4])
    assert [event.value for event in cam.toolpath.events if event.kind == "dwell"] == [2.5, 3.0]
    assert "OVR" in read("G71\nG0 X0 Y0 Z1\nOVR=50 G1 X1 F60\nM30\n").facts.notes[0]


REFUSED = [
    ("POCKET3(50,0,2,-5)", "POCKET3 is not read"), ("CYCLE72(\"A\",50)", "CYCLE72 is not read"), ("BSPLINE", "BSPLINE"),
    ("TRANSMIT", "TRANSMIT"), ("DIAM90", "DIAM90"), ("G33 Z-5 K1", "G33 (threading)"), ("G58 X5", "G58 (it changes"),
    ("SCALE X2", "different factors"),
    ("ROUTINE7(5)", "subprogram call ROUTINE7"), ("L100", "subprogram call L100"),
    ("UNKNOWN", "word UNKNOWN is not read"), ("G63 Z-9", "tapping"),
    ("G1 X=R5 F9", "R[5] has no value"), ("G1 X1 X2 F9", "word X stands twice"),
    ("G3 X5 Y5 F9", "arc has neither a centre"), ("G3 X5 Y5 AR=90", "word AR is not read"),
    ("G1 X1O F9", "is not read"), ("GOTOF NOWHERE", "does not stand after"), ("IF R1==1\nG1 X1", "is never closed"),
    ("G1 X5 A2=0 B2=1 C2=0 F9", "word A2 is not read"), ("$P_UIFR[1]=CTRANS(X,5)", "sets a frame"),
    ("EXTCALL \"A\"", "EXTCALL"), ("CASE R1 OF 1 GOTOF A", "CASE"),
    ("G1 X9 F9 RND=5\nG0 Y9", "no cutting move after"), ("G1 X9 F9 RNDM=5", "word RNDM"),
    ("G1 X9 F9 RND=2\nG3 X0 Y9 CR=9", "beside an arc, which is not read"), ("G147 X5 DISR=2", "changes the path"),
    ("CYCLE81(20,0,2)", "no depth"),
    ("HOLES2(0,0,9,0,0,4)", "no drilling cycle"), ("MCALL L5", "L5"), ("CYCLE81(20,0,2,5)", "above its reference"),
    ("G1 X5 B30 F9", "otary"), ("WHEN TRUE DO M8", "WHEN"),
    ("G1 X5 SUPA\nG1 X6 F9", "not known"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "sentence"), REFUSED, ids=[body.split("\n")[0] for body, _ in REFUSED])
def test_what_is_not_read_is_refused_with_its_line(read, body: str, sentence: str) -> None:
    with pytest.raises(InputError) as fault:
        read(f"{HEAD}{body}\nM30\n")
    assert sentence in str(fault.value) and "part.mpf:" in str(fault.value)


def test_a_second_work_offset_is_refused_with_what_this_control_can_state(read) -> None:
    with pytest.raises(InputError, match=r"state which one is the part frame .*wcs") as fault:
        read(f"{HEAD}G1 X5 F9\nG55 X5\nM30\n")
    assert "G10" not in fault.value.message


def test_the_text_says_the_language_whatever_the_ending(tmp_path: Path) -> None:
    assert read_cam_text(tmp_path, POST, ".nc").facts.kind == "sinumerik"
    everyday = "G90 G71\nMCALL\nG0 X0 Y0 Z5\nG1 Z0 F500\nG1 X20\nG3 X10 Y10 I=AC(10) J=AC(0)\n"
    assert read_cam_text(tmp_path, everyday, ".nc").facts.arc_length_mm == pytest.approx(5 * math.pi)


def test_an_archive_runs_its_main_program_with_the_subprograms_of_the_archive(read) -> None:
    text = "%_N_SUB_SPF\n;$PATH=/_N_SPF_DIR\nG1 X10 F60\nM17\n%_N_MAIN_MPF\n;$PATH=/_N_MPF_DIR\n" + HEAD + "SUB\nM30\n"
    assert cuts(read(text)) == [[10, 0, 10]]


def test_homes_that_only_the_machine_knows_and_traori_with_its_number_are_read(read) -> None:
    """NX posts retract to _Z_HOME, which the machine's builder defines; TRAORI(1) names the transformation."""
    home = "SUPA G0 Z=_Z_HOME D0\nSUPA G0 X=_X_HOME Y=_Y_HOME-10 D1\n"
    body = "G0 X10 Y5\nZ20\nTRAORI(1)\nG1 Z0 F300\nX20\nTRAFOOF\n"
    cam = read(f"{HEAD}{home}{body}G0 Z30\nSUPA G0 Z=_Z_HOME D0\nM30\n")
    assert ends(cam)[-4:] == [[10, 5, 20], [10, 5, 0], [20, 5, 0], [20, 5, 30]]
    with pytest.raises(InputError, match=r":6: A of a move in machine coordinates is not known; write its angle"):
        read(f"{HEAD}SUPA G0 A=_A_HOME\nM30\n")
    with pytest.raises(InputError, match=r":6: _Z_HOME has no value that is known"):
        read(f"{HEAD}G0 Z=_Z_HOME\nM30\n")


def test_a_compensated_contour_asks_what_the_file_holds(read) -> None:
    with pytest.raises(InputError, match=r":6: G42 compensates the radius of the cutter"):
        read(f"{HEAD}G1 G42 X10 F100\nM30\n")
    assert cuts(read(f"{HEAD}G1 G42 X10 F100\nG40\nM30\n", compensation="centre_line")) == [[10, 0, 10]]


def test_a_plain_block_is_read_as_any_other(read) -> None:
    """Blocks of X Y Z F alone are read the short way; with M8 they are not: both make the same path."""
    plain = "TRANS X5\nG1 Z-1 F300\nX10\nN5 X20 Y-5.5 F900\nZ.5 RND=0.2\nY7\nG91\nX1\nG90 X9\nG95\nX2 F.2"
    other = plain.replace("X10", "X10 M8").replace("F900", "F900 M8").replace("Y7", "Y7 M8").replace("X9", "X9 M8")
    one, two = (read(f"{HEAD}{body}\nG0 Z9\nM30\n") for body in (plain, other))
    assert ends(one) == ends(two) and one.toolpath.feed.tolist() == two.toolpath.feed.tolist()
