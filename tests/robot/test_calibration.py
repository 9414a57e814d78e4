"""A controller's own calibration, read into a robot folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from scipy.spatial.transform import Rotation

from compplan.robot import load_robot
from compplan.robot.calibration import read_calibration
from compplan.statics.chain import build_chain, locate_frames

#: a2, a3, d1, d4, d5, d6 of the maker's tables. [m]
TYPES = {
    "ur5e": (-0.425, -0.3922, 0.1625, 0.1333, 0.0997, 0.0996),
    "ur10e": (-0.6127, -0.57155, 0.1807, 0.17415, 0.11985, 0.11655),
    "ur20": (-0.862, -0.7287, 0.2363, 0.201, 0.1593, 0.1543),
    "ur10": (-0.612, -0.5723, 0.1273, 0.163941, 0.1157, 0.0922),
}
KEYS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def table(name: str) -> np.ndarray:
    """Return theta, a, d, alpha of a type, one row a joint."""
    a2, a3, d1, d4, d5, d6 = TYPES[name]
    quarter = np.pi / 2
    return np.array([(0, 0, d1, quarter), (0, a2, 0, 0), (0, a3, 0, 0), (0, 0, d4, quarter), (0, 0, d5, -quarter),
                     (0, 0, d6, 0)])  # fmt: skip


def walk(dh: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multiply Denavit and Hartenberg's matrices, entry by entry as in their textbook."""
    pose = np.eye(4)
    for (theta, a, d, alpha), angle in zip(dh, q, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return pose


def draw_deltas(seed: int) -> np.ndarray:
    """Draw small deltas, and the large distances along nearly parallel axes that a real file holds."""
    rng = np.random.default_rng(seed)
    delta = rng.normal(0.0, [1e-3, 3e-4, 3e-4, 1e-3], (6, 4))
    delta[1:4, 2] = 0.0
    delta[1, 2], delta[2, 2], delta[3, 2] = 6.0, -6.0, 0.001
    delta[5, [1, 3]] = 0.0
    return delta


def write_conf(file: Path, delta: np.ndarray) -> Path:
    lines = [f"{key} = [ {', '.join(repr(float(v)) for v in row)}]" for key, row in zip(KEYS, delta.T, strict=True)]
    file.write_text("[mounting]\n" + "\n".join(lines) + "\ncalibration_status = 2\n")
    return file


def locate(robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    frames = locate_frames(build_chain(replace(robot, springs=(), gravity=None)), q)
    return frames.tcp_position, frames.tcp_rotation


@pytest.mark.parametrize("name", list(TYPES))
def test_a_folder_from_calibration_conf_stands_where_the_controllers_numbers_put_it(
    name, tmp_path, monkeypatch, capsys
) -> None:
    delta = draw_deltas(1)
    conf = write_conf(tmp_path / "calibration.conf", delta)
    answer = run_command(["calibration", "read", conf, "--robot", name, "--out", tmp_path / "o"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    robot = load_robot(tmp_path / "o" / "robot")
    q = np.random.default_rng(2).uniform(-3, 3, (40, 6))
    position, rotation = locate(robot, q)
    wanted = np.array([walk(table(name) + delta, row) for row in q])
    np.testing.assert_allclose(position, wanted[:, :3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rotation, wanted[:, :3, :3], rtol=0, atol=1e-9)
    moved = np.linalg.norm(position - locate(load_robot(name), q)[0], axis=1)
    assert moved.min() > 1e-4
    assert all(np.abs(joint.placement[:3, 3]).max() < 1.0 for joint in robot.joints)


def test_a_real_ur10e_whose_arm_axes_meet_hundreds_of_metres_away_is_read() -> None:
    """Numbers of a real robot, from the page on ur_calibration's algorithm (UniversalRobots, ROS 2 driver)."""
    dh = np.array([
        (-2.4147806894359e-07, 1.60233952386695, -1.68607190752171, 0.0837331147700119, -1.01260355871158e-07,
         3.91986209186124e-08),
        (2.12234865571206e-05, 0.0193171326277006, -0.569251663611088, -4.61409023720934e-05, -6.39280053471802e-05, 0),
        (0.180539811714259, 439.140974079901, -446.027059806332, 7.0603368964236, 0.119811341150314, 0.115670917257426),
        (1.57014608044242, 0.0013941666682559, 0.00693818880325995, 1.56998468543761, -1.57038520649543, 0),
    ]).T  # fmt: skip
    nominal = load_robot("ur10e")
    delta = dh - table("ur10e")
    text = "\n".join(f"{key} = {row.tolist()}" for key, row in zip(KEYS, delta.T, strict=True))
    robot = read_calibration(text, Path("calibration.conf"), nominal)[0]
    q = np.random.default_rng(7).uniform(-3, 3, (40, 6))
    wanted = np.array([walk(dh, row)[:3, 3] for row in q])
    np.testing.assert_allclose(locate(robot, q)[0], wanted, rtol=0, atol=1e-9)
    moved = np.linalg.norm(locate(nominal, q)[0] - wanted, axis=1)
    assert 1e-3 < moved.mean() < 4e-3


def test_a_kinematics_file_of_the_driver_gives_the_same_robot(tmp_path, monkeypatch, capsys) -> None:
    dh = table("ur10e") + draw_deltas(3)
    lines, last = ["kinematics:"], np.eye(4)
    for link, (theta, a, d, alpha) in zip(LINKS, dh, strict=True):
        turn = Rotation.from_euler("z", theta).as_matrix()
        frame = last.copy()
        frame[:3, 3] += last[:3, :3] @ [0, 0, d]
        frame[:3, :3] = last[:3, :3] @ turn
        numbers = [*frame[:3, 3], *Rotation.from_matrix(frame[:3, :3]).as_euler("xyz")]
        lines += [f"  {link}:", *(f"    {k}: {float(v)!r}" for k, v in zip(
            ("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True))]  # fmt: skip
        last = np.eye(4)
        last[:3, :3], last[:3, 3] = Rotation.from_euler("x", alpha).as_matrix(), [a, 0, 0]
    file = tmp_path / "my_robot.yaml"
    file.write_text("\n".join([*lines, "  hash: calib_1", ""]))
    answer = run_command(
        ["calibration", "read", file, "--robot", "ur10e", "--out", tmp_path / "o"], monkeypatch, capsys
    )
    assert answer.status == 0, answer.err
    q = np.random.default_rng(4).uniform(-3, 3, (20, 6))
    wanted = np.array([walk(dh, row)[:3, 3] for row in q])
    np.testing.assert_allclose(locate(load_robot(tmp_path / "o" / "robot"), q)[0], wanted, rtol=0, atol=1e-9)


GOOD = "delta_theta = [0,0,0,0,0,0]\ndelta_a = [0,0,0,0,0,0]\ndelta_d = [0,0,0,0,0,0]\ndelta_alpha = [0,0,0,0,0,0]\n"


@pytest.mark.parametrize(
    ("text", "robot", "says"),
    [
        (GOOD.replace("delta_a = [0,", "delta_a = [x,"), "ur5e", "c.conf:2: delta_a is 'x,0,0,0,0,0', expected 6"),
        (GOOD.replace("delta_a = [0,", "delta_a = ["), "ur5e", "c.conf:2: delta_a is"),
        (GOOD.replace("delta_d = [0,", "delta_d = [nan,"), "ur5e", "c.conf:3: delta_d is"),
        (GOOD + "delta_d = [0,0,0,0,0,0]\n", "ur5e", "c.conf:5: delta_d is given twice"),
        (GOOD.replace("delta_alpha", "alpha"), "ur5e", "c.conf: has no delta_alpha"),
        (GOOD.replace("delta_d = [0,", "delta_d = [0.5,"), "ur5e", "moves the flange of ur5e by 500 mm"),
        (GOOD, "kuka_kr270", "robot 'kuka_kr270' does not have the axes of a Universal Robots arm"),
        ("kinematics:\n  shoulder:\n    x: a\n", "ur5e", "c.conf:3: shoulder.x is 'a', expected a finite number"),
        ("hello\n", "ur5e", "c.conf: is not a known calibration file, expected calibration.conf of Universal"),
    ],
)  # fmt: skip
def test_a_faulty_file_is_refused_in_one_line(text, robot, says, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "c.conf").write_text(text)
    answer = run_command(["calibration", "read", tmp_path / "c.conf", "--robot", robot, "--out", tmp_path / "o"],
                         monkeypatch, capsys)  # fmt: skip
    assert answer.status == 2 and says in answer.err and answer.err.count("\n") == 1
    assert not (tmp_path / "o").exists()
