"""Inverse kinematics: every branch, its name, and what calibration takes away."""

from dataclasses import replace

import numpy as np
import pytest
from robot_library import over_robots
from scipy.spatial.transform import Rotation

from compplan.controllers.writers.joint_convention import load_controller, locate_links, measure_words
from compplan.errors import InputError, ShapeError
from compplan.planning.posture.settings import PostureSettings
from compplan.planning.posture.start import find_start
from compplan.planning.posture.summary import Start
from compplan.robot import load_robot
from compplan.statics import ik
from compplan.statics.chain import locate_frames
from compplan.toolpath.toolpath import Toolpath


def random_joints(robot, n, seed=1):
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (n, robot.nq))
    return q


def calibrate(robot, seed=0):
    """Move every joint a little, as a calibration does."""
    rng, joints = np.random.default_rng(seed), []
    for joint in robot.joints:
        placement = np.array(joint.placement)
        placement[:3, :3] = placement[:3, :3] @ Rotation.from_rotvec(1e-3 * rng.normal(size=3)).as_matrix()
        placement[:3, 3] += 3e-4 * rng.normal(size=3)
        joints.append(replace(joint, placement=placement))
    return replace(robot, joints=tuple(joints))


def solve_back(robot, q):
    arm = ik.build_arm(robot)
    frames = locate_frames(arm.chain, q)
    slots = ik.solve_branches(arm, frames.tcp_position, frames.tcp_rotation, q[:, arm.held])
    turned = np.abs((slots - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    return arm, frames, slots, np.nanmin(turned, axis=1)


@pytest.mark.parametrize("name", over_robots(redundant=False))
def test_every_branch_reaches_the_pose_and_the_true_joints_are_among_them(name):
    robot = load_robot(name)
    arm, frames, slots, nearest = solve_back(robot, random_joints(robot, 60))
    assert arm.solver is not None and arm.exact
    assert nearest.max() < 1e-6
    reached = np.isfinite(slots[:, :, 0])
    count = reached.sum(axis=1)
    position, rotation = (np.repeat(part, count, axis=0) for part in (frames.tcp_position, frames.tcp_rotation))
    assert np.abs(ik.pose_error(arm.chain, slots[reached], position, rotation)).max() < 1e-9
    assert count.mean() > 4


def test_a_calibrated_arm_has_no_closed_form_and_is_solved_to_the_nanometre_all_the_same():
    robot = calibrate(load_robot("kuka_kr270"))
    arm, frames, slots, nearest = solve_back(robot, random_joints(robot, 60))
    assert arm.solver is not None and not arm.exact
    assert nearest.max() < 1e-6
    reached = np.isfinite(slots[:, :, 0])
    position, rotation = (
        np.repeat(part, reached.sum(axis=1), axis=0) for part in (frames.tcp_position, frames.tcp_rotation)
    )
    assert np.abs(ik.pose_error(arm.chain, slots[reached], position, rotation)).max() < 1e-9


@pytest.mark.parametrize("tilt", [1e-7, 1e-6, 8e-6, 1e-4])
def test_an_arm_whose_parallel_axes_are_off_by_microradians_is_within_reach(tilt):
    """Its closed form takes such an arm for another kind, which has least-squares answers only."""
    robot = load_robot("kuka_kr270")
    place = np.array(robot.joints[2].placement)
    place[:3, :3] = place[:3, :3] @ Rotation.from_rotvec([tilt, 0.0, 0.5 * tilt]).as_matrix()
    assert robot.joints[2].name == "joint_3"
    robot = replace(robot, joints=(*robot.joints[:2], replace(robot.joints[2], placement=place), *robot.joints[3:]))
    *_, nearest = solve_back(robot, random_joints(robot, 20))
    assert nearest.max() < 1e-6


def test_an_arm_without_closed_form_is_solved_from_many_starts(monkeypatch):
    monkeypatch.setattr(ik, "_closed_form", lambda *geometry: None)
    robot = load_robot("staubli_tx200")
    middle = np.radians([5.0, 45.0, 85.0, 10.0, 50.0, 20.0])
    q = middle + np.linspace(0, 0.2, 40)[:, None] * np.array([1.0, 0.5, -0.5, 1.0, 0.3, 1.0])
    arm, _, slots, nearest = solve_back(robot, q)
    assert arm.solver is None
    assert nearest.max() < 1e-6
    assert np.isfinite(slots[:, :, 0]).sum(axis=1).min() >= 3
    assert np.array_equal(slots, solve_back(robot, q)[2], equal_nan=True)


def test_the_tool_is_part_of_the_closed_form():
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    pose[:3, 3] = [0.1, -0.05, 0.3]
    robot = load_robot("kuka_kr270").with_tool(pose, 40.0)
    arm, _, _, nearest = solve_back(robot, random_joints(robot, 40))
    assert arm.exact and nearest.max() < 1e-6


@pytest.mark.parametrize("name", ["kuka_kr270", "staubli_tx200"])
def test_configurations_are_named_as_the_controller_names_them(name):
    robot = load_robot(name)
    q = random_joints(robot, 300, seed=2)
    words = measure_words(load_controller(robot), robot, q, locate_links(robot, q))
    ours = [ik.CONFIGURATIONS[slot] for slot in ik.name_configuration(ik.build_arm(robot), q)]
    for word in ("shoulder", "elbow", "wrist"):
        assert [one[word] for one in ours] == list(words[word][0])


def test_poses_of_a_wrong_shape_are_refused():
    arm = ik.build_arm(load_robot("kuka_kr270"))
    with pytest.raises(ShapeError, match=r"poses have shapes \(2, 3\) and \(1, 3, 3\)"):
        ik.solve_branches(arm, np.zeros((2, 3)), np.eye(3)[None])


def line_of_poses(n=30, half=0.4):
    position = np.column_stack([np.full(n, 1.5), np.linspace(-half, half, n), np.full(n, 0.6)])
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    return Toolpath(position, up, np.full(n, 0.05), np.zeros(n, bool), frame="base")


def start_plain(robot, nominal, **asked) -> Start:
    return find_start(robot, nominal, np.array([1.0, 0.0, 0.0]), PostureSettings(search=False, **asked))


def test_one_configuration_is_kept_along_the_path():
    robot = load_robot("staubli_tx200")
    posture = start_plain(robot, line_of_poses(), configuration={"elbow": "up", "wrist": "flip"})
    arm = ik.build_arm(robot)
    assert not posture.missed.any()
    assert posture.configuration == {"shoulder": "front", "elbow": "up", "wrist": "flip"}
    assert len(set(ik.name_configuration(arm, posture.q))) == 1
    assert np.abs(np.diff(posture.q, axis=0)).max() < 0.1


def test_a_start_chooses_among_full_turns_of_a_joint():
    robot = load_robot("kuka_kr270")
    nominal = line_of_poses(half=0.02)
    first = start_plain(robot, nominal).q[0]
    away = first + np.array([0, 0, 0, 0, 0, -2 * np.pi if first[5] > 0 else 2 * np.pi])
    again = start_plain(robot, nominal, start=away).q
    assert np.allclose(again[0], away)
    assert ((again >= robot.lower) & (again <= robot.upper)).all()


def test_a_configuration_that_reaches_nothing_is_named():
    robot = load_robot("staubli_tx200")
    with pytest.raises(InputError, match="configuration back reaches no waypoint, other configurations do"):
        start_plain(robot, line_of_poses(), configuration={"shoulder": "back"})
