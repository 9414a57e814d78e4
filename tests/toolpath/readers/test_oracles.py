"""The second readers of APT, Heidenhain, Sinumerik, KRL and RAPID, by hand and against the first readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.reading import read_toolpath
from tests.oracles.cam.cam import read_moves
from tests.oracles.cam.follow import Followed, find_difference
from tests.oracles.cam.moves import ARC, LINE, RAPID, CannotTellError, Reading

APT = "UNITS/MM\nFEDRAT/60,MMPM\nRAPID\nGOTO/20,0,0,0,0,1\n{}\nGOTO/10,10,0\n"
TNC = "BEGIN PGM P MM\nTOOL CALL 1 Z S3000\nL X+0 Y+0 Z+10 R0 FMAX M3\n{}\nL Z+50 R0 FMAX M30\nEND PGM P MM\n"
SIEMENS = "G17 G71 G90 G40 G54\nT1 M6\nS3000 M3\nG0 X0 Y0\nG0 Z10\n{}\nM30\n"
KRL = "DEF part( )\nBAS (#INITMOV,0)\n$VEL.CP=0.05\nPTP {{X 10,Y 0,Z 0,A 0,B 180,C 0}}\n{}\nEND\n"
OBJECT = 'PERS wobjdata w:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,5],[1,0,0,0]]];'
MODULE = f"MODULE part\n{OBJECT}\nPROC main()\n{{}}\nENDPROC\nENDMODULE\n"
BASES = "BASE_DATA[1]={X 100,Y 0,Z 0,A 0,B 0,C 0}\nBASE_DATA[2]={X 100,Y 50,Z 0,A 90,B 0,C 0}\n"
REST = ",[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def _read(folder: Path, text: str, ending: str, **options: object) -> Reading:
    file = folder / f"part{ending}"
    file.write_text(text)
    return read_moves(file, options)


def _target(x: float, y: float, z: float) -> str:
    return f"[[{x},{y},{z}],[0,0,1,0]{REST}"


#: Ending, text, and what its last moves are: kind, end [mm], feed [mm/s].
BY_HAND = {
    "an arc of APT, right-handed": (".apt", APT.format("CIRCLE/10,0,0,0,0,1,10"), [(ARC, (10, 10, 0), 1.0)]),
    "inches a minute": (".apt", "UNITS/INCHES\nFEDRAT/20,IPM\nRAPID\nGOTO/0,0,1\nGOTO/0,0,0\n",
                        [(RAPID, (0, 0, 25.4), 0.0), (LINE, (0, 0, 0), 20 * 25.4 / 60)]),
    "a hole of APT": (".apt", "UNITS/MM\nRAPID\nGOTO/0,0,50\nCYCLE/DRILL,DEPTH,10,MMPM,120,CLEAR,2\nGOTO/5,0,0,0,1,0\n",
                      [(RAPID, (5, 2, 0), 0.0), (LINE, (5, -10, 0), 2.0), (RAPID, (5, 2, 0), 0.0)]),
    "an arc of Heidenhain": (".h", TNC.format("L X+10 F600\nCC X+10 Y+10\nC X+20 Y+10 DR+"),
                             [(ARC, (20, 10, 10), 10.0), (RAPID, (20, 10, 50), 0.0)]),
    "a polar place": (".h", TNC.format("CC X+10 Y+10\nL X+20 Y+10 F600\nLP PR+10 PA+90"),
                      [(LINE, (10, 20, 10), 10.0), (RAPID, (10, 20, 50), 0.0)]),
    "a shifted and turned datum": (
        ".h", TNC.format("CYCL DEF 7.0\nCYCL DEF 7.1 X+50\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+180\nL X+10 Y+2 F60"),
        [(LINE, (40, -2, 10), 1.0), (RAPID, (40, -2, 50), 0.0)],
    ),
    "a chamfer of Heidenhain": (
        ".h", TNC.format("L X+20 F600\nCHF 4\nL Y+10"),
        [(LINE, (16, 0, 10), 10.0), (LINE, (20, 4, 10), 10.0), (LINE, (20, 10, 10), 10.0), (RAPID, (20, 10, 50), 0.0)],
    ),
    "a frame of Sinumerik": (".mpf", SIEMENS.format("TRANS X50\nAROT Z90\nG1 X10 Y2 F60"), [(LINE, (48, 10, 10), 1.0)]),
    "a helix of Sinumerik": (".mpf", SIEMENS.format("G1 X10 F600\nG3 X10 Y0 Z4 I0 J10 TURN=2"),
                             [(ARC, (10, 0, 4), 10.0)]),
    "a loop of Sinumerik": (".mpf", SIEMENS.format("FOR R1=1 TO 3\nG1 X=R1*10 F60\nENDFOR\nX=IC(5)"),
                            [(LINE, (20, 0, 10), 1.0), (LINE, (30, 0, 10), 1.0), (LINE, (35, 0, 10), 1.0)]),
    "a circle of KRL": (".src", KRL.format("CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0} C_DIS"), [(ARC, (-10, 0, 0), 50.0)]),
    "a base of KRL": (
        ".src", f"DEF p()\n$VEL.CP=0.1\n{BASES}"
        "$BASE=BASE_DATA[1]\nPTP {X 0,Y 0,Z 0,A 0,B 180,C 0}\nBAS(#BASE,2)\nLIN {X 10,Y 0,Z 0,A 0,B 180,C 0}\nEND\n",
        [(LINE, (0, 60, 0), 100.0)],
    ),
    "a work object of RAPID": (
        ".mod", MODULE.format(f"MoveJ {_target(0, 0, 50)},v100,z10,t;\n"
                              f"MoveL Offs({_target(10, 0, 50)},1,2,3),v50,fine,t\\WObj:=w;"),
        [(RAPID, (0, 0, 50), 0.0), (LINE, (111, 2, 58), 50.0)],
    ),
    "a turned user frame of RAPID, its object frame in it": (
        ".mod", MODULE.replace("[[100,0,0],[1,0,0,0]],[[0,0,5]", "[[100,0,0],[0,0,0,1]],[[20,0,5]")
        .format(f"MoveJ {_target(0, 0, 50)},v100,z10,t;\nMoveL {_target(10, 0, 50)},v50,fine,t\\WObj:=w;"),
        [(LINE, (70, 0, 55), 50.0)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BY_HAND)
def test_moves_are_those_worked_out_by_hand(name: str, tmp_path: Path) -> None:
    ending, text, expected = BY_HAND[name]
    found = _read(tmp_path, text, ending)
    for (kind, end, feed), k in zip(expected[::-1], range(len(found) - 1, -1, -1), strict=False):
        assert found.kind[k] == kind
        assert found.end[k] * 1e3 == pytest.approx(np.array(end), abs=1e-9)
        assert found.feed[k] * 1e3 == pytest.approx(feed)


def test_work_offsets_that_the_file_states_count_from_the_first_one(tmp_path: Path) -> None:
    text = "G21 G90\nG10 L2 P1 X10 Y0 Z0\nG10 L2 P2 X100 Y5 Z50\nG54 G0 X0 Y0 Z0\nG1 X10 F60\nG55 X10 Z-50\n"
    assert _read(tmp_path, text, ".nc").end[-1] * 1e3 == pytest.approx([100, 0, 0])  # Y stands still
    with pytest.raises(CannotTellError, match="line 6: more than one work offset"):
        _read(tmp_path, text.replace("G10 L2 P1 X10 Y0 Z0", "G1 F60"), ".nc")


TURNED = {
    "head, C carries B": ({"rotary": "head"}, (0.5, 0.5, 0.5**0.5)),
    "head, B carries C": ({"rotary": "head", "rotary_axes": ["B", "C"]}, (0.5**0.5, 0.0, 0.5**0.5)),
    "table, B carries C": ({"rotary": "table"}, (-0.5, 0.5, 0.5**0.5)),
}


@pytest.mark.parametrize("name", TURNED)
def test_rotary_words_turn_the_tool_axis_as_the_machine_does(name: str, tmp_path: Path) -> None:
    options, axis = TURNED[name]
    text = "G21 G90\nG43.4 G0 X0 Y0 Z9 B0 C0\nG1 Z0 B45 C45 F60\n"
    assert _read(tmp_path, text, ".nc", **options).axis[-1] == pytest.approx(np.array(axis))


UNKNOWN = {
    ".apt": "UNITS/MM\nGOTO/0,0,0\nCOPY/1,TRANSL\n", ".h": TNC.format("L X+1 F60\nCYCL DEF 254 ROUND SLOT ~\nQ200=2"),
    ".mpf": SIEMENS.format("G1 X1 F60\nPOCKET3(50,0,2,-5)"), ".src": KRL.format("LIN_REL {Z 5}"),
    ".mod": MODULE.format("PDispOn p1,p2,t;"), ".nc": "G0 X0 Y0 Z0\nG41 D1\nG1 X5 F9\n",
}  # fmt: skip


@pytest.mark.parametrize("ending", UNKNOWN)
def test_what_is_not_known_is_said_with_its_line(ending: str, tmp_path: Path) -> None:
    with pytest.raises(CannotTellError, match=r"line \d+: "):
        _read(tmp_path, UNKNOWN[ending], ending)


@pytest.mark.parametrize("name", BY_HAND)
def test_both_readers_go_the_same_way(name: str, tmp_path: Path) -> None:
    ending, text, _ = BY_HAND[name]
    file = tmp_path / f"part{ending}"
    file.write_text(text)
    robots = {"tool_direction": "z"} if ending in (".src", ".mod") else {}
    path = read_toolpath(file, cam=CamTable.model_validate(robots))
    followed = Followed(path.position, path.axis, path.rapid, path.feed, chord=1.2e-6)
    assert find_difference(followed, read_moves(file, robots)) == ""
