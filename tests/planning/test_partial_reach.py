"""Where a path leads out of reach: what is kept and what stops it; seven axes go on from the job's start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.job.job import Job, check_job
from compplan.planning.approach import plan_approach
from compplan.planning.dense import STATIONS
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.posture.follow import follow_path
from compplan.planning.strategies import command_path
from compplan.planning.task import OUT_OF_REACH
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.ik import build_arm, reach_tip_and_axis
from compplan.toolpath.toolpath import Toolpath

pytestmark = pytest.mark.usefixtures("graph_alone")

START = np.radians([0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])


def rail_job(folder: Path) -> Job:
    """Return a line of 6.5 m along the rail of 4 m; it leaves the arm's reach at its far end."""
    rows = [f"0,{value:.3f},0,0,0,1,100" for value in np.linspace(1000.0, 7500.0, 30)]
    (folder / "line.csv").write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_s\n" + "\n".join(rows) + "\n")
    table = {
        "schema": 1, "robot": "kuka_kr240_rail", "toolpath": "line.csv", "part": {"position_mm": [1900.0, 0.0, 700.0]},
        "process": {"model": "constant", "force_N": [-300.0, 200.0, 400.0]},
        "tool": {"position_mm": [200.0, 0.0, 0.0], "rotation_deg": [0.0, 90.0, 0.0], "mass_kg": 5.0},
        "sampling": {"max_step_mm": 1000.0},
    }  # fmt: skip
    return check_job(table, folder / "job.toml")


def test_the_stretch_within_reach_is_kept_and_the_first_row_beyond_is_named_with_what_stops_it(tmp_path: Path) -> None:
    task = build_task(*prepare_job(rail_job(tmp_path)))
    failing = np.flatnonzero(task.missed)
    assert np.array_equal(failing, np.arange(failing[0], len(task)))  # one stretch, up to the end
    first = task.origin[failing[0]]
    assert 19 < first < 26
    kept = ~task.missed
    tips = locate_frames(task.chain, task.q_start[kept]).tcp_position
    assert np.abs(tips - task.position[kept]).max() < 1e-6
    assert np.ptp(task.q_start[kept, 0]) > 2.0  # the rail goes along
    stood = task.rotation[failing[0] - 1]  # beyond, the tool stays turned as it was
    assert task.rotation[failing] == pytest.approx(np.tile(stood, (len(failing), 1, 1)), abs=1e-9)
    sentence = " ".join(task.start.notes)
    assert len(sentence) <= 300 and task.start.cause in sentence
    assert f"the first is {np.ceil(first):.0f} " in sentence and "upper position limit of joint_1" in sentence
    command = command_path(task, "nlp")
    assert set(command.failures) >= set(failing.tolist()) and min(command.failures) >= failing[0] - 1


def test_seven_axes_go_on_from_the_jobs_start() -> None:
    robot = load_robot("franka_fr3")
    table = {
        "schema": 1, "robot": "franka_fr3", "part": {"position_mm": [500.0, 150.0, 400.0]},
        "toolpath": {"generator": "circle", "radius_mm": 150.0, "waypoints": 60, "feed_mm_s": 50.0},
        "process": {"model": "constant", "force_N": [0.0, 0.0, 20.0]},
        "plan": {"start_deg": np.degrees(START).tolist()},
    }  # fmt: skip
    task = build_task(*prepare_job(check_job(table, Path("seven.toml"))))
    assert not task.missed.any()
    assert np.degrees(np.abs(np.diff(task.q_start, axis=0)).max()) < 5.0
    command = command_path(task, "nlp")
    assert command.status == "solved"
    assert ((command.q >= robot.lower) & (command.q <= robot.upper)).all()


def test_following_reaches_every_waypoint_by_small_steps_and_says_where_it_cannot() -> None:
    robot = load_robot("franka_fr3")
    chain, arm = build_chain(robot), build_arm(robot)
    here = locate_frames(chain, START[None])
    angle = np.linspace(0.0, 2 * np.pi, 90)
    position = here.tcp_position + 0.1 * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=1)
    rotation = np.tile(here.tcp_rotation, (90, 1, 1))
    nominal = Toolpath(position, -rotation[:, :, 2], np.full(90, 0.05), np.zeros(90, bool), frame="base")
    for free in (True, False):
        q, missed = follow_path(arm, nominal, rotation, spin_free=free, most_step=0.3, start=START)
        frames = locate_frames(chain, q)
        assert not missed.any()
        assert np.abs(frames.tcp_position - position).max() < 1e-8
        assert np.abs(frames.tcp_rotation[:, :, 2] - rotation[:, :, 2]).max() < 1e-8
        assert np.abs(np.diff(q, axis=0)).max() < 0.1
    far = position + np.array([2.0, 0.0, 0.0])
    q, reached = reach_tip_and_axis(arm, np.tile(START, (90, 1)), far, rotation, every_joint=True)
    assert not reached.any() and ((q >= robot.lower) & (q <= robot.upper)).all()


@pytest.mark.parametrize("width", [2e-4, 5e-3])
def test_lost_motion_is_never_called_the_reach_of_the_arm(width: float) -> None:
    table = {
        "schema": 1, "robot": "kuka_kr270", "part": {"position_mm": [1700.0, 0.0, 700.0]},
        "toolpath": {"generator": "circle", "radius_mm": 150.0, "waypoints": 24, "feed_mm_s": 50.0},
        "process": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
    }  # fmt: skip
    robot, nominal, options = prepare_job(check_job(table, Path("worn.toml")))
    lost = {"effect": "backlash", "joint": robot.joint_names[0], "parameters": {"width_rad": width}}
    worn = replace(robot, effects=(lost,))
    command = command_path(build_task(worn, nominal, options), "nlp")
    assert not any(OUT_OF_REACH in name for name in command.failures.values())


def test_a_point_metres_away_is_named_by_few_stations(tmp_path) -> None:
    rows = [f"{x},0,{5000 * (x == 100)},0,0,1,50" for x in range(0, 220, 20)]
    (tmp_path / "far.csv").write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_s", *rows]), encoding="utf-8")
    table = {
        "schema": 1, "robot": "kuka_kr270", "part": {"position_mm": [1500.0, 0.0, 700.0]}, "toolpath": "far.csv",
        "process": {"model": "constant", "force_N": [50.0, 20.0, 100.0]}, "sampling": {"max_step_mm": 20.0},
    }  # fmt: skip
    task = build_task(*prepare_job(check_job(table, tmp_path / "far.toml")))
    command = command_path(task, "nlp")
    assert task.missed.sum() > 2 * STATIONS and command.nlp["stations"] < 3 * STATIONS
    assert set(command.failures) <= set(np.flatnonzero(task.missed))


def test_rows_of_the_approach_say_where_the_tool_goes() -> None:
    table = {
        "schema": 1, "robot": "kuka_kr270", "part": {"position_mm": [1700.0, 0.0, 700.0]},
        "toolpath": {"generator": "circle", "radius_mm": 150.0, "waypoints": 30, "feed_mm_s": 50.0},
        "process": {"model": "constant", "force_N": [0.0, 0.0, 0.0]},
    }  # fmt: skip
    task = build_task(*prepare_job(check_job(table, Path("free.toml"))))
    way = plan_approach(task, task.q_start)
    tips = locate_frames(task.chain, way.q).tcp_position
    straight = np.linspace(way.position[0], task.position[0], 50)
    assert np.abs(way.position - tips).max() < 1e-9
    gap = np.linalg.norm(way.position[:, None] - straight[None], axis=2).min(axis=1)
    assert gap.max() > 1e-5  # a joint move bows: a straight line would not be true
