"""A robot that was measured keeps the posture of the job's own robot, and a plan keeps that of an earlier program."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.job.job import load_job
from compplan.learning.part import build_learned
from compplan.planning.plan import build_task, prepare_job
from compplan.robot import Array, Robot, load_robot
from compplan.robot.folder import write_robot_folder
from compplan.robot.model import is_same_machine

pytestmark = pytest.mark.usefixtures("graph_alone")

JOB = """
schema = 1
robot = "ur5e"
[toolpath]
generator = "circle"
radius_mm = 80.0
waypoints = 40
feed_mm_s = 40.0
[part]
position_mm = [450.0, 100.0, 250.0]
[tool]
position_mm = [60.0, 0.0, 90.0]
rotation_deg = [0.0, 45.0, 0.0]
[process]
model = "constant"
force_N = [-20.0, 10.0, 30.0]
frame = "path"
"""
#: Far beyond every correction, far below a branch or a turn of the tool. [rad]
SMALL = np.radians(3.0)


def write_job(folder: Path) -> Path:
    """Write the job."""
    file = folder / "job.toml"
    file.write_text(JOB)
    return file


def write_measured(folder: Path, *, reach: float = 1.0) -> Robot:
    """Write a folder of the job's robot as measured: wrist drives softer, millimetres off, lost motion."""
    robot = load_robot("ur5e")
    joints = []
    for number, joint in enumerate(robot.joints):
        placement = np.array(joint.placement)
        placement[:3, 3] *= reach
        placement[0, 3] += 5e-4 * (-1) ** number
        joints.append(replace(joint, placement=placement))
    springs = tuple(replace(s, compliance=s.compliance * (3.0 if k == 2 else 0.6)) for k, s in enumerate(robot.springs))
    lost = {"effect": "backlash", "joint": robot.joint_names[0], "parameters": {"width_rad": 2e-4}}
    write_robot_folder(replace(robot, joints=tuple(joints), springs=springs, effects=(lost,)), folder)
    return load_robot(folder)


def starts_at(file: Path, robot: str | None = None, keep: str | None = None) -> Array:
    """Return the joint positions that a plan starts from, at the waypoints of the toolpath."""
    task = build_task(*prepare_job(load_job(file, robot, () if keep is None else (f"plan.keep={keep}",))), file=file)
    places = np.flatnonzero(task.origin == np.round(task.origin))
    return task.q_start[places[np.unique(task.origin[places], return_index=True)[1]]]


@pytest.fixture(scope="module")
def own(graph_alone: None, tmp_path_factory: pytest.TempPathFactory) -> Array:
    """Where the plan of the job's own robot starts from."""
    return starts_at(write_job(tmp_path_factory.mktemp("own")))


def test_a_measured_folder_stands_as_the_jobs_own_robot_and_learn_does_too(own: Array, tmp_path: Path) -> None:
    file, measured = write_job(tmp_path), write_measured(tmp_path / "measured")
    again = starts_at(file, str(tmp_path / "measured"))
    anew = starts_at(file, str(tmp_path / "measured"), "nothing")
    assert np.abs(again - own).max() < SMALL
    assert np.abs(anew - own).max() > 2 * SMALL  # the measured robot would stand elsewhere if it were asked
    _, task, _ = build_learned(load_job(file), measured, None)
    assert np.abs(task.q_start[[0, -1]] - own[[0, -1]]).max() < SMALL
    assert any("The posture is kept" in note for note in task.start.notes)


def test_another_robot_is_no_machine_to_keep_the_posture_of(tmp_path: Path) -> None:
    robot, measured = load_robot("ur5e"), write_measured(tmp_path / "measured")
    assert is_same_machine(robot, measured)
    assert not is_same_machine(robot, load_robot("ur10e"))
    assert not is_same_machine(robot, load_robot("kuka_kr270"))
    assert not is_same_machine(robot, write_measured(tmp_path / "longer", reach=1.2))
