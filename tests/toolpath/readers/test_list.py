"""What must be read or refused, never skipped, one small file a sentence: G-code, APT, KRL, RAPID."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.errors import InputError

HEAD = "G21 G0 X0 Y0 Z0\n"
TARGET = "[[{},{},0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def write_krl(body: str, data: str = "") -> str:
    return f"DEF part( )\n$VEL.CP=0.05\n{data}\nPTP {{X 0,Y 0,Z 0,A 0,B 180,C 0}}\n{body}\nLIN {{X 20}}\nEND\n"


def write_rapid(body: str) -> str:
    one = TARGET.format(10, 0)
    data = f'CONST robtarget p1:={one};\nPERS wobjdata w1:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
    start, end = TARGET.format(0, 0), TARGET.format(20, 0)
    head = f"MODULE part\n{data}\nPROC main()\nMoveJ {start},v50,fine,t;\n"
    return f"{head}{body}\nMoveL {end},v50,z1,t;\nENDPROC\nENDMODULE\n"


def write_apt(body: str) -> str:
    return f"UNITS/MM\nFEDRAT/60,MMPM\nFROM/0,0,0\n{body}\nGOTO/20,0,0\nFINI\n"


REFUSED = [
    (".nc", HEAD + "G1 X1O F9\n", "letter O stands in or beside a number"),
    (".nc", HEAD + "G1 XO F9\n", "word XO is not read and may move the tool"),
    (".nc", HEAD + "G1 Xnan F9\n", "word XNAN is not read and may move the tool"),
    (".nc", "G21 G54.1 P1 G0 X0 Y0 Z0\nG1 X1 F60\nG54.1 P2\nX2\n", "the file cuts in G54.1 P1 and in G54.1 P2"),
    (".mpf", HEAD + "TRAORI\nG58 X10\nG1 X1 F9\n", "G58 (it changes the path or its frame) is not read"),
    (".mpf", HEAD + "TRAORI\nG1 X1 A3=0 B3=0 F9\n", "expected three numbers"),
    (".mpf", HEAD + "TRAORI\nG1 X1 A2=0 B2=180 C2=0 F9\n", "word A2 is not read"),
    (".apt", write_apt("INDEX/1"), "INDEX is not read"),
    (".apt", write_apt("PLUNGE/5"), "PLUNGE is not read"),
    (".apt", write_apt("CYCLE/ "), "a cycle has no kind"),
    (".src", write_krl("LIN {X 5}:{X 1,Y 0,Z 0,A 0,B 0,C 0}"), "is not read, expected {X 1,Y 2,..} or a name"),
    (".src", write_krl("SLIN {X 5} WITH $BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}"), "for one move is not read"),
    (".src", write_krl("SLIN {X 5} WITH $VEL.CP=FAST"), "sets no speed in m/s"),
    (".src", write_krl("$BASE.X=100"), "a part of $BASE is set"),
    (".src", write_krl("ASYPTP {E1 100}"), "ASYPTP is not read and may move the tool"),
    (".src", write_krl("XP=XQ\nLIN XP", "XP={X 1,Y 0,Z 0,A 0,B 180,C 0}"), "position 'XP' has no known value"),
    (".src", write_krl("IF Q THEN\nXP={X 5}\nENDIF\nLIN XP", "XP={X 1}"), "position 'XP' has no known value"),
    (".mod", write_rapid("p1.trans.x:=5;"), "P1 changes on the way"),
    (".mod", write_rapid("p1:=Offs(p1,1,2,3);"), "P1 changes on the way"),
    (".mod", write_rapid("w1.uframe.trans.x:=100;"), "W1 changes on the way"),
    (".mod", write_rapid('%"Sub1"%;'), "is not read and may move the tool"),
    (".mod", write_rapid("VelSet nSpeed,100;"), "changes the speed and is not read"),
    (".mod", write_rapid("MoveL Offs(p1,1e300,0,0),v50,z1,t;"), "coordinate 1e+300 mm"),
    (".mod", write_rapid("MoveL RelTool(p1,0,0,5\\Rx:=3),v50,z1,t;"), "is not known in this module"),
]


@pytest.mark.parametrize(("suffix", "text", "sentence"), REFUSED, ids=[sentence[:30] for *_, sentence in REFUSED])
def test_what_may_change_the_path_is_refused(read, suffix: str, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as fault:
        read(text, suffix)
    assert sentence in str(fault.value) and f"part{suffix}:" in str(fault.value)


#: suffix, text, expected tips [mm] without the first, expected feeds [mm/s], words of a note or "".
READ = [
    (".nc", HEAD + "M104 S0\nG1 X1 E5 F60\n", [[1, 0, 0]], [1], ""),
    (".nc", HEAD + "G1 X1 F60 M77\n", [[1, 0, 0]], [1], "M77 is unknown"),
    (".apt", write_apt("INSERT/G1 X5"), [[20, 0, 0]], [1], "text for the control is not read"),
    (".src", write_krl("SLIN {X 5} WITH $VEL.CP=0.2"), [[5, 0, 0], [20, 0, 0]], [200, 50], ""),
    (".src", write_krl("SLIN {X 5} WITH $VEL={CP 0.1,ORI1 200}, $ACC={CP 1}"), [[5, 0, 0], [20, 0, 0]], [100, 50], ""),
    (".src", write_krl("LIN XP", "XP={X 1,Y 2,Z 3}\nXP.X=5"), [[5, 2, 3], [20, 2, 3]], [50, 50], ""),
    (".src", write_krl("LIN XP C_DIS", "XQ={X 1,Y 2}\nXP={X 9}\nXP=XQ"), [[1, 2, 0], [20, 2, 0]], [50, 50], ""),
    (".mod", write_rapid("VelSet 50,5000;"), [[20, 0, 0]], [25], ""),
    (".mod", write_rapid("VelSet 100,10;"), [[20, 0, 0]], [10], ""),
    (".mod", write_rapid(f"p1:={TARGET.format(3, 4)};\nMoveL p1,v50,z1,t;"), [[3, 4, 0], [20, 0, 0]], [50, 50], ""),
    (".mod", write_rapid("MoveL RelTool(p1,1,2,3),v50,z1,t;"), [[9, 2, -3], [20, 0, 0]], [50, 50], ""),
    (".mod", write_rapid(f"MoveLDO {TARGET.format(5, 0)},v50,z1,t,do1,1;"), [[5, 0, 0], [20, 0, 0]], [50, 50], ""),
]  # fmt: skip


@pytest.mark.parametrize(("suffix", "text", "tips", "feeds", "note"), READ)
def test_what_can_be_read_is_read(read, suffix: str, text: str, tips: list, feeds: list, note: str) -> None:
    cam = read(text, suffix)
    assert (cam.toolpath.position[1:] * 1e3).round(6).tolist() == tips
    assert (cam.toolpath.feed[1:] * 1e3).round(6).tolist() == feeds
    assert [note] == [note for said in cam.facts.notes if note in said] or (not note and not cam.facts.notes)


def test_the_tool_direction_of_siemens_is_read_and_turns_along_the_move(read) -> None:
    cam = read(HEAD + "TRAORI\nORIWKS\nG1 X0 A3=0 B3=0 C3=2 F9\nG1 X10 A3=1 B3=0 C3=1\nG0 X20 A3=0 B3=1 C3=0\n", ".mpf")
    half = np.abs(cam.toolpath.position[:, 0] - 0.005).argmin()
    middle = np.radians(45.0 * cam.toolpath.position[half, 0] / 0.01)
    assert cam.toolpath.axis[half] == pytest.approx([np.sin(middle), 0, np.cos(middle)])
    assert cam.toolpath.axis[-2] == pytest.approx([np.sqrt(0.5), 0, np.sqrt(0.5)])
    assert cam.toolpath.axis[-1].tolist() == [0, 1, 0] and cam.facts.cutting_moves == 1


def test_joint_moves_to_places_that_are_not_known_are_left_out_with_a_note(read) -> None:
    cam = read(write_krl("PTP XHOME\nPTP {X 5,Y 0,Z 0,A 0,B 180,C 0}"), ".src")
    assert any("joint move to XHOME is left out" in note for note in cam.facts.notes)
    assert cam.facts.cutting_length_mm == 15


def test_the_feed_of_a_drilling_cycle_ends_with_it(read) -> None:
    text = write_apt("CYCLE/DRILL,DEPTH,10,MMPM,30,CLEAR,3\nGOTO/5,5,0\nCYCLE/OFF\nRAPID\nGOTO/9,9,9")
    cam = read(text, ".apt", cycles="expand")
    assert cam.toolpath.feed[-1] == pytest.approx(1e-3) and 5e-4 in cam.toolpath.feed.round(9)
