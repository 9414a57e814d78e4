"""A ball in two sockets, measured with a real arm: what is learned at two placements holds at the third.

sockets.csv: joints of a KUKA iiwa 14 whose ball sits in one of two sockets, 50 mm apart, some 30 times each at three
placements of the plate; source github.com/platonics-delft/kinematics_calibration, data/kuka_14 (arXiv 2503.12584),
licence beside it. At the placement left out, the spread is the rms distance in 3D of the ball's computed place from the
mean of its socket, over both sockets: 0.168, 0.181, 0.468 mm by a rigid arm, 0.094, 0.087, 0.313 mm by one with masses.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.robot import Array

FILE = Path(__file__).parent / "sockets_iiwa14" / "sockets.csv"
JOINTS = [f"q{k}_deg" for k in range(1, 8)]
#: DH lengths [m] and twists [deg] of the maker's drawing; link masses as in public descriptions [kg].
LENGTHS, TWISTS = (0.36, 0, 0.42, 0, 0.40, 0, 0.126), (0, -90, 90, 90, -90, -90, 90)
MASSES = (4.0, 4.0, 3.0, 2.7, 1.7, 1.8, 0.3)
#: Compliance of every joint (assumed). [rad/Nm]
COMPLIANCE = 2e-5
#: Spread by an outsider's plain fit of all lengths and angles, placement left out by placement. [mm]
PLAIN = {"front": 0.168, "left_back": 0.180, "raised_left": 0.464}


def write_arm(file: Path, *, heavy: bool) -> None:
    """Write the URDF of the arm; a heavy one has masses, their centres halfway along the links (assumed)."""
    lines, before = ['<robot name="iiwa14"><link name="link_0"/>'], 0.0
    for k, (length, twist, mass) in enumerate(zip(LENGTHS, TWISTS, MASSES, strict=True), 1):
        inertia = f'<inertia ixx="{mass / 80}" iyy="{mass / 80}" izz="{mass / 200}" ixy="0" ixz="0" iyz="0"/>'
        weight = f'<inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>{inertia}</inertial>'
        lines.append(f'<link name="link_{k}">{weight * heavy}</link><joint name="joint_{k}" type="revolute">')
        lines.append(f'<parent link="link_{k - 1}"/><child link="link_{k}"/><axis xyz="0 0 1"/>')
        lines.append(f'<origin xyz="0 0 {before}" rpy="{np.radians(twist)} 0 0"/>')
        lines.append('<limit lower="-3" upper="3" velocity="2" effort="200"/></joint>')
        before = length
    lines.append('<link name="flange"/><joint name="end" type="fixed"><parent link="link_7"/><child link="flange"/>')
    file.write_text("\n".join([*lines, f'<origin xyz="0 0 {before}"/></joint></robot>']))


def write_log(file: Path, placements: list[str]) -> list[str]:
    """Write the log of some placements and the instrument file beside it; return the label of each row."""
    with FILE.open(encoding="utf-8") as lines:
        rows = [row for row in csv.DictReader(lines) if row["placement"] in placements]
    labels = [f"{row['placement']}/{row['socket']}" for row in rows]
    table = [",".join([label, *(row[key] for key in JOINTS)]) for label, row in zip(labels, rows, strict=True)]
    file.write_text("\n".join([",".join(["contact", *JOINTS]), *table]) + "\n")
    plate = '[[distance]]\nbetween = ["{0}/0", "{0}/1"]\nmm = 50.0\nsigma_mm = 0.02'
    lines = ["schema = 1", "[instrument]", "sigma_mm = 0.1", *(plate.format(name) for name in placements)]
    file.with_suffix(".toml").write_text("\n".join(lines) + "\n")
    return labels


def judge_sockets(places: Array, labels: list[str]) -> tuple[float, float]:
    """Return the spread about the mean of each socket, and the distance of the two. [mm]"""
    own = [places[[label == name for label in labels]] for name in dict.fromkeys(labels)]
    away = np.concatenate([rows - rows.mean(axis=0) for rows in own])
    apart = own[0].mean(axis=0) - own[1].mean(axis=0)
    return float(np.sqrt((away**2).sum(axis=1).mean())), float(np.linalg.norm(apart))


@pytest.mark.parametrize("out", PLAIN)
@pytest.mark.parametrize(("heavy", "most"), [(True, 0.75), pytest.param(False, 1.1, marks=pytest.mark.slow)])
def test_two_placements_of_real_sockets_predict_the_third(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], heavy: bool,
    out: str, most: float,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)

    def run(words: str) -> None:
        answer = run_command(words.split(), monkeypatch, capsys)
        assert answer.status == 0, answer.err

    write_arm(tmp_path / "arm.urdf", heavy=heavy)
    run("init robot arm.urdf --tool-axis z --out arm")
    if heavy:
        file = tmp_path / "arm" / "elasticity.toml"
        springs = "".join(
            f'[[spring]]\njoint = "joint_{k}"\naxis = "own"\ncompliance = {COMPLIANCE}\n' for k in range(1, 8)
        )
        file.write_text(file.read_text() + springs)
    write_log(tmp_path / "two.csv", [name for name in PLAIN if name != out])
    labels = write_log(tmp_path / "third.csv", [out])
    run("diagnose two.csv --robot arm --instrument two.toml --out diagnosed")
    run("predict third.csv --robot diagnosed/robot --instrument third.toml --out seen.csv")
    places = np.loadtxt(tmp_path / "seen.csv", delimiter=",", skiprows=1)
    spread, apart = judge_sockets(places[:, :3], labels)
    assert spread < most * PLAIN[out]
    assert abs(apart - 50.0) < 0.25
