"""A rail moves in strokes worth the name, never back and forth in its lost motion; joints are weighed by the tip."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.effects.transmission_error import LEAST, MOST, weigh_joints
from compplan.job.job import Job, check_job
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.strategies import command_path
from compplan.robot import Array, load_robot
from compplan.statics.chain import build_chain


def strokes(positions: Array) -> Array:
    """Return the ways between reversals, those at the ends left out."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(positions)[np.diff(positions) != 0])))
    moved = positions[np.r_[True, np.diff(positions) != 0]]
    return np.abs(np.diff(moved[turns + 1]))


def make_job(strategy: str) -> Job:
    """Return a cone formed on the arm with a rail."""
    table = {
        "schema": 1, "robot": "kuka_kr240_rail", "part": {"position_mm": [1800.0, 2000.0, 600.0]},
        "toolpath": {"generator": "isf_cone", "diameter_mm": 400.0, "depth_mm": 60.0, "wall_angle_deg": 60.0,
                     "pitch_mm": 20.0, "feed_mm_s": 60.0, "step_mm": 30.0},
        "process": {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"},
        "plan": {"strategy": strategy},
    }  # fmt: skip
    return check_job(table, Path("rail.toml"))


@pytest.mark.parametrize("strategy", [pytest.param("nlp", marks=pytest.mark.slow), "iterated_mirror"])
def test_no_strategy_moves_the_rail_for_a_correction(strategy: str) -> None:
    task = build_task(*prepare_job(make_job(strategy)))
    command = command_path(task, strategy)
    assert command.status == "solved"
    assert np.array_equal(command.q[:, 0], task.q_start[:, 0])
    assert np.abs(command.q[:, 1:] - task.q_start[:, 1:]).max() > 1e-5  # the arm corrects
    moved = strokes(command.q[:, 0])
    assert not len(moved) or moved.min() >= 1e-3


def test_a_joint_weighs_by_its_lever_and_its_lost_motion() -> None:
    robot = load_robot("kuka_kr270")
    q = np.tile(np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0]), (3, 1))
    weight = weigh_joints(build_chain(robot), q, robot)
    assert weight[0] > weight[3] and weight.min() >= LEAST and weight.max() <= MOST
    worn = replace(robot, effects=({"effect": "backlash", "joint": "joint_4", "parameters": {"width_rad": 2e-3}},))
    assert weigh_joints(build_chain(worn), q, worn)[3] > weight[3]
