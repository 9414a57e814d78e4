"""What CAM files switch beside motion, in its order and at its place; worked out by hand from each text."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.toolpath.events import Event, find_halts, move_events
from compplan.toolpath.readers import CamFile
from compplan.toolpath.toolpath import Toolpath, divide_toolpath, resample_toolpath

KRL = "DEF part( )\n$VEL.CP=0.05\nPTP {X 0,Y 0,Z 0,A 0,B 180,C 0}\n%s\nLIN {X 10}\nEND\n"
TARGET = "[[{},0,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
RAPID = (
    f"MODULE part\nPROC main()\nMoveJ {TARGET.format(0)},v50,fine,t;\n%s\n"
    f"MoveL {TARGET.format(10)},v50,z1,t;\nENDPROC\nENDMODULE\n"
)
APT = "UNITS/MM\nFEDRAT/60,MMPM\nFROM/0,0,0\n%s\nGOTO/10,0,0\nFINI\n"
NC = "G21 G0 X0 Y0 Z0\n%s\nG1 X10 F60\n"


def list_events(cam: CamFile, *, comments: bool = False) -> list[tuple[object, ...]]:
    """Events as (place, kind, value, text), zeros and empty texts at the end left out."""
    events = []
    for event in cam.toolpath.events:
        row: list[object] = [event.place, event.kind, event.value, event.text]
        while row[-1] in (0.0, "") and len(row) > 2:
            row.pop()
        if comments or event.kind != "comment":
            events.append(tuple(row))
    return events


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("M3 S1200", [(0, "spindle_cw", 1200), (1, "spindle_off")]),
        ("S800\nM4", [(0, "spindle_ccw", 800), (1, "spindle_off")]),
        ("M3 S1200\nS1500", [(0, "spindle_cw", 1200), (0, "spindle_cw", 1500), (1, "spindle_off")]),
        ("M1=3 S1=1200", [(0, "spindle_cw", 1200), (1, "spindle_off")]),
        ("G1 X5 F60 M3 S100 M8", [(0, "spindle_cw", 100), (0, "coolant"), (2, "spindle_off"), (2, "coolant_off")]),
        ("M3 S100\nG1 X5 F60 M5 M9\nM3", [(0, "spindle_cw", 100), (1, "spindle_off"), (1, "coolant_off"),
                                       (1, "spindle_cw", 100), (2, "spindle_off")]),
        ("M13 S100", [(0, "spindle_cw", 100), (0, "coolant"), (1, "spindle_off"), (1, "coolant_off")]),
        ("M7\nM9", [(0, "mist"), (0, "coolant_off")]),
        ("T2\nM6", [(0, "tool", 2)]), ("T5 M06", [(0, "tool", 5)]),
        ('T="MILL D10" M6', [(0, "tool", 0, "MILL D10")]),
        ("M0", [(0, "stop")]), ("G1 X5 F60 M01", [(1, "optional_stop")]),
        ("G4 P0.5", [(0, "dwell", 0.5)]), ("G4 P1500", [(0, "dwell", 1.5)]), ("G04 X2.", [(0, "dwell", 2)]),
        ("M104 S200\nG4 S2 P20", [(0, "dwell", 2.02)]),  # a printer
        ("F60\nG4 F2", [(0, "dwell", 2)]),
        ("M3 S120\nG4 S10", [(0, "spindle_cw", 120), (0, "dwell", 5), (1, "spindle_off")]),
        ("G50 S2000", []), ("M10", []),
    ],
)  # fmt: skip
def test_g_code_switches_before_or_after_the_move_of_its_block(read, lines: str, expected: list) -> None:
    assert list_events(read(NC % lines, ".nc")) == expected


def test_a_dwell_leaves_the_feed_alone(read) -> None:
    cam = read("G21 G0 X0 Y0 Z0\nG1 X5 F60\nG4 F2\nX10\n", ".nc")
    assert cam.toolpath.feed.tolist() == [0, 1e-3, 1e-3]


def test_comments_stand_where_the_file_has_them(read) -> None:
    cam = read('(part; 7)\nG21 G0 X0 Y0 Z0 ; above\nG1 X1 F9 (cut)\nMSG("half")\nCYCLE832(0.1)\nX2 (end\n', ".mpf")
    texts = [(0 if e.place < 0 else e.place, e.text) for e in cam.toolpath.events]
    assert texts == [(0, "part; 7"), (0, "above"), (0, "cut"), (1, "half"), (1, "end")]
    assert cam.toolpath.events[0].place == -1 and cam.facts.events == 0


def test_events_after_an_arc_stand_at_its_end(read) -> None:
    cam = read("G21 G0 X0 Y0 Z0\nM3 S9\nG2 X10 R5 F60\nM8\nG1 X20\n", ".nc")
    (coolant,) = [event for event in cam.toolpath.events if event.kind == "coolant"]
    assert cam.toolpath.position[coolant.place] == pytest.approx([0.01, 0, 0])


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("SPINDL/1200,CLW", [(0, "spindle_cw", 1200), (1, "spindle_off")]),
        ("SPINDL/RPM,800,CCLW", [(0, "spindle_ccw", 800), (1, "spindle_off")]),
        ("SPINDL/ON", [(0, "spindle_cw"), (1, "spindle_off")]), ("SPINDL/OFF", [(0, "spindle_off")]),
        ("COOLNT/FLOOD\nCOOLNT/OFF", [(0, "coolant"), (0, "coolant_off")]), ("COOLNT/MIST", [(0, "mist"),
                                                                                           (1, "coolant_off")]),
        ("LOADTL/3", [(0, "tool", 3)]), ("LOAD/TOOL,4", [(0, "tool", 4)]), ("DELAY/1.5", [(0, "dwell", 1.5)]),
        ("STOP", [(0, "stop")]), ("OPSTOP", [(0, "optional_stop")]),
        ("AUXFUN/3", [(0, "spindle_cw"), (1, "spindle_off")]), ("AUXFUN/9", [(0, "coolant_off")]),
    ],
)  # fmt: skip
def test_apt_switches_between_its_moves(read, lines: str, expected: list) -> None:
    origin = [(place - 1, *rest) if place == 0 else (place, *rest) for place, *rest in expected]
    assert list_events(read(APT % lines, ".apt")) == origin  # FROM is not a move: 0 is what is before the first one


def test_apt_text_is_kept_as_comments(read) -> None:
    cam = read(APT % "PPRINT/ROUGHING\n$$ a remark\nPARTNO 7", ".apt")
    assert [event.text for event in cam.toolpath.events] == ["ROUGHING", "a remark", "PARTNO 7"]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("$OUT[3]=TRUE", [(0, "output", 1, "$OUT[3]")]), ("$OUT[12] = FALSE", [(0, "output", 0.0, "$OUT[12]")]),
        ("WAIT SEC 2.5", [(0, "dwell", 2.5)]), ("HALT", [(0, "stop")]),
        ("WAIT FOR $IN[3]", [(0, "call", 0, "WAIT FOR $IN[3]")]),
        ("SPINDLE_ON(3000)", [(0, "call", 0, "SPINDLE_ON(3000)")]),
        ("IF X THEN\n$OUT[1]=TRUE\nENDIF", [(0, "call", 0, "in a loop or a branch: $OUT[1]=TRUE")]),
        ("TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
         [(0, "call", 0, "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE")]),
    ],
)  # fmt: skip
def test_krl_signals_waits_and_calls_are_kept(read, lines: str, expected: list) -> None:
    assert list_events(read(KRL % lines, ".src")) == expected


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("SetDO doMill,1;", [(0, "output", 1, "DOMILL")]), ("Set doMill;", [(0, "output", 1, "DOMILL")]),
        ("Reset doMill;", [(0, "output", 0.0, "DOMILL")]), ("WaitTime 2;", [(0, "dwell", 2)]),
        ("WaitTime\\InPos,2;", [(0, "dwell", 2)]), ("Stop;", [(0, "stop")]),
        ("WaitDI di1,1;", [(0, "call", 0, "WAITDI DI1,1")]), ("SpindleOn 3000;", [(0, "call", 0, "SPINDLEON 3000")]),
        (f"MoveLDO {TARGET.format(5)},v50,z1,t,do1,1;", [(1, "output", 1, "DO1")]),
        ("IF a=1 SetDO do1,1;", [(0, "call", 0, "IF A=1 SETDO DO1,1")]),
    ],
)  # fmt: skip
def test_rapid_signals_waits_and_calls_are_kept(read, lines: str, expected: list) -> None:
    assert list_events(read(RAPID % lines, ".mod")) == expected


def test_robot_programs_keep_their_comments_but_for_folds(read) -> None:
    krl = read(KRL % ";FOLD LIN P1;%{PE}\n; rough\n;ENDFOLD", ".src")
    assert [event.text for event in krl.toolpath.events] == ["rough"]
    assert [event.text for event in read(RAPID % "! rough", ".mod").toolpath.events] == ["rough"]


def test_a_cut_with_a_stopped_spindle_gets_a_program_stop(read) -> None:
    cam = read("G21 G0 X0 Y0 Z0\nM3 S900\nG1 X1 F60\nM5\nG0 Z9\nG0 Z0\nX3\nG1 X5\nX6\n", ".nc")
    stops = [event for event in cam.toolpath.events if event.kind == "stop"]
    assert [(stop.place, stop.text) for stop in stops] == [
        (4, "the file cuts from here with the spindle stopped: start it")
    ]
    assert any("the file cuts with a spindle that it has stopped, 1 times" in note for note in cam.facts.notes)
    changed = read("G21 G0 X0 Y0 Z0\nT1 M6\nM3 S900\nG1 X1 F60\nT2 M6\nG1 X5\n", ".nc")
    assert [(e.place, e.kind) for e in changed.toolpath.events if e.kind in ("tool", "stop")] == [
        (0, "tool"), (1, "tool"), (1, "stop"),
    ]  # fmt: skip
    assert not any(e.kind == "stop" for e in read(NC % "", ".nc").toolpath.events)  # a file that turns no spindle


def make_path(events: tuple[Event, ...]) -> Toolpath:
    position = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]])
    return Toolpath(position, np.tile([0.0, 0, 1], (3, 1)), np.full(3, 0.01), np.zeros(3, bool), events=events)


def test_events_stay_at_their_waypoints_when_moves_are_divided() -> None:
    events = (Event(-1, "spindle_cw", 9.0), Event(1, "dwell", 1.0), Event(2, "spindle_off"))
    path = resample_toolpath(make_path(events), 0.0025)
    assert [event.place for event in path.events] == [-1, 4, 8] and find_halts(path.events) == [4, 8]
    places = np.array([0, 0.5, 1, 1, 1, 1.5, 2])
    assert [event.place for event in divide_toolpath(make_path(events), places).events] == [-1, 2, 6]


def test_what_ends_waits_until_its_place_is_left_and_the_order_stays() -> None:
    places = np.array([0.0, 1, 1, 1, 2])
    kinds = ("spindle_cw", "spindle_off", "spindle_cw")
    moved = move_events([Event(1, kind) for kind in kinds], places)
    assert [event.place for event in moved] == [1, 3, 3]


def test_events_are_bounded(read) -> None:
    cam = read(NC % "\n".join(["(text)"] * 3000), ".nc")
    assert len(cam.toolpath.events) == 2000 and "comments after the first 2000 are not kept" in cam.facts.notes[0]
    assert read(NC % "\n".join(["M0"] * 20_001), ".nc").facts.events == 20_001
