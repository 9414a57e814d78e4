from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robot_library import over_robots

from compplan.controllers.writers.joint_convention import (
    controller_robot,
    from_controller,
    krl_status,
    load_controller,
    locate_links,
    measure_words,
    to_controller,
)
from compplan.errors import InputError
from compplan.robot import Joint, Robot, load_robot, robot_folders, write_robot_folder
from compplan.statics.chain import build_chain, locate_frames


def random_q(robot: Robot, n: int = 50) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform(np.maximum(robot.lower, -3), np.minimum(robot.upper, 3), (n, robot.nq))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(shutil.copytree(robot_folders()["kuka_kr270"], tmp_path / "robot"))


@pytest.mark.parametrize("name", over_robots())
def test_every_robot_counts_there_and_back(name: str) -> None:
    robot = load_robot(name)
    controller = load_controller(robot)
    q = random_q(robot)
    assert np.abs(from_controller(controller, to_controller(controller, q)) - q).max() < 1e-13
    for values, _ in measure_words(controller, robot, q, locate_links(robot, q)).values():
        assert len(set(values.tolist())) == 2


def test_the_kuka_counts_against_the_urdf_and_from_the_horizontal() -> None:
    controller = load_controller(load_robot("kuka_kr270"))
    counted = to_controller(controller, np.radians([[10, 20, 30, 40, 50, 60]]))
    assert counted == pytest.approx(np.array([[-10, -70, -30, -40, 50, -60]]))


def test_a_rail_counts_in_millimetres() -> None:
    robot = load_robot("kuka_kr240_rail")
    controller = load_controller(robot)
    assert to_controller(controller, np.eye(7)[:1] * 1.5)[0, 0] == pytest.approx(1500)


@pytest.mark.parametrize("name", over_robots())
def test_links_are_located_where_the_chain_has_them(name: str) -> None:
    robot = load_robot(name)
    q = random_q(robot, 10)
    frames = locate_frames(build_chain(robot), q)
    pose = locate_links(robot, q)[robot.tcp]
    assert pose[:, :3, 3] == pytest.approx(frames.tcp_position, abs=1e-12)
    assert pose[:, :3, :3] == pytest.approx(frames.tcp_rotation, abs=1e-12)


def test_the_status_of_a_kuka_tells_its_three_words_apart() -> None:
    robot = load_robot("kuka_kr270")
    controller = load_controller(robot)
    q = random_q(robot, 400)
    words = measure_words(controller, robot, q, locate_links(robot, q))
    status = krl_status(controller, {key: values for key, (values, _) in words.items()})
    assert status is not None and set(status.tolist()) <= set(range(8))
    counted = to_controller(controller, q)
    assert np.array_equal(status & 4 > 0, counted[:, 4] < 0)
    phi = -np.degrees(np.arctan2(0.041, 1.2))
    clear = np.abs(counted[:, 2] - phi) > 0.01
    assert np.array_equal((status & 2 > 0)[clear], (counted[:, 2] > phi)[clear])
    shoulder = locate_links(robot, q)["link_5"][:, :2, 3]
    behind = np.cos(q[:, 0]) * shoulder[:, 0] + np.sin(q[:, 0]) * shoulder[:, 1] < 0
    assert np.array_equal(status & 1 > 0, behind)


def test_without_a_controller_file_the_urdf_counts(folder: Path) -> None:
    (folder / "controller.toml").unlink()
    robot = load_robot(folder)
    assert to_controller(load_controller(robot), np.full((1, 6), np.pi)) == pytest.approx(180)
    assert krl_status(load_controller(robot), {}) is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("sign        = [-1, 1, -1, -1, 1, -1]", "sign = [1, 1]", r"controller.toml: sign: has 2 numbers, expected 6"),
        ("sign        = [-1, 1, -1, -1, 1, -1]", "sign = [2, 1, 1, 1, 1, 1]", r"sign\[0\]: is 2, choose"),
        ("zero_deg    = [0.0, -90.0, 0.0, 0.0, 0.0, 0.0]", "zero_deg = [0]", r"toml: zero_deg: has 1 numbers,"),
        ("schema      = 1", "schema = 1\ncolour = 1", r"controller.toml: colour: unknown key"),
        ('joint         = "joint_5"', 'joint = "joint_9"', r"wrist: no joint named 'joint_9', choose from"),
    ],
)
def test_each_mistake_in_a_controller_file_has_its_sentence(folder: Path, old: str, new: str, sentence: str) -> None:
    file = folder / "controller.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=sentence):
        load_controller(load_robot(folder))


def test_cartesian_programs_go_through_the_geometry_that_the_controller_believes(folder: Path) -> None:
    text = (folder / "robot.urdf").read_text()
    assert '<origin xyz="0.24 0 0"/>' in text
    (folder / "controller.urdf").write_text(text)
    (folder / "robot.urdf").write_text(text.replace('<origin xyz="0.24 0 0"/>', '<origin xyz="0.241 0 0"/>'))
    robot = load_robot(folder)
    q = random_q(robot, 5)
    real, believed = (locate_links(each, q)[robot.tcp][:, :3, 3] for each in (robot, controller_robot(robot)))
    assert np.linalg.norm(real - believed, axis=1) == pytest.approx(0.001)


def test_a_measured_folder_keeps_the_geometry_that_its_controller_believes_where_it_has_another(
    folder: Path, tmp_path: Path
) -> None:
    nominal = load_robot(folder)
    moved = replace(nominal, joints=(shift_first(nominal.joints[0]), *nominal.joints[1:]))
    for name, robot in (("moved", moved), ("same", nominal)):
        write_robot_folder(robot, tmp_path / name, nominal)
    assert not (tmp_path / "same" / "controller.urdf").exists()
    written = load_robot(tmp_path / "moved")
    q = random_q(nominal, 5)
    real, believed, before = (
        locate_links(r, q)[r.tcp][:, :3, 3] for r in (written, controller_robot(written), nominal)
    )
    assert believed == pytest.approx(before, abs=1e-12)
    assert np.linalg.norm(real - before, axis=1) == pytest.approx(0.001)


def shift_first(joint: Joint) -> Joint:
    """Put a joint 1 mm farther along x of its parent."""
    placement = joint.placement.copy()
    placement[0, 3] += 1e-3
    return replace(joint, placement=placement)
