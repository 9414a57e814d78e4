from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm
from robot_library import over_robots
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, UnknownNameError
from compplan.robot import Spring, load_robot
from compplan.robot.folder import write_robot_folder
from compplan.statics.chain import build_chain, load_elements, locate_frames
from compplan.statics.elastic import solve_equilibrium

Q = np.random.default_rng(0).uniform(-1, 1, (4, 6))
WRENCH = np.array([300.0, -200, 500, 20, 10, -30])


@pytest.mark.parametrize("name", over_robots())
def test_a_folder_that_is_written_back_is_the_same_robot(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    write_robot_folder(robot, tmp_path / name)
    again = load_robot(tmp_path / name)
    q = np.random.default_rng(1).uniform(-1, 1, (3, robot.nq))
    before, after = (solve_equilibrium(build_chain(r), q, WRENCH) for r in (robot, again))
    np.testing.assert_allclose(after.position, before.position, atol=1e-12)
    np.testing.assert_allclose(after.theta, before.theta, atol=1e-12)
    assert (again.grade, again.tcp, again.flange, dict(again.sources)) == (
        robot.grade, robot.tcp, robot.flange, dict(robot.sources)
    )  # fmt: skip
    assert [s.actuator for s in again.springs] == [s.actuator for s in robot.springs]


def test_changes_of_geometry_springs_and_masses_survive_writing(tmp_path: Path) -> None:
    robot = load_robot("kuka_kr270")
    joints = list(robot.joints)
    moved = joints[2].placement.copy()
    moved[:3, 3] += [1e-3, 2e-3, -3e-3]
    moved[:3, :3] = moved[:3, :3] @ Rotation.from_rotvec([1e-3, -2e-3, 5e-4]).as_matrix()
    joints[2] = replace(joints[2], placement=moved)
    changed = replace(
        robot,
        joints=tuple(joints),
        springs=(*robot.springs, Spring("joint_2", "rx", 3e-7, np.array([0.0, 0.1, 0.2]))),
        bodies=(replace(robot.bodies[1], mass=123.0), *robot.bodies[2:]),
        gravity=np.array([0.0, 0.0, -9.81]),
    )
    write_robot_folder(changed, tmp_path / "changed")
    again = load_robot(tmp_path / "changed")
    before, after = (solve_equilibrium(build_chain(r), Q, WRENCH) for r in (changed, again))
    np.testing.assert_allclose(after.position, before.position, atol=1e-9)


def test_a_tool_replaces_tcp_and_load() -> None:
    robot = replace(load_robot("kuka_kr270"), gravity=np.array([0.0, 0.0, -9.81]))
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.2, 0.3]
    tooled = robot.with_tool(pose, mass=50.0, centre=(0.0, 0.0, 0.1))
    bare, carrying = build_chain(replace(robot, tcp=robot.flange)), build_chain(tooled)
    a, b = locate_frames(bare, Q), locate_frames(carrying, Q)
    flange_to_tool0 = robot.joints[-1].placement
    offset = np.linalg.inv(flange_to_tool0) @ pose
    np.testing.assert_allclose(b.tcp_position, a.tcp_position + a.tcp_rotation @ offset[:3, 3], atol=1e-12)
    empty = build_chain(robot.with_tool(pose))
    none = np.zeros((1, 6))
    added = load_elements(carrying, b, none) - load_elements(empty, locate_frames(empty, Q), none)
    centre = b.centre[:, -1]
    lever = np.cross(centre[:, None] - b.origin, 50 * np.array([0.0, 0.0, -9.81]))
    np.testing.assert_allclose(added, np.einsum("nmi,nmi->nm", b.axis, lever), atol=1e-9)


def test_scaling_the_compliance_scales_the_deflection() -> None:
    robot = load_robot("kuka_kr270_full")
    small = 1e-3 * WRENCH
    start = locate_frames(build_chain(robot), Q).tcp_position
    robots = robot, robot.scale_compliance(2.0)
    one, two = (solve_equilibrium(build_chain(r), Q, small).position - start for r in robots)
    np.testing.assert_allclose(two, 2 * one, rtol=1e-4, atol=1e-12)


def edit(file: Path, change: Callable[[str], str]) -> None:
    file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('joint = "joint_1"', 'joint = "elbow"', ["no joint named 'elbow'", "spring[0].joint", "joint_1"]),
        ('tcp = "tool0"', 'tcp = "tool7"', ["no frame named 'tool7'", "tcp", "tool0"]),
        ("compliance = 1e-05", "compliance = -1.0", ["greater than or equal to 0", "spring[0].compliance"]),
        ("compliance = 1e-05", "complience = 1e-5", ["unknown key", "spring[0].complience"]),
        ("compliance = 1e-05", 'compliance = 1e-5\naxis = "rw"', ["no axis named 'rw'", "spring[0].axis"]),
        ("schema = 1", "schema = 1\ngravity = [0.0, 1.0]", ["expected 3 numbers", "gravity"]),
        ("schema = 1", "schema = ", ["is not TOML"]),
    ],
)
def test_a_wrong_entry_is_named_with_its_place(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    one_joint_arm(tmp_path)
    edit(tmp_path / "elasticity.toml", lambda text: text.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_robot(tmp_path)
    for word in ["elasticity.toml", *words]:
        assert word in str(caught.value)
    assert caught.value.exit_status == 2


def test_a_robot_that_does_not_exist_is_answered_with_those_that_do() -> None:
    with pytest.raises(UnknownNameError, match="kuka_kr270"):
        load_robot("kuka_kr999")


def test_a_folder_without_elasticity_is_refused(tmp_path: Path) -> None:
    one_joint_arm(tmp_path)
    (tmp_path / "elasticity.toml").unlink()
    with pytest.raises(InputError, match=r"elasticity\.toml"):
        load_robot(tmp_path)


def test_a_rail_is_written_in_millimetres_and_the_weight_of_a_mounted_tool_pulls_down() -> None:
    robot = load_robot("kuka_kr240_rail")
    columns = robot.joint_columns(np.array([[1.5, *np.radians([10.0, -20.0, 30.0, 0.0, 0.0, 90.0])]]))
    assert list(columns) == ["q1_mm", *(f"q{k}_deg" for k in range(2, 8))]
    assert [float(values[0]) for values in columns.values()] == pytest.approx([1500.0, 10, -20, 30, 0, 0, 90])
    bare = replace(load_robot("kuka_kr270"), gravity=None)
    armed = bare.with_tool(np.eye(4), 20.0)
    assert armed.loading_gravity == pytest.approx([0.0, 0.0, -9.81])
    heavy = replace(bare, gravity=np.array([0.1, 0.0, -9.7]))
    assert heavy.with_tool(np.eye(4), 20.0).loading_gravity == pytest.approx([0.1, 0.0, -9.7])


def test_in_a_model_without_weight_the_tool_of_its_identification_is_taken_off() -> None:
    robot = replace(load_robot("kuka_kr270"), gravity=None)
    old = replace(robot.with_tool(np.eye(4), 30.0, (0.0, 0.0, 0.1)), weights=())
    assert old.gravity is None
    changed = old.with_tool(np.eye(4), 50.0, (0.0, 0.0, 0.1)).loading_bodies
    assert sum(body.mass for body in changed) == pytest.approx(20.0)
    assert sum(body.mass * body.centre[2] for body in changed) == pytest.approx(2.0)
