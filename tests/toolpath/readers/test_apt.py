from __future__ import annotations

import numpy as np
import pytest
from cam_files import ends

from compplan.errors import InputError

SUFFIX = ".apt"


def test_points_feeds_and_rapids_are_read(read) -> None:
    head = "PARTNO / K\xe4fer\nUNITS / MM\nFROM / 0, 0, 9\n"
    cam = read(head + "RAPID\nGOTO / 1, 2, 3\nFEDRAT / 60, MMPM\nGOTO / 4, 2, 3\nFINI\n")
    assert ends(cam) == [[1, 2, 3], [4, 2, 3]]
    assert cam.toolpath.rapid.tolist() == [True, False]
    assert cam.toolpath.feed[-1] == pytest.approx(1e-3)


def test_rapid_lasts_one_move(read) -> None:
    cam = read("UNITS/MM\nFEDRAT/60\nRAPID\nGOTO/0,0,0\nRAPID\nGOTO/1,0,0\nGOTO/2,0,0\nGOTO/3,0,0\n")
    assert cam.toolpath.rapid.tolist() == [True, True, False, False]


def test_the_tool_axis_stays_until_another_is_given(read) -> None:
    cam = read("UNITS/MM\nMULTAX/ON\nFEDRAT/60\nFROM/0,0,0,0,3,4\nGOTO/1,0,0\nGOTO/2,0,0,1,0,0\n")
    assert cam.toolpath.axis == pytest.approx(np.array([[0, 0.6, 0.8], [0, 0.6, 0.8], [1, 0, 0]]))


def test_godlta_with_one_number_goes_along_the_tool_axis(read) -> None:
    cam = read("UNITS/MM\nMULTAX/ON\nFEDRAT/60\nFROM/0,0,0,0,3,4\nGOTO/1,0,0\nGODLTA/10\n")
    assert ends(cam)[-1] == pytest.approx([1, 6, 8])


def test_continued_records_and_comments_are_joined(read) -> None:
    assert ends(read("UNITS/MM $$ metric\nFEDRAT/60\nFROM/0,0,0\nGOTO/ 1.0, $\n  2.0, 3.0\n$$ end\n"))[-1] == [1, 2, 3]


@pytest.mark.parametrize(
    ("feed", "expected"),
    [("FEDRAT/60,MMPM", 1.0), ("FEDRAT/MMPM,60", 1.0), ("FEDRAT/60", 1.0), ("FEDRAT/60,PERMIN", 1.0),
     ("FEDRAT/IPM,60", 25.4), ("FEDRAT/FPM,60", 304.8),
     ("SPINDL/600,CLW\nFEDRAT/0.1,MMPR", 1.0), ("SPINDL/600\nFEDRAT/0.1,IPR", 25.4),
     ("SPINDL/600\nFEDRAT/PERREV,0.1", 1.0)],
)  # fmt: skip
def test_feeds_in_every_unit(read, feed: str, expected: float) -> None:
    cam = read(f"UNITS/MM\n{feed}\nFROM/0,0,0\nGOTO/1,0,0\n")
    assert cam.toolpath.feed[-1] * 1e3 == pytest.approx(expected)


def test_inches_are_stated_or_follow_from_the_feed(read) -> None:
    assert ends(read("UNITS/INCHES\nFEDRAT/1\nFROM/0,0,0\nGOTO/1,0,0\n"))[-1] == [25.4, 0, 0]
    cam = read("FEDRAT/IPM,1\nFROM/0,0,0\nGOTO/1,0,0\n")
    assert ends(cam)[-1] == [25.4, 0, 0] and "inch is taken from it" in cam.facts.notes[0]


ARC = "UNITS/MM\nFEDRAT/60\nFROM/20,0,0\n{}\nGOTO/10,10,0\n"


@pytest.mark.parametrize(
    ("record", "quarter_turns"),
    [
        ("CIRCLE/10,0,0,0,0,1,10", 1),
        ("CIRCLE/10,0,0,0,0,-1,10", 3),
        ("CIRCLE/10,0,0,0,0,1,10,CLW", 3),
        ("CIRCLE/10,0,0,0,0,1,10,CLOCKWISE", 3),
        ("CIRCLE/10,0,0,0,0,1,10,CCLW", 1),
        ("CIRCLE/10,0,0,0,0,1,10,0.06,0.5,20,0", 3),
        ("CIRCLE/10,0,0,0,0,-1,10,0.06,0.5,20,0", 1),
        ("CIRCLE/10,0,0,0,0,-1,10,0.06,0.5,20,0,TIMES,2", 5),
        ("MOVARC/10,0,0,0,0,1,10,ANGLE,90", 1),
        ("MOVARC/ CENTER,10,0,0,AXIS,0,0,1,RADIUS,10", 1),
    ],
)
def test_arcs_turn_in_the_sense_of_their_dialect(read, record: str, quarter_turns: int) -> None:
    cam = read(ARC.format(record))
    assert cam.facts.arcs == 1
    assert cam.facts.cutting_length_mm == pytest.approx(quarter_turns * 5 * np.pi)


def test_arcs_that_would_all_turn_back_are_turned_round(read) -> None:
    lines, x = ["UNITS/MM", "FEDRAT/60", "FROM/0,0,0"], 0
    for _ in range(4):  # straight up, a half circle to the right, straight down, one to the left
        lines += [f"GOTO/{x},10,0", f"CIRCLE/{x + 1},10,0,0,0,1,1", f"GOTO/{x + 2},10,0", f"GOTO/{x + 2},0,0"]
        lines += [f"CIRCLE/{x + 3},0,0,0,0,-1,1", f"GOTO/{x + 4},0,0"]
        x += 4
    cam = read("\n".join(lines))
    assert cam.toolpath.position[:, 1].max() * 1e3 == pytest.approx(11)
    assert "arcs are read against the usual sense" in cam.facts.notes[-1]


def test_an_arc_about_a_tilted_axis_stays_in_its_plane(read) -> None:
    cam = read("UNITS/MM\nFEDRAT/60\nFROM/0,10,0,1,0,0\nCIRCLE/0,0,0,1,0,0,10\nGOTO/0,0,10\n")
    assert cam.facts.cutting_length_mm == pytest.approx(5 * np.pi)
    assert np.abs(cam.toolpath.position[:, 0]).max() < 1e-12
    assert cam.toolpath.axis[-1].tolist() == [1, 0, 0]


def test_arcs_with_a_start_direction(read) -> None:
    head = "UNITS/MM\nFEDRAT/60\nFROM/20,0,0\nINDIRV/0,-1,0\n"
    catia = "TLON,GOFWD/ (CIRCLE/ 10,0,0,$\n 10.0),ON,(LINE/ 10,0,0,$\n10,10,0)\n"
    assert read(head + catia).facts.cutting_length_mm == pytest.approx(15 * np.pi)


def test_holes_of_a_cycle_are_no_cutting_moves(read) -> None:
    holes = "CYCLE/DRILL,5\nGOTO/2,0,0\nGOTO/3,0,0\nCYCLE/OFF\n"
    text = f"UNITS/MM\nFEDRAT/60\nFROM/0,0,0\nGOTO/1,0,0\n{holes}GOTO/3,1,0\n"
    cam, cut = read(text, cycles="skip"), read(text)
    assert (cut.facts.cutting_moves, cut.facts.cycles, cut.facts.cutting_length_mm) == (2, 2, 2)
    assert cut.toolpath.cutting_length == pytest.approx(12e-3)  # two holes of 5 mm more
    assert (cam.facts.cutting_moves, cam.facts.cycles, cam.facts.cutting_length_mm) == (2, 2, 2)
    assert "drilling cycles are left out" in cam.facts.notes[-1]


def test_vendor_records_are_read_past_with_a_note(read) -> None:
    cam = read("UNITS/MM\nFEDRAT/60,MMPM\nWPLANE/XY\nFROM/0,0,0\nTLCOMP/ON\nGOTO/1,0,0\nCYCLE81/1\nGOHOME/Z\n")
    assert cam.facts.cutting_moves == 1
    assert [note.split(": ")[1][:13] for note in cam.facts.notes] == [
        "record WPLANE", "TLCOMP is lef", "record CYCLE8", "GOHOME is lef",
    ]  # fmt: skip
    assert cam.facts.notes[2].endswith("is not read: holes it drills are missing")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("UNITS/MM\nFROM/0,0,0\nNURBS/3,4", r":3: NURBS is not read"),
        ("L1 = LINE/0,0,1,1", r":1: part program statement"),
        ("UNITS/MM\nCOPY/1,TRANSL", r":2: COPY is not read"),
        ("UNITS/FEET", r":1: unit 'FEET', choose from MM, INCHES"),
        ("GOTO/1", r":1: 1 numbers, expected x, y, z"),
        ("GOTO/0,0,0,0,0,0", r":1: direction \[0.0, 0.0, 0.0\]: expected three"),
        (ARC.format("CIRCLE/10,0,0,0,0,1"[:-4]), r":4: arc record with 5 numbers|:4: arc record with"),
        (ARC.format("CIRCLE/11,0,0,0,0,1,10"), r":5: arc starts 9.0000 mm from its centre and ends 10.0499"),
        ("MODE/INCR", r":1: MODE/INCR"),
        ("CIRCLE/X,10,Y,10,I,-10,J,0", r":1: arc record .* is not read"),
        ("UNITS/MM\nMULTAX/ON\nFROM/0,0,0,0,.6,.8\nMULTAX/OFF", r":4: MULTAX/OFF with a tilted tool"),
    ],
)
def test_what_is_not_read_is_refused_with_its_line(read, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.apt({sentence})"):
        read(text)


def test_a_file_of_unknown_suffix_is_read_as_what_its_text_says(read) -> None:
    assert read("UNITS/MM\nFROM/0,0,0\nGOTO/1,0,0\n", ".txt").facts.kind == "apt"
    assert read("N1 G21 G0 X0 Y0 Z0\nN2 G1 X1 F9\n", ".txt").facts.kind == "gcode"


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        ("GOTO/1O,3,0", "field '1O' is neither a number nor a word"), ("GOTO/nan,1,2", "field 'NAN' is not a number"),
        ("GOTO/1,,2", "field .. is neither"),
        ("GOTO/1.2.3,0,0", "field '1.2.3'"), ("GOTO/P1", "field 'P1' is not a number"),
        ("FEDRAT/1O0,MMPM", "field '1O0'"), ("TRANS/10,0,0", "TRANS/10,0,0 turns or shifts the path"),
        ("ROTATE/TABLE,AAXIS,ABSANG,30", "ROTATE/TABLE"), ("MIRROR/X", "MIRROR"),
        ("CIRCLE/0,0,0,0,0,1,5,TIMES,1000000", r"arc of 1e\+06 turns"), ("GODLTA/1,2", "2 numbers"),
    ],
)  # fmt: skip
def test_numbers_are_read_whole_and_frames_are_not_skipped(read, record: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.apt:2: .*{sentence}"):
        read(f"UNITS/MM\n{record}\nFEDRAT/60\nGOTO/0,0,0\nGOTO/5,0,0\n")


def test_frames_that_change_nothing_are_read(read) -> None:
    still = "TRANS/0,0,0\nROTATE/TABLE,0.0\n"
    assert read(f"UNITS/MM\n{still}FEDRAT/60\nFROM/0,0,0\nGOTO/5,0,0,\n").facts.cutting_moves == 1


@pytest.mark.parametrize(
    "cycle",
    ["CYCLE/DRILL,DEPTH,10,MMPM,120,CLEAR,2", "CYCLE/DRILL,10,MMPM,120,2", "CYCLE/DRILL,RAPTO,2,FEDTO,-10,MMPM,120"],
)
def test_holes_are_cut_along_the_tool_axis_where_they_are_asked_for(read, cycle: str) -> None:
    text = f"UNITS/MM\nFEDRAT/60\nRAPID\nGOTO/0,0,50,0,0,1\n{cycle}\nGOTO/5,0,0\nGOTO/5,7,0,0,1,0\n"
    text += "CYCLE/OFF\nGOTO/0,0,50\n"
    cam = read(text, cycles="expand")
    cut = [point for point, rapid in zip(ends(cam), cam.toolpath.rapid, strict=True) if not rapid]
    assert cut == [[5, 0, -10], [5, -3, 0], [0, 0, 50]] and cam.facts.cycles == 2
    assert cam.toolpath.feed[~cam.toolpath.rapid][0] == pytest.approx(2e-3)
    assert [5, 0, 2] in ends(cam) and [5, 9, 0] in ends(cam)


def test_tapped_holes_are_left_with_the_feed_and_holes_without_depth_refused(read) -> None:
    head = "UNITS/MM\nFEDRAT/60\nRAPID\nGOTO/0,0,50\n"
    tapped = read(head + "CYCLE/TAP,DEPTH,10,CLEAR,2\nGOTO/5,0,0\n", cycles="expand")
    assert tapped.toolpath.cutting_length == pytest.approx(24e-3) and tapped.facts.cycles == 1
    again = read(f"{head}CYCLE/DRILL,DEPTH,10\nGOTO/5,0,0\nCYCLE/OFF\nGOTO/5,0,9\nCYCLE/ON\nGOTO/9,0,0\n")
    assert again.facts.cycles == 2 and ends(again)[-2:] == [[9, 0, -10], [9, 0, 0]]
    with pytest.raises(InputError, match=r":6: CYCLE/DRILL states no depth"):
        read(head + "CYCLE/DRILL,CLEAR,2\nGOTO/5,0,0\n", cycles="expand")


@pytest.mark.parametrize(
    ("cycle", "feed"),
    [
        ("CYCLE/DEEP,10,MMPM,120,1STPECK,5.", 2.0),
        ("CYCLE/DRILL,10.,120.,MMPM,2.", 2.0),
        ("CYCLE/BRKCHP,DEPTH,10,STEP,2,IPM,12,CLEAR,2,3DCUT", 5.08),
        ("CYCLE/DRILL,RAPTO,2,FEDTO,-10,RTRCTO,20,MMPM,120", 2.0),
        ("CYCLE/DEEP2,FEDTO,10.,1STPECK,5.,SUBPECK,2.,MMPM,120.,RAPTO,2.,RTRCTO,20.", 2.0),
    ],
)
def test_cycles_in_the_order_of_several_systems_end_at_their_depth(read, cycle: str, feed: float) -> None:
    cam = read(f"UNITS/MM\nRAPID\nGOTO/0,0,50\n{cycle}\nGOTO/5,0,0\nCYCLE/OFF\n", cycles="expand")
    cut = ~cam.toolpath.rapid
    assert ((cam.toolpath.position * 1e3)[cut].round(9).tolist(), cut.sum()) == ([[5, 0, -10]], 1)
    assert cam.toolpath.feed[cut][0] * 1e3 == pytest.approx(feed)
    assert cam.toolpath.cutting_length * 1e3 == pytest.approx(10 if "DEEP," in cycle else 12)


@pytest.mark.parametrize("word", ["1O", "1OO", "12OO", "5EE", "1.2.3", "1-", "9D"])
def test_a_number_with_letters_in_it_is_no_word(read, word: str) -> None:
    with pytest.raises(InputError, match=r"part.apt:2: "):
        read(f"UNITS/MM\nCYCLE/DEEP,{word},MMPM,100,1STPECK,5.\nGOTO/0,0,0\n", cycles="expand")
