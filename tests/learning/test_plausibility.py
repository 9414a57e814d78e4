"""Lessons that are none: points of something else, in other units or frames, or of a part that stood elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.job.job import Job, load_job
from compplan.job.loading import load_nominal
from compplan.learning.gathered_points import Gathered, describe_whole
from compplan.learning.part import learn_from_part
from compplan.robot import Array, Robot, load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from tests.learning.test_model_update import write_points

JOB = """schema = 1
name = "bent"
robot = "kuka_kr270"
toolpath = "bent.csv"
[part]
position_mm = [1600.0, 100.0, 900.0]
rotation_deg = [0.0, 0.0, 20.0]
[process]
model = "constant"
force_N = [40.0, 140.0, -60.0]
frame = "base"
[plan]
rotate_about_tool_axis = false
[sampling]
max_step_mm = 4.0
"""


def bend(t: Array) -> Array:
    """Return a path that looks like no turned, mirrored or exchanged copy of itself, part frame. Shape (n, 3). [mm]"""
    return np.column_stack([120.0 * t, 50.0 * t**2 + 10.0 * np.sin(7.0 * t), 4.0 * t])


@pytest.fixture(scope="module")
def equipment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, Robot, Path]:
    """Return a job, a robot that was measured, and a folder."""
    folder = tmp_path_factory.mktemp("wrong")
    t = np.linspace(0.0, 1.0, 40)
    write_points(folder / "bent.csv", "x_mm,y_mm,z_mm,feed_mm_s", np.column_stack([bend(t), np.full(40, 20.0)]))
    (folder / "bent.toml").write_text(JOB, encoding="utf-8")
    robot = load_robot("kuka_kr270")
    soft = [
        Unknown("joint_stiffness", s.joint, None, ("compliance_change_rad_per_Nm",), np.array([0.05 * s.compliance]))
        for s in robot.springs
    ]
    known = Uncertainty("measured", "test", tuple(soft), np.eye(6), unexplained=5e-5, repeatability=1e-5)
    return load_job(folder / "bent.toml"), replace(robot, uncertainty=known), folder


def measure(job: Job) -> tuple[Array, Array]:
    """Return points of a true part, part frame [mm], and their lengths along the path [mm]."""
    nominal, rng = load_nominal(job), np.random.default_rng(3)
    s = np.linspace(2.0, 1e3 * nominal.arc_length[-1] - 2.0, 60)
    place = job.T_base_part
    on = np.stack([np.interp(s, 1e3 * nominal.arc_length, nominal.position[:, k]) for k in range(3)], axis=1)
    local = 1e3 * (on - place[:3, 3]) @ place[:3, :3]
    return local + [0.0, 0.02, 0.03] * np.sin(s / 40.0)[:, None] + 0.005 * rng.standard_normal((60, 3)), s


def turned(points: Array, degrees: float) -> Array:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return points @ turn.T


def other(t: Array) -> Array:
    return np.column_stack([60.0 + 40.0 * np.cos(6.0 * t), 25.0 + 40.0 * np.sin(6.0 * t), 2.0 + 0.0 * t])


GARBAGE = np.random.default_rng(5)
TIME = np.linspace(0.0, 1.0, 60)
#: What is done to true points; one that has s_mm gets its lengths too.
WRONG: dict[str, Callable[[Array], Array]] = {
    "another part": lambda p: other(TIME),
    "another part that crosses this one": lambda p: bend(TIME) * [1.0, -1.0, 1.0] + [0.0, 30.0, 0.0],
    "a part twice as large": lambda p: 2.0 * p,
    "a part 4 % larger": lambda p: 1.04 * p,
    "metres": lambda p: p * 1e-3,
    "inches": lambda p: p / 25.4,
    "centimetres": lambda p: p / 10.0,
    "micrometres": lambda p: p * 1e3,
    "base frame": lambda p: turned(p, 20.0) + np.array([1600.0, 100.0, 900.0]),
    "x and y exchanged": lambda p: p[:, [1, 0, 2]],
    "y and z exchanged": lambda p: p[:, [0, 2, 1]],
    "axes in turn": lambda p: p[:, [2, 0, 1]],
    "mirrored in x": lambda p: p * [-1.0, 1.0, 1.0],
    "mirrored in y": lambda p: p * [1.0, -1.0, 1.0],
    "turned over": lambda p: p * [1.0, -1.0, -1.0],
    "turned by the angle of the part": lambda p: turned(p, 20.0),
    "shifted by 3 mm": lambda p: p + np.array([0.0, 3.0, 0.0]),
    "a fixture below": lambda p: p - [0.0, 0.0, 8.0],
    "the radius of the probe": lambda p: p + np.array([0.0, 0.0, 3.0]),
    "turned by 2 degrees": lambda p: turned(p, 2.0),
    "noise": lambda p: GARBAGE.uniform([0, 0, 0], [120, 60, 4], (60, 3)),
    "one spot": lambda p: np.tile(p[30], (60, 1)) + 0.01 * GARBAGE.standard_normal((60, 3)),
}


@pytest.mark.parametrize(
    "name", [name if k % 3 == 0 else pytest.param(name, marks=pytest.mark.slow) for k, name in enumerate(WRONG)]
)
def test_a_wrong_lesson_is_asked_about_and_never_learned(name: str, equipment: tuple[Job, Robot, Path]) -> None:
    job, robot, folder = equipment
    file = write_points(folder / "part.csv", "x_mm,y_mm,z_mm", WRONG[name](measure(job)[0]))
    with pytest.raises(InputError, match=r"part\.csv:.*(\?|assume-ok|state s_mm|places|of the cut)"):
        learn_from_part(job, robot, file)


@pytest.mark.parametrize("name", ["reversed", "shifted", "metres"])
def test_lengths_that_are_not_those_of_the_points_are_asked_about(
    name: str, equipment: tuple[Job, Robot, Path]
) -> None:
    job, robot, folder = equipment
    points, s = measure(job)
    wrong = {"reversed": s[::-1], "shifted": np.roll(s, 15), "metres": 1e-3 * s}[name]
    file = write_points(folder / "placed.csv", "x_mm,y_mm,z_mm,s_mm", np.column_stack([points, wrong]))
    with pytest.raises(InputError, match=r"placed\.csv:"):
        learn_from_part(job, robot, file)


@pytest.mark.slow
def test_a_part_that_stood_elsewhere_is_asked_about_and_a_true_one_is_not(equipment: tuple[Job, Robot, Path]) -> None:
    """Off by .3 and -.15 mm and .06 degrees, more than robot and force explain: who measured has to say."""
    job, robot, folder = equipment
    points, s = measure(job)
    moved = turned(points, 0.06) + np.array([0.3, -0.15, 0.0])
    files = [
        write_points(folder / f"{name}.csv", "x_mm,y_mm,z_mm,s_mm", np.column_stack([p, s]))
        for name, p in (("moved", moved), ("true", points))
    ]
    asked = r"moved\.csv:1: .* shift of the whole part by \[0\.2[5-9].*clamped elsewhere\?.*part_frame_mm"
    with pytest.raises(InputError, match=asked):
        learn_from_part(job, robot, files[0])
    model_update = learn_from_part(job, robot, files[0], align="datum")
    assert any(
        "of the whole part" in note and "learned as an error of the robot" in note for note in model_update.notes
    )
    assert not any("of the whole part" in note for note in learn_from_part(job, robot, files[1]).notes)


@pytest.mark.parametrize("tilt", [0.0, 0.002])
def test_a_turn_that_was_not_measured_is_not_reported(tilt: float) -> None:
    """Points across a circle of 5 mm, shifted by 26 um: nothing tells a turn about its axis or of its plane.

    Directions across that are off by some milliradians do not tell it either, where the part is out of round.
    """
    random, angle = np.random.default_rng(0), np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    turned = angle + tilt * np.cos(2.0 * angle)
    along = np.column_stack([-np.sin(turned), np.cos(turned), 0.0 * angle])
    across = np.eye(3) - along[:, :, None] * along[:, None]
    off = np.einsum("bij,bj->bi", across, [2.6e-5, 0.0, 0.0] + 5e-6 * random.standard_normal((60, 3)))
    out = np.column_stack([along[:, 1], -along[:, 0], 0.0 * angle])
    off += 0.005 * tilt * np.cos(2.0 * angle)[:, None] * out
    gathered = Gathered(np.arange(60), off, across, np.full(60, 25e-12), np.ones(60, int))
    tip = 0.005 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    noise = 25e-12 * np.eye(180)
    said, beyond = describe_whole(gathered, tip, np.eye(3), noise)
    turn = float(said.rpartition("a turn of ")[2].removesuffix(" deg"))
    assert "by [0.02" in said and ", 0] mm" in said and turn < 0.001 and beyond
    shift = np.tile(np.eye(3), (60, 1))  # a robot that may shift the whole part by .02 mm explains it
    assert describe_whole(gathered, tip, np.eye(3), noise + 4e-10 * shift @ shift.T) == (said, False)


@pytest.mark.parametrize("counted", [np.diag([0.0, 0.0, 1.0]), np.diag([0.0, 1.0, 1.0])])
def test_an_alignment_is_reported_in_what_its_points_determine(counted: Array) -> None:
    """Points along x, measured upwards or across: off by .05 mm along z, and of the rest nothing is said."""
    tip, random = np.column_stack([np.linspace(-0.1, 0.1, 60), np.zeros((60, 2))]), np.random.default_rng(1)
    off = ([0.0, 0.0, 5e-5] + 2e-6 * random.standard_normal((60, 3))) @ counted
    gathered = Gathered(np.arange(60), off, np.tile(counted, (60, 1, 1)), np.full(60, 4e-12), np.ones(60, int))
    said, beyond = describe_whole(gathered, tip, np.eye(3), 4e-12 * np.eye(180))
    assert "by [0, " in said and ", 0.05] mm" in said and "a turn of 0 deg" in said and beyond
