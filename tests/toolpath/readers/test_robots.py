"""KRL and RAPID programs as toolpaths; every figure follows by hand from the program's text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cam_files import ends, read_cam_text

from compplan.errors import InputError
from compplan.toolpath.readers.krl import read_pose
from compplan.toolpath.toolpath import check_toolpath

KRL = "&ACCESS RVP\n&REL 1\nDEF part( )\n;FOLD INI\nINTERRUPT ON 3\nBAS (#INITMOV,0)\n;ENDFOLD\n{}\nEND\n"
DOWN = "A 0,B 180,C 0"  # z of the TCP frame points down: the tool axis is 0 0 1
RAPID = "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\nMODULE part\n{}\nPROC main()\n{}\nENDPROC\nENDMODULE\n"
REST = ",[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


@pytest.fixture
def krl(read):
    return lambda body, **options: read(KRL.format(body), ".src", **options)


@pytest.fixture
def rapid(read):
    return lambda data, body, **options: read(RAPID.format(data, body), ".mod", **options)


def target(x: float, y: float, z: float, turn: str = "0,0,1,0") -> str:
    return f"[[{x},{y},{z}],[{turn}]{REST}"


def test_krl_moves_are_read_with_their_speed(krl) -> None:
    cam = krl(
        f"$VEL.CP=0.05\n$VEL.ORI1=200\nPTP {{E6POS: X 0,Y 0,Z 50,{DOWN},S 2,T 3,E1 0.0}} C_PTP\n"
        f"LIN {{X 0,Y 0,Z 0,{DOWN}}} C_DIS ; down\n"
        "$VEL = {CP 0.1,ORI1 200}\nLIN {X 30.0,Y 40.0}\nBAS(#VEL_CP,0.2)\nlin {y 41,z 1E+1}\n"
    )
    assert ends(cam) == [[0, 0, 50], [0, 0, 0], [30, 40, 0], [30, 41, 10]]
    assert cam.toolpath.feed.tolist() == pytest.approx([0, 0.05, 0.1, 0.2])
    assert cam.toolpath.rapid.tolist() == [True, False, False, False]
    assert cam.toolpath.axis == pytest.approx(np.tile([0, 0, 1], (4, 1)), abs=1e-12)
    assert (cam.facts.kind, cam.facts.cutting_moves, cam.facts.notes) == ("krl", 3, ())


def test_krl_speed_for_one_move_holds_for_that_move(krl) -> None:
    start = f"$VEL.CP=0.05\nPTP {{X 0,Y 0,Z 0,{DOWN}}}\n"
    moves = "SLIN {X 5} WITH $VEL={CP 0.2}\nSLIN {X 9} WITH $VEL.CP=0.3\nSLIN {X 12}\n"
    assert krl(start + moves).toolpath.feed.tolist() == pytest.approx([0, 0.2, 0.3, 0.05])
    assert any("$OV_PRO" in note for note in krl(f"$OV_PRO=50\n{start}{moves}").facts.notes)


def test_krl_orientation_is_z_y_x_and_the_tool_points_where_it_is_told(krl) -> None:
    body = "$VEL.CP=0.05\nPTP {X 0,Y 0,Z 0,A 90,B 30,C 0}\nLIN {X 10}\n"
    # Rz(90) Ry(30): x goes to (0, cos 30, -sin 30), z to (0, sin 30, cos 30)
    assert krl(body).toolpath.axis[-1] == pytest.approx([0, -0.5, -np.sqrt(0.75)])
    assert krl(body, tool_direction="x").toolpath.axis[-1] == pytest.approx([0, -np.sqrt(0.75), 0.5])
    assert "is taken to point out of the tool" in krl(body, tool_direction=None).facts.notes[0]


def test_krl_circles_go_through_their_middle(krl) -> None:
    start = f"$VEL.CP=0.05\nPTP {{X 10,Y 0,Z 0,{DOWN}}}\n"
    cam = krl(start + "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0} C_DIS\n")
    assert cam.facts.arcs == 1 and cam.facts.cutting_length_mm == pytest.approx(10 * np.pi)
    assert cam.toolpath.position[:, 1].max() == pytest.approx(0.01) and ends(cam)[-1] == [-10, 0, 0]
    short = krl(start + "CIRC {X 7.0710678,Y -7.0710678},{X 0,Y -10}\n")
    assert short.facts.cutting_length_mm == pytest.approx(5 * np.pi, rel=1e-6)
    full = krl(start + "CIRC {X 0,Y 10,Z 0},{X -10,Y 0,Z 0},CA 360\n")
    assert full.facts.cutting_length_mm == pytest.approx(20 * np.pi) and ends(full)[-1] == pytest.approx([10, 0, 0])
    with pytest.raises(InputError, match=r"part.src:10: start, middle and end of a circle lie on a line"):
        krl(start + "CIRC {X 20,Y 0,Z 0},{X 30,Y 0,Z 0}\n")


def test_krl_turning_arcs_are_one_move_that_turns_evenly(krl) -> None:
    cam = krl(f"$VEL.CP=0.05\nPTP {{X 10,Y 0,Z 0,{DOWN}}}\nCIRC {{X 0,Y 10,Z 0}},{{X -10,Y 0,Z 0,A 0,B 120,C 0}}\n")
    assert (cam.facts.cutting_moves, cam.facts.arcs) == (1, 1)
    assert cam.facts.cutting_length_mm == pytest.approx(10 * np.pi)
    halfway = np.abs(cam.toolpath.position[:, 0]).argmin()
    assert cam.toolpath.axis[halfway] == pytest.approx([-0.5, 0, np.sqrt(0.75)], abs=0.02)
    assert cam.toolpath.axis[-1] == pytest.approx([-np.sqrt(0.75), 0, 0.5])


def test_krl_positions_and_bases_come_from_the_data_beside_and_subprograms_are_followed(krl, tmp_path: Path) -> None:
    (tmp_path / "part.dat").write_text(
        f"DEFDAT part\nDECL E6POS XP1={{X 1.0,Y 2.0,Z 3.0,{DOWN},S 2,T 10,E1 0.0}}\nENDDAT\n"
    )
    (tmp_path / "cut.src").write_text("DEF cut()\nLIN {X 9}\nEND\n")
    cam = krl("$VEL.CP=0.05\nPTP XP1\ncut()\nother()\nLIN XP1 C_DIS\n")
    assert ends(cam) == [[1, 2, 3], [9, 2, 3], [1, 2, 3]]
    assert [note.split(": ", 1)[1] for note in cam.facts.notes] == [
        "call of OTHER() is not read: it is neither here nor beside the file"
    ]


def test_krl_inline_forms_set_speed_and_base(krl) -> None:
    data = "FP1={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}}\nFP2={{TOOL_NO 1,BASE_NO {},IPO_FRAME #BASE}}\n"
    start = f"FDAT_ACT=FP1\nPTP {{X 0,Y 0,Z 0,{DOWN}}}\nBAS(#CP_PARAMS,0.5)\nLIN {{X 5}}\n"
    form = "FDAT_ACT=FP2\nBAS(#CP_PARAMS,0.25)\nLIN {X 9}\n"
    assert krl(data.format(1) + start + form).toolpath.feed.tolist() == [0, 0.5, 0.25]
    with pytest.raises(InputError, match=r"base changes from BASE_DATA\[1\] to BASE_DATA\[2\]"):
        krl(data.format(2) + start + form)


def test_krl_loops_over_points_of_a_public_data_file_are_carried_out(krl, tmp_path: Path) -> None:
    """Long paths stand in data files beside the program, and a loop goes through them; the wrist is set on the way."""
    points = "\n".join(f"gfPoint[{i} ]={{X {10 * i},Y 0.0,Z 0.0,A 0.0,B 180.0,C 0.0}}" for i in range(1, 5))
    (tmp_path / "points.dat").write_text(f"DEFDAT points PUBLIC\nDECL GLOBAL FRAME gfPoint[4]\n{points}\nENDDAT\n")
    (tmp_path / "others.dat").write_text("DEFDAT others PUBLIC\nDECL GLOBAL FRAME gfOther[1]\nENDDAT\n")
    loop = "INT i, j\nFOR i = 1 TO 4 STEP 1\ngfPoint[i].Z = -2\nLIN gfPoint[i] C_DIS\nENDFOR\n"
    loop += "FOR j=4 TO 1 STEP -3\nLIN gfPoint[j]\nENDFOR"
    cam = krl(f"$VEL.CP=0.05\nPTP {{X 0,Y 0,Z 0,{DOWN}}}\n{loop}\n")
    assert ends(cam) == [[0, 0, 0], [10, 0, -2], [20, 0, -2], [30, 0, -2], [40, 0, -2], [10, 0, -2]]
    assert cam.facts.notes == ("line 1: positions of other files are read: points.dat",)
    (tmp_path / "again.dat").write_text("DEFDAT again PUBLIC\nDECL GLOBAL FRAME gfPoint[4]\nENDDAT\n")
    with pytest.raises(InputError, match=r"GFPOINT stands in again.dat and in points.dat, both public"):
        krl(f"PTP {{X 0,Y 0,Z 0,{DOWN}}}\n{loop}\n")


def test_krl_bases_that_change_are_followed_where_they_are_known(krl) -> None:
    frames = "BASE_DATA[1]={X 100,Y 0,Z 0,A 0,B 0,C 0}\nBASE_DATA[2]={FRAME: X 100,Y 50,Z 0,A 90,B 0,C 0}\n"
    body = f"$VEL.CP=0.05\n$BASE=BASE_DATA[1]\nPTP {{X 0,Y 0,Z 0,{DOWN}}}\nBAS(#BASE,2)\nLIN {{X 10,Y 0,Z 0,{DOWN}}}\n"
    assert ends(krl(frames + body))[-1] == [0, 60, 0]
    with pytest.raises(InputError, match=r"part.src:11: base changes from BASE_DATA\[1\] to BASE_DATA\[2\], and their"):
        krl(body)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("LIN_REL {X 5}", "LIN_REL"), ("FOR I=1 TO N\nLIN {X 5}\nENDFOR", "stands in a loop or a branch"),
        ("FOR I=1 TO 3\nEXIT\nENDFOR", "the loop ends at 'EXIT'"),
        ("FOR I=1 TO 3\nI=2\nENDFOR", "the loop ends at 'I=2'"),
        ("FOR I=1 TO 3\nLIN {X 5}", "FOR has no ENDFOR"), ("FOR I=1 TO 3 STEP 0\nENDFOR", "never ends"),
        ("LIN PT[I]", r"position 'PT\[I\]' has no known value"), ("LIN {X 5+A}", "position 'X 5"),
        ("LIN {X 1O}", "position 'X 1O'"),
        ("LIN {X 1,X 2}", "each once"), ("GOTO M1", "GOTO is not read"), ("$IPO_MODE=#TCP", "in the robot's hand"),
        ("SPLINE\nSPL {X 5}\nENDSPLINE", "SPLINE is not read"), ("LIN {X 1E30}", "position 'X 1E30' is not read"),
        ("CIRC {X 0,Y 10}", "circle has no end"), ("PTP {A1 0,A2 0}\nCIRC {X 0,Y 10},{X -10}", "not known"),
    ],
)  # fmt: skip
def test_krl_that_cannot_be_followed_is_refused(krl, line: str, sentence: str) -> None:
    with pytest.raises(InputError, match=f"part.src:1[01]: .*{sentence}"):
        krl(f"$VEL.CP=0.05\nPTP {{X 10,Y 0,Z 0,{DOWN}}}\n{line}\nLIN {{X 20,Y 0,Z 0}}\n")


def test_rapid_moves_are_read_with_their_speed(rapid) -> None:
    data = f"CONST robtarget p10:={target(0, 0, 50)};\nPERS speeddata vCut:=[25,500,5000,1000];\nPERS num n:=0;"
    cam = rapid(
        data,
        f"ConfL\\Off;\nMoveJ p10,v1000,z10,tMill\\WObj:=wPart;\n"
        f"MoveL {target(0, 0, 0)},v50,z1,tMill\\WObj:=wPart; ! in\n"
        f'TPWrite "MoveL; !";\nMoveL Offs(p10,30,40,\n-50),vCut,fine,tMill\\WObj:=wPart;\n'
        f"MoveL {target(30, 41, 0)},v50\\V:=10,z0,tMill\\WObj:=wPart;SetDO a,1;\n",
    )
    assert ends(cam) == [[0, 0, 50], [0, 0, 0], [30, 40, 0], [30, 41, 0]]
    assert cam.toolpath.feed.tolist() == pytest.approx([0, 0.05, 0.025, 0.01])
    assert cam.toolpath.axis[-1] == pytest.approx([0, 0, 1], abs=1e-12)
    assert (cam.facts.kind, cam.facts.cutting_moves, cam.facts.notes) == ("rapid", 3, ())


def test_rapid_quaternions_begin_with_their_scalar(rapid) -> None:
    turned = f"0,{np.cos(np.radians(15)):.9f},0,{np.sin(np.radians(15)):.9f}"  # z goes to (sin 30, 0, -cos 30)
    cam = rapid("", f"MoveJ {target(0, 0, 0, turned)},v50,fine,t;\nMoveL {target(9, 0, 0, turned)},v50,fine,t;\n")
    assert cam.toolpath.axis[-1] == pytest.approx([-0.5, 0, np.sqrt(0.75)])


def test_rapid_circles_and_procedures_are_followed(rapid) -> None:
    data = f"PROC Path_10()\nMoveC {target(0, 10, 0)},{target(-10, 0, 0)},v20,z1,t;\nENDPROC"
    cam = rapid(data, f"MoveJ {target(10, 0, 0)},v50,fine,t;\nPath_10;\n")
    assert cam.facts.arcs == 1 and cam.facts.cutting_length_mm == pytest.approx(10 * np.pi)
    assert cam.toolpath.position[:, 1].max() == pytest.approx(0.01)


def test_rapid_work_objects_that_change_are_followed_where_they_are_known(rapid) -> None:
    objects = (
        'PERS wobjdata w1:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
        'PERS wobjdata w2:=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,50,0],[0.707106781,0,0,0.707106781]]];'
    )
    body = f"MoveJ {target(0, 0, 0)},v50,fine,t\\WObj:=w1;\nMoveL {target(10, 0, 0)},v50,fine,t\\WObj:=w2;\n"
    assert ends(rapid(objects, body))[-1] == [0, 60, 0]
    with pytest.raises(InputError, match=r"work object changes from W1 to W2, and their places are not both known"):
        rapid("", body)
    with pytest.raises(InputError, match=r"work object W1 is held by the robot"):
        rapid(objects.replace("[FALSE,TRUE", "[TRUE,TRUE", 1), body)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("MoveL p99,v50,fine,t;", "target 'P99' is not known"), ("MoveL {},vX,fine,t;", "speed 'VX' is not known"),
        ("FOR i FROM 1 TO 3 DO\nMoveL {},v50,fine,t;\nENDFOR", "stands in a loop or a branch"),
        ("IF a=1 MoveL {},v50,fine,t;", "a move or a call in a branch"), ("MoveL {},v50\\T:=3,fine,t;", "with a time"),
        ("MoveL [[1,2,x],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,fine,t;", "expected numbers as"),
        ("MoveL [[1,2,3],[0,0,2,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v50,fine,t;", "has length 2, expected 1"),
        ("MoveL Offs({},1e999,0,0),v50,fine,t;", "is too great"),
        ("IF b main;", "holds a move or a call in a branch"),
        ("PDispOn p1,p2,t;", "PDISPON is not read"), ("MoveL {};", "with 1 arguments"), ("GOTO a;", "GOTO"),
    ],
)  # fmt: skip
def test_rapid_that_cannot_be_followed_is_refused(rapid, line: str, sentence: str) -> None:
    body = line.replace("{}", target(5, 0, 0))
    with pytest.raises(InputError, match=f"part.mod:[89]|part.mod:10.*{sentence}") as fault:
        rapid("", f"MoveJ {target(0, 0, 0)},v50,fine,t;\n{body}\nMoveL {target(9, 0, 0)},v50,fine,t;\n")
    assert sentence in str(fault.value)


def test_robot_programs_of_unknown_suffix_are_known_by_their_text(read) -> None:
    assert read(KRL.format("$VEL.CP=1\nPTP {X 0,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1}"), ".txt").facts.kind == "krl"
    body = f"MoveJ {target(0, 0, 0)},v50,fine,t;\nMoveL {target(1, 0, 0)},v50,fine,t;"
    assert read(RAPID.format("", body), ".txt").facts.kind == "rapid"


def test_the_number_of_a_joint_move_and_the_greatest_speed_are_read(tmp_path: Path) -> None:
    target = "[[{},0,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    moves = f"MoveJ {target.format(0)},v100,z10,t;\nMoveL {target.format(10)}\\ID:=20,v50,fine,t;\n"
    text = f"MODULE part\nPROC main()\n{moves}MoveL {target.format(90)},vmax,z1,t;\nENDPROC\nENDMODULE\n"
    cam = read_cam_text(tmp_path, text, ".mod")
    assert (cam.toolpath.position[:, 0] * 1e3).round(6).tolist() == [0, 10, 90]
    assert cam.toolpath.rapid.tolist() == [True, False, True]


def test_a_speed_that_a_subprogram_sets_is_asked_for_and_taken_from_the_option(tmp_path: Path) -> None:
    text = "DEF part( )\nMMPM(1200)\nPTP {X 0,Y 0,Z 0,A 0,B 180,C 0}\nLIN {X 20}\nEND\n"
    plain, stated = (read_cam_text(tmp_path, text, ".src", **options) for options in ({}, {"feed_mm_s": 20.0}))
    assert any("MMPM(1200) in line 2 may set it; state it with feed_mm_s" in note for note in plain.facts.notes)
    assert stated.toolpath.feed[-1] == pytest.approx(0.02)
    with pytest.raises(InputError, match=r"feed is 0 mm/s, .*state it with feed_mm_s"):
        check_toolpath(plain.toolpath)


def test_a_speed_by_a_name_that_is_not_known_needs_the_option(tmp_path: Path) -> None:
    krl = "DEF part( )\n$VEL.CP=FAST\nPTP {X 0,Y 0,Z 0,A 0,B 180,C 0}\nLIN {X 20}\nEND\n"
    target = "[[{},0,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    moves = f"MoveJ {target.format(0)},v100,z10,t;\nMoveL {target.format(10)},vCut,fine,t;\n"
    for suffix, text in ((".src", krl), (".mod", f"MODULE part\nPROC main()\n{moves}ENDPROC\nENDMODULE\n")):
        with pytest.raises(InputError, match=r"feed_mm_s \(--feed\)"):
            read_cam_text(tmp_path, text, suffix)
        assert read_cam_text(tmp_path, text, suffix, feed_mm_s=5.0).toolpath.feed[-1] == pytest.approx(0.005)


def test_the_angle_c_of_krl_turns_about_x_first() -> None:
    pose = read_pose({"X": 1.0, "Y": 2.0, "Z": 3.0, "A": 0.0, "B": 0.0, "C": 90.0})
    assert pose[:3, 1] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
