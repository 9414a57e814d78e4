"""Calibration files of KUKA, FANUC and ABB controllers: read into a folder, written from one."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commandline import run_command
from scipy.spatial.transform import Rotation
from test_calibration import locate, walk

from compplan.controllers.writers.counting import load_controller
from compplan.effects.folding import shift_origin, shift_zero
from compplan.robot import load_robot
from compplan.robot.folder import write_robot_folder


def mat(axis: str, angle: float) -> np.ndarray:
    """Return an elementary rotation, entry by entry."""
    c, s = np.cos(angle), np.sin(angle)
    pose = np.eye(4)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    pose[i, i] = pose[j, j] = c
    pose[i, j], pose[j, i] = -s, s
    return pose


def move(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def abc(x: float, y: float, z: float, a: float, b: float, c: float) -> np.ndarray:
    """Return a KUKA frame, mm and degrees: A about z, B about the new y, C about the newest x."""
    turn = mat("z", np.radians(a)) @ mat("y", np.radians(b)) @ mat("x", np.radians(c))
    return move(x * 1e-3, y * 1e-3, z * 1e-3) @ turn


#: A KR 16-2: lengths of the data sheet, its wrist in two frames that the handbook lets the maker choose.
KUKA = {
    "TIRORO": [0.0, 0.0, 675.0, 0.0, 0.0, 0.0], "LENGTH_A": [260.0], "LENGTH_B": [680.0],
    "TX3P3": [670.0, 0.0, -35.0, 0.0, 90.0, 0.0], "DH_4": [0.0, 0.0, 90.0], "DH_5": [0.0, 0.0, -90.0],
    "TFLWP": [0.0, 0.0, 158.0, 0.0, 0.0, 0.0],
}  # fmt: skip
PARTS = {6: ["X", "Y", "Z", "A", "B", "C"], 3: ["DHART_A", "DHART_D", "DHART_ALPHA"]}


def kuka_file(numbers: dict[str, list[float]]) -> str:
    lines = [
        "DEFDAT $MACHINE PUBLIC",
        "$MAIN_AXIS=#NR ;main axes",
        "REAL $MAMES[12]",
        "$MAMES[2]=-90.0",
        "$MAMES[3]=90.0",
    ]
    lines += ["$MAMES[5]=0.0", "BOOL $A4PAR=FALSE"]
    for key, values in numbers.items():
        parts = [f"{p} {v!r}" for p, v in zip(PARTS.get(len(values), [""]), values, strict=True)]
        lines.append(f"${key}=" + ("{" + ",".join(parts) + "}" if len(values) > 1 else repr(values[0])))
    return "\n".join([*lines, "ENDDAT", ""])


def kuka_pose(numbers: dict[str, list[float]], q: np.ndarray) -> np.ndarray:
    """Return the flange of the handbook's model; q against its z axes and with y. [rad]"""
    dh4, dh5 = numbers["DH_4"], numbers["DH_5"]
    pose = abc(*numbers["TIRORO"]) @ mat("z", -q[0]) @ move(numbers["LENGTH_A"][0] * 1e-3, 0, 0)
    pose = pose @ mat("y", q[1]) @ move(numbers["LENGTH_B"][0] * 1e-3, 0, 0) @ mat("y", q[2])
    pose = pose @ abc(*numbers["TX3P3"]) @ mat("z", -q[3])
    pose = pose @ move(dh4[0] * 1e-3, 0, dh4[1] * 1e-3) @ mat("x", np.radians(dh4[2])) @ mat("z", -q[4])
    pose = pose @ move(dh5[0] * 1e-3, 0, dh5[1] * 1e-3) @ mat("x", np.radians(dh5[2])) @ mat("z", -q[5])
    return pose @ abc(*numbers["TFLWP"])


def bend_kuka(seed: int = 6) -> dict[str, list[float]]:
    """Return the numbers of one robot of the type: tenths of a millimetre and hundredths of a degree off."""
    rng = np.random.default_rng(seed)
    off = {key: [value + rng.normal(0, 0.1) for value in values] for key, values in KUKA.items()}
    off["DH_4"][1] = 0.0
    return off


def read_back(text: str, robot: str, tmp_path, monkeypatch, capsys, name: str = "own.dat"):
    (tmp_path / name).write_text(text)
    out = tmp_path / f"of_{name}"
    answer = run_command(["calibration", "read", tmp_path / name, "--robot", robot, "--out", out], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    return load_robot(out / "robot")


def test_machine_data_of_a_kuka_as_it_ships_give_the_shipped_robot(tmp_path, monkeypatch, capsys) -> None:
    robot, nominal = read_back(kuka_file(KUKA), "kuka_kr16_2", tmp_path, monkeypatch, capsys), load_robot("kuka_kr16_2")
    q = np.random.default_rng(8).uniform(-3, 3, (20, 6))
    for own, shipped in zip(locate(robot, q), locate(nominal, q), strict=True):
        np.testing.assert_allclose(own, shipped, rtol=0, atol=1e-9)


def test_a_folder_from_kuka_machine_data_stands_where_the_handbooks_model_puts_it(
    tmp_path, monkeypatch, capsys
) -> None:
    off = bend_kuka()
    robot = read_back(kuka_file(off), "kuka_kr16_2", tmp_path, monkeypatch, capsys)
    q = np.random.default_rng(9).uniform(-3, 3, (40, 6))
    position, rotation = locate(robot, q)
    wanted = np.array([kuka_pose(off, row) for row in q])
    np.testing.assert_allclose(position, wanted[:, :3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rotation, wanted[:, :3, :3], rtol=0, atol=1e-9)
    assert np.linalg.norm(position - locate(load_robot("kuka_kr16_2"), q)[0], axis=1).min() > 5e-5


def test_a_kuka_whose_folder_counts_from_elsewhere_is_read_at_the_controllers_zero(
    tmp_path, monkeypatch, capsys
) -> None:
    """The KR 240's folder stands at A3 = -90 degrees where its joints are zero, and counts A1 to A4 and A6 against."""
    sheet = KUKA | {
        "TIRORO": [0.0, 0.0, 750.0, 0.0, 0.0, 0.0], "LENGTH_A": [350.0], "LENGTH_B": [1250.0],
        "TX3P3": [1100.0, 0.0, -55.0, 0.0, 90.0, 0.0], "TFLWP": [0.0, 0.0, 230.0, 0.0, 0.0, 0.0],
    }  # fmt: skip
    robot = read_back(kuka_file(sheet), "kuka_kr240", tmp_path, monkeypatch, capsys)
    q = np.random.default_rng(8).uniform(-3, 3, (20, 6))
    for own, shipped in zip(locate(robot, q), locate(load_robot("kuka_kr240"), q), strict=True):
        np.testing.assert_allclose(own, shipped, rtol=0, atol=1e-9)


def write_kuka(robot, own: str, tmp_path, monkeypatch, capsys) -> tuple[dict, str]:
    write_robot_folder(robot, tmp_path / "measured")
    (tmp_path / "machine.dat").write_text(own)
    answer = run_command(["calibration", "write", tmp_path / "measured", "--robot", "kuka_kr16_2", "--controller",
                          "kuka", "--own", tmp_path / "machine.dat", "--out", tmp_path / "new.dat", "--json"],
                         monkeypatch, capsys)  # fmt: skip
    assert answer.status == 0, answer.err
    return json.loads(answer.out), (tmp_path / "new.dat").read_text()


def test_what_kuka_machine_data_can_hold_is_written_into_the_controllers_own_file(
    tmp_path, monkeypatch, capsys
) -> None:
    """Zeros of axes 2, 3, 5 go into $MAMES: the new file at the new angles is the measured robot at the old ones."""
    robot = read_back(kuka_file(bend_kuka()), "kuka_kr16_2", tmp_path, monkeypatch, capsys)
    for joint, offset in (("joint_2", 2e-3), ("joint_3", -1e-3), ("joint_5", 3e-3), ("joint_6", 1e-3)):
        robot = shift_zero(robot, joint, offset)
    summary, text = write_kuka(replace(robot, springs=()), kuka_file(KUKA), tmp_path, monkeypatch, capsys)
    assert summary["left_rms_mm"] < 1e-3 and text.count("\n") == kuka_file(KUKA).count("\n")
    assert "$MAIN_AXIS=#NR ;main axes" in text and "DHART_D 0," in text
    mames = {int(k): float(v) for k, v in re.findall(r"\$MAMES\[(\d)\]=(\S+)", text)}
    shift = np.radians([0.0, mames[2] + 90.0, mames[3] - 90.0, 0.0, mames[5], 0.0])
    assert np.degrees(2e-3) == pytest.approx(np.degrees(shift[1]), abs=0.02)
    believed = read_back(text, "kuka_kr16_2", tmp_path, monkeypatch, capsys, "again.dat")
    q = np.random.default_rng(5).uniform(-3, 3, (40, 6))
    np.testing.assert_allclose(locate(robot, q)[0], locate(believed, q + shift)[0], rtol=0, atol=2e-6)


def test_axes_that_no_kuka_machine_data_hold_are_told(tmp_path, monkeypatch, capsys) -> None:
    robot = shift_origin(load_robot("kuka_kr16_2"), "joint_3", np.array([0.0, 0.0, 0.0, 1e-3, 0.0, 0.0]))
    summary, _ = write_kuka(replace(robot, springs=()), kuka_file(KUKA), tmp_path, monkeypatch, capsys)
    assert summary["lost"][0]["what"].startswith("axis 2 not square") and summary["left_rms_mm"] > 0.01


#: Numbers of an M-20iA in the form that a public note found on an R-2000iC: theta0, a, d, alpha.
FANUC = np.array(
    [[0, 150, 0, 90], [90, 790, 0, 0], [0, 250, 0, -90], [0, 0, -835, 90], [0, 0, 0, -90], [0, 0, -100, 180]]
)


def fanuc_file(dh: np.ndarray) -> str:
    lines = ["[*SYSTEM*]$MRR_GRP  Storage: SHADOW  Access: RW  : ARRAY[1] OF MRR_GRP_T ="]
    for column, key in enumerate(("DH_THETA0", "DH_A", "DH_D", "DH_ALPHA")):
        lines.append(f"     Field: $MRR_GRP[1].${key}  ARRAY[9] OF REAL")
        lines += [f"      [{k + 1}] = {v!r}" for k, v in enumerate([*map(float, dh[:, column]), 0.0, 0.0, 0.0])]
        lines.append("     Field: $MRR_GRP[1].$MAX_PAYLOAD Access: RO: REAL = 2.0e+01")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("scale", [0.0, 0.1])
def test_a_folder_from_fanucs_listing_stands_where_its_numbers_put_it(scale, tmp_path, monkeypatch, capsys) -> None:
    """J2 counts against axis 2 of the chain, J3 from the horizontal: theta3 = J3 + J2."""
    rng = np.random.default_rng(3)
    dh = (FANUC + scale * rng.normal(size=(6, 4))) * [np.pi / 180, 1, 1, np.pi / 180]
    robot = read_back(fanuc_file(dh), "fanuc_m20ia", tmp_path, monkeypatch, capsys)
    shown = rng.uniform(-1.5, 1.5, (30, 6))
    turned = shown * [1, -1, 1, 1, 1, 1]
    turned[:, 2] += shown[:, 1]
    wanted = np.array([move(0, 0, 0.525) @ walk(dh * [1, 1e-3, 1e-3, 1], row) for row in turned])
    counting = load_controller(robot)
    q = np.radians(np.linalg.solve(counting.matrix, (np.degrees(shown) - counting.zero).T).T)
    position, rotation = locate(robot, q)
    np.testing.assert_allclose(position, wanted[:, :3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rotation, wanted[:, :3, :3], rtol=0, atol=1e-9)


MOC = """MOC:CFG_1.0:6:1::
#
ARM_CALIB:

      -name "rob1_1" -error_offset_x 0 -error_roll 0 \\
      -error_length 0
#
ROBOT:

      -name "ROB_L" -use_robot_type "ROB1_6700" -base_frame_pos_x 0.5 -base_frame_pos_y -0.2 \\
      -base_frame_pos_z 0.1 -base_frame_orient_u0 0.7071067811865476 -base_frame_orient_u3 0.7071067811865476
"""


def test_a_base_that_was_measured_goes_into_abbs_parameters_and_the_rest_is_told(tmp_path, monkeypatch, capsys) -> None:
    """world <- base is what the controller had times how the measured arm stands in its base."""
    robot = shift_origin(load_robot("abb_irb6700_200_260"), "joint_1", np.array([3e-3, -2e-3, 1e-3, 1e-3, -2e-3, 0.0]))
    robot = shift_zero(robot, "joint_1", 2e-3)
    write_robot_folder(replace(robot, springs=(), link_elasticities=()), tmp_path / "measured")
    (tmp_path / "MOC.cfg").write_text(MOC)
    answer = run_command(["calibration", "write", tmp_path / "measured", "--robot", "abb_irb6700_200_260",
                          "--controller", "abb", "--own", tmp_path / "MOC.cfg", "--json",
                          "--out", tmp_path / "new.cfg"], monkeypatch, capsys)  # fmt: skip
    assert answer.status == 0, answer.err
    assert json.loads(answer.out)["left_rms_mm"] < 1e-3
    text = (tmp_path / "new.cfg").read_text()
    said = {key: float(value) for key, value in re.findall(r"-(base_\w+) (\S+)", text)}
    base = np.eye(4)
    base[:3, :3] = Rotation.from_quat(
        [said[f"base_frame_orient_u{k}"] for k in range(4)], scalar_first=True
    ).as_matrix()
    base[:3, 3] = [said[f"base_frame_pos_{axis}"] for axis in "xyz"]
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (20, 6))
    nominal, true = locate(load_robot("abb_irb6700_200_260"), q)[0], locate(robot, q)[0]
    own = move(0.5, -0.2, 0.1) @ mat("z", np.pi / 2)
    np.testing.assert_allclose(nominal @ base[:3, :3].T + base[:3, 3], true @ own[:3, :3].T + own[:3, 3], atol=1e-6)
    assert '-name "ROB_L"' in text


def test_a_moc_file_without_absolute_accuracy_gives_the_type_and_one_with_it_is_refused(
    tmp_path, monkeypatch, capsys
) -> None:
    robot = read_back(MOC, "abb_irb6700_200_260", tmp_path, monkeypatch, capsys)
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (5, 6))
    np.testing.assert_allclose(locate(robot, q)[0], locate(load_robot("abb_irb6700_200_260"), q)[0], atol=1e-9)
    (tmp_path / "acc.cfg").write_text(MOC.replace("-error_length 0", "-error_length -0.00031"))
    answer = run_command(["calibration", "read", tmp_path / "acc.cfg", "--robot", "abb_irb6700_200_260", "--out",
                          tmp_path / "o"], monkeypatch, capsys)  # fmt: skip
    assert answer.status == 2 and "acc.cfg:5: holds ARM_CALIB -error_length -0.00031" in answer.err
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("text", "robot", "says"),
    [
        (kuka_file(KUKA).replace("=#NR", "=#RR"), "kuka_kr16_2", "c.dat:2: $MAIN_AXIS is #RR, expected #NR"),
        (kuka_file(KUKA).replace("$LENGTH_B=680.0", "$LENGTH_B=abc"), "kuka_kr16_2", "c.dat:10: $LENGTH_B is 'abc'"),
        (kuka_file(KUKA).replace("$TFLWP", ";$TFLWP"), "kuka_kr16_2", "c.dat: has no $TFLWP"),
        (kuka_file(KUKA).replace("B 90.0", "C 90.0"), "kuka_kr16_2", "c.dat:11: $TX3P3 is"),
        (kuka_file(KUKA), "kuka_kr270", "moves the flange of kuka_kr270 by"),
        (kuka_file(KUKA), "kuka_kr240_rail", "robot 'kuka_kr240_rail' has 7 axes, expected an arm of 6 that turn"),
        (fanuc_file(FANUC).replace("[4] = -835.0", "[4] = 1e400"), "fanuc_m20ia", "$DH_D[4] is '1e400'"),
        ("$DMR_GRP[1].$MASTER_COUN\n", "fanuc_m20ia", "c.dat: is FANUC master counts"),
    ],
)  # fmt: skip
def test_a_faulty_file_of_another_make_is_refused_in_one_line(text, robot, says, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "c.dat").write_text(text)
    answer = run_command(["calibration", "read", tmp_path / "c.dat", "--robot", robot, "--out", tmp_path / "o"],
                         monkeypatch, capsys)  # fmt: skip
    assert answer.status == 2 and says in answer.err and answer.err.count("\n") == 1, answer.err
    assert not (tmp_path / "o").exists()


def test_kuka_machine_data_are_not_written_without_the_controllers_own(tmp_path, monkeypatch, capsys) -> None:
    answer = run_command(["calibration", "write", "kuka_kr16_2", "--robot", "kuka_kr16_2", "--controller", "kuka",
                          "--out", tmp_path / "o.dat"], monkeypatch, capsys)  # fmt: skip
    assert answer.status == 2 and "--own FILE" in answer.err and not (tmp_path / "o.dat").exists()
