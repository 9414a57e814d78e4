"""uncertainty.toml: what it may say, and that what is written is what is read."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.robot import load_robot, write_robot_folder
from compplan.robot.uncertainty import (
    Uncertainty,
    Unknown,
    factor_covariance,
    format_uncertainty,
    read_uncertainty,
)
from compplan.uncertainty.assumed import assume_uncertainty, list_assumed, robot_uncertainty

GOOD = """schema = 1
grade = "measured"
source = "made up"
repeatability_mm = 0.02
[unexplained]
rms_mm = 0.03
scale_mm = 250.0
[calibration]
factor = 1.2
groups = 30
[[unknown]]
effect = "joint_stiffness"
joint = "joint_2"
keys = ["compliance_change_rad_per_Nm"]
deviation = [2e-8]
factor = [[1.0]]
[[unknown]]
effect = "joint_offset"
joint = "joint_3"
keys = ["offset_rad"]
deviation = [1e-5]
factor = [[0.6, 0.8]]
"""


def write(folder: Path, text: str) -> Path:
    file = folder / "uncertainty.toml"
    file.write_text(text, encoding="utf-8")
    return file


def random_uncertainty(seed: int = 5) -> Uncertainty:
    random = np.random.default_rng(seed)
    unknowns = (
        Unknown("joint_stiffness", "joint_2", None, ("compliance_change_rad_per_Nm",), np.zeros(1)),
        Unknown("link_geometry", "joint_3", "tx", ("tx_m",), np.zeros(1)),
        Unknown(
            "transmission_error", "joint_1", None, ("sine_rad#0", "cosine_rad#0"), np.zeros(2),
            {"cycles_per_turn": [2.0]},
        ),
    )  # fmt: skip
    mixed = random.normal(size=(4, 4)) * np.array([1e-8, 1e-4, 1e-5, 1e-5])[:, None]
    deviation, factor = factor_covariance(mixed @ mixed.T)
    parts = np.split(deviation, [1, 2])
    filled = tuple(replace(u, deviation=part) for u, part in zip(unknowns, parts, strict=True))
    return Uncertainty("measured", "drawn", filled, factor, 3e-5, 0.25, 2e-5, 1.2, 30)


def test_what_is_read_is_what_the_file_says(tmp_path: Path) -> None:
    known = read_uncertainty(write(tmp_path, GOOD))
    assert known is not None
    assert known.covariance == pytest.approx(1.44 * np.array([[4e-16, 1.2e-13], [1.2e-13, 1e-10]]))
    assert (known.unexplained, known.scale, known.repeatability) == pytest.approx((3e-5, 0.25, 2e-5))
    assert (known.calibration, known.groups) == (1.2, 30)
    assert known.names == ("joint_stiffness joint_2", "joint_offset joint_3")


def test_an_unknown_that_is_said_twice_is_refused_and_another_setting_of_it_is_not(tmp_path: Path) -> None:
    again = GOOD[GOOD.index("[[unknown]]") :].partition("\n[[unknown]]")[0]
    with pytest.raises(InputError, match=r"unknown\[2\]: repeats unknown\[0\]"):
        read_uncertainty(write(tmp_path, f"{GOOD}{again}\n"))
    assert read_uncertainty(write(tmp_path, f"{GOOD}{again}\nfixed = {{ cycles_per_turn = [2.0] }}\n")) is not None


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    known = random_uncertainty()
    again = read_uncertainty(write(tmp_path, format_uncertainty(known)))
    assert again is not None
    scale = np.outer(known.width, known.width)
    assert np.abs((again.covariance - known.covariance) / scale).max() < 1e-4
    assert again.names == known.names
    assert again.unknowns[2].fixed == {"cycles_per_turn": [2.0]}


def test_a_covariance_that_is_taken_is_the_one_that_is_read_whatever_the_factor() -> None:
    known = replace(random_uncertainty(), calibration=3.0)
    wanted = 0.25 * known.covariance + np.diag(0.1 * known.width**2)
    taken = known.with_covariance(wanted)
    assert taken.covariance == pytest.approx(wanted, rel=1e-9, abs=1e-12 * np.abs(wanted).max())
    assert taken.smooth == known.smooth == pytest.approx(3.0 * known.unexplained / np.sqrt(3.0))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("schema = 1", "schema = 2", "schema"),
        ('grade = "measured"', 'grade = "guessed"', "grade"),
        ("rms_mm = 0.03", "rms_mm = -1.0", "unexplained.rms_mm"),
        ("groups = 30", "groups = 30\nblocks = 2", "calibration.blocks"),
        ("deviation = [2e-8]", "deviation = [2e-8, 1e-8]", "unknown[0].deviation: has 2 numbers, expected 1"),
        ("deviation = [2e-8]", "deviation = [-2e-8]", "unknown"),
        ("deviation = [1e-5]", "deviation = [nan]", "unknown"),
        ("factor = [[0.6, 0.8]]", "factor = [[0.6, 0.9]]", "unknown[1].factor: a row has length"),
        ("factor = [[1.0]]", "factor = [[1.0], [1.0]]", "unknown[0].factor: has 2 rows, expected 1"),
        ('keys = ["offset_rad"]', "keys = []", "unknown"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(InputError) as error:
        read_uncertainty(write(tmp_path, GOOD.replace(old, new, 1)))
    assert said in str(error.value)
    assert "uncertainty.toml" in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"joint_stiffness"', '"joint_softness"', "no effect named 'joint_softness'"),
        ('joint = "joint_2"', 'joint = "joint_9"', "joint_9"),
        ('keys = ["offset_rad"]', 'keys = ["offset_deg"]', "offset_deg"),
        ("deviation = [1e-5]", "deviation = [100.0]", "unknown[1].parameters.offset_rad"),
    ],
)
def test_an_unknown_that_the_robot_does_not_have_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    folder = tmp_path / "robot"
    shutil.copytree(Path(__file__).parents[2] / "robots" / "kuka_kr270", folder)
    write(folder, GOOD.replace(old, new, 1))
    with pytest.raises(InputError, match="unknown") as error:
        robot_uncertainty(load_robot(folder))
    assert said in str(error.value)


def test_a_folder_is_written_with_its_uncertainty(tmp_path: Path) -> None:
    robot = replace(load_robot("kuka_kr270"), uncertainty=random_uncertainty())
    write_robot_folder(robot, tmp_path / "robot")
    again = load_robot(tmp_path / "robot").uncertainty
    assert again is not None
    assert again.names == random_uncertainty().names


def test_a_new_tool_is_not_where_the_old_one_was_known_to_be() -> None:
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.array([1e-6]))
    base = random_uncertainty()
    factor = np.block([[base.factor, np.zeros((4, 1))], [np.zeros((1, 4)), np.eye(1)]])
    robot = replace(load_robot("kuka_kr270"), uncertainty=replace(base, unknowns=(*base.unknowns, tool), factor=factor))
    mounted = robot.with_tool(np.eye(4))
    assert mounted.uncertainty is not None
    assert all(unknown.effect != "tool_frame" for unknown in mounted.uncertainty.unknowns)
    known = robot_uncertainty(mounted)
    assert known.unknowns[-1].effect == "tool_frame"
    assert known.covariance[:4, :4] == pytest.approx(base.covariance, abs=0.0)
    assert any("tool tip" in sentence and "assumed" in sentence for sentence in list_assumed(mounted))


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr270_full", "ur10", "kuka_kr240_rail", "staubli_tx200"])
def test_a_folder_without_the_file_gets_widths_by_its_grade_that_are_labelled(name: str) -> None:
    robot = load_robot(name)
    known = robot_uncertainty(robot)
    assert known.grade == ("literature" if robot.grade == "literature" else "assumed")
    assert (known.width > 0).all()
    assert "assumed" in known.source
    assert "assumed" in " ".join(list_assumed(robot))
    better = assume_uncertainty(replace(robot, grade="identified"))
    named = dict(zip(better.names, better.width, strict=True))
    assert all(named[label] <= size for label, size in zip(known.names, known.width, strict=True))


def test_assumed_widths_of_a_robot_as_delivered_are_what_is_said_of_them_in_si() -> None:
    """0.01 deg, 0.1 mm and 0.003 deg; 0.002 deg of play and of gear error once a turn; 0.03 mm of tool."""
    robot = load_robot("kuka_kr240_rail")
    found = {}
    for unknown in assume_uncertainty(robot).unknowns:
        found.setdefault((unknown.effect, unknown.keys[0].rpartition("_")[2].partition("#")[0]), unknown.deviation)
    assert found["joint_offset", "m"] == pytest.approx([1e-4])
    assert found["joint_offset", "rad"] == pytest.approx([1.745329e-4], rel=1e-6)
    assert found["link_geometry", "m"] == pytest.approx([1e-4])
    assert found["link_geometry", "rad"] == pytest.approx([5.235988e-5], rel=1e-6)
    assert found["backlash", "rad"] == pytest.approx([3.490659e-5], rel=1e-6)
    assert found["tool_frame", "m"] == pytest.approx([3e-5] * 3)
    # sine and cosine together have the mean square of a wave of that amplitude and any phase
    assert found["transmission_error", "rad"] == pytest.approx([2.468268e-5] * 2, rel=1e-6)
    assert not any(key[0] in ("backlash", "transmission_error") and key[1] == "m" for key in found)
