"""Limits, rapid moves and smoothness of a command, each with an answer that is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.planning.strategies import command_path
from compplan.planning.strategies.limits import OUT_OF_REACH, check_limits, measure_correction, name_failures
from compplan.planning.strategies.mirror import mirror_deviation
from compplan.statics.chain import locate_frames
from compplan.statics.sensitivity import attain_pose
from tests.planning.test_strategies import make_path, make_task


def test_each_limit_alone_makes_a_command_infeasible_and_is_named() -> None:
    task = make_task(path=make_path(8))
    q, every = task.q_start, np.arange(len(task))
    assert (check_limits(task, q).status, check_limits(task, q).failures) == ("solved", {})
    missed = check_limits(replace(task, missed=every == 5), q)
    assert (missed.status, missed.failures) == ("infeasible", {5: OUT_OF_REACH})
    for side, joint, change in (("lower", 2, task.robot.lower), ("upper", 4, task.robot.upper)):
        beyond = q.copy()
        beyond[3, joint] = change[joint] + (-1e-6 if side == "lower" else 1e-6)
        left = check_limits(replace(task, missed=every < 0, max_correction=10.0), beyond)
        assert left.status == "infeasible" and f"{side} position limit of joint_{joint + 1}" in left.failures[3]
    for side, stop in (("lower", task.robot.lower), ("upper", task.robot.upper)):
        standing = q.copy()
        standing[2] = 0.5 * (task.robot.lower + task.robot.upper)
        standing[2, 4] = stop[4]
        assert name_failures(replace(task, max_correction=1e3), standing, np.array([2])) == {
            2: f"{side} position limit of joint_5"
        }
    aside = q.copy()
    aside[6, 0] += 0.01
    far = replace(task, max_correction=0.5 * float(measure_correction(task, aside)[6]))
    assert check_limits(far, aside).failures == {6: "correction limit"}
    assert not check_limits(replace(far, compensated=every != 6), aside).failures


def test_the_correction_is_the_way_of_the_unloaded_tip_from_the_path() -> None:
    task = make_task(path=make_path(5))
    aside = task.q_start + np.array([2e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
    # the first axis stands upright through the origin: the tip goes along a circle about it, seen as its chord
    chord = 2 * np.sin(1e-3) * np.hypot(task.position[:, 0], task.position[:, 1])
    assert measure_correction(task, aside) == pytest.approx(chord, abs=2e-9)


def test_a_mirror_leaves_rapid_moves_where_they_are() -> None:
    path = make_path(12)
    path = replace(path, rapid=np.arange(12) >= 8, wrench=path.wrench * (np.arange(12) < 8)[:, None])
    task = make_task(path=path)
    frames = locate_frames(task.chain, task.q_start)
    cut = task.compensated
    assert cut[:8].any() and not cut[-4:].any()
    _, wanted, turned, worst = mirror_deviation(task, task.q_start, frames.tcp_position, frames.tcp_rotation)
    assert np.array_equal(wanted[~cut], frames.tcp_position[~cut])
    assert turned[~cut] == pytest.approx(frames.tcp_rotation[~cut])
    bend = attain_pose(task.chain, task.q_start, task.wrench).position - task.position
    assert wanted[cut] == pytest.approx((frames.tcp_position - bend)[cut], abs=1e-12)
    assert worst == pytest.approx(np.linalg.norm(bend[cut], axis=1).max(), rel=1e-9) and worst > 1e-4


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_limit_that_the_solution_would_leave_is_kept_by_the_redundancy(side: str) -> None:
    """The limit lies far enough from the start that the first pass does not bound it, and inside the free solution."""
    task = make_task(path=make_path(16), spin_free=True)
    free = command_path(task, "nlp").q
    joint, sign = 5, 1.0 if side == "upper" else -1.0
    extreme = float((sign * free[:, joint]).max())
    bound = sign * (extreme - 2e-3)
    narrow = [replace(j, **{side: bound}) if j.name == task.robot.joint_names[joint] else j for j in task.robot.joints]
    limited = replace(task, robot=replace(task.robot, joints=tuple(narrow)))
    command = command_path(limited, "nlp")
    assert command.status == "solved"
    assert (sign * command.q[:, joint]).max() <= sign * bound + 1e-9 < extreme


def test_a_motion_that_was_chosen_is_kept_where_nothing_bends() -> None:
    task = make_task(path=make_path(30, force=np.zeros(6)), spin_free=True)
    assert np.abs(command_path(task, "nlp").q - task.q_start).max() < 1e-9
