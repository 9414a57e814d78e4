"""Limits of jerk and torque: closed forms, and runs that hold them when they are sampled every millisecond."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.limits import sample_use
from compplan.controllers.readback.joint_table import read_joints
from compplan.planning.checks import _check_jerk
from compplan.planning.feed import FeedRequest, time_run
from compplan.planning.motion_limits import TorqueRules, describe_jerk, measure_smooth_use
from compplan.planning.task import cutting_runs
from compplan.planning.timing import ease, ease_times, find_slowdown, time_command, time_cut
from compplan.robot import Array
from tests.planning.test_feed import ROBOT, arc_path, make_task, square_path

NONE = np.array([1e12])


def test_a_gentle_move_uses_what_its_polynomial_says() -> None:
    """q = d (10 u^3 - 15 u^4 + 6 u^5): 1.875 d / T, 5.774 d / T^2 and 60 d / T^3 at most."""
    place, distance, duration = ease(np.linspace(0.0, 1.0, 2001)), 0.7, 1.4
    q, time = distance * place[:, None], ease_times(place, duration)
    for limits, most in (
        ((np.array([0.5]), NONE, None), 1.875 * distance / duration / 0.5),
        ((NONE, np.array([0.5]), None), np.sqrt(5.774 * distance / duration**2 / 0.5)),
        ((NONE, NONE, np.array([5.0])), np.cbrt(60.0 * distance / duration**3 / 5.0)),
    ):
        assert measure_smooth_use(q, time, *limits)[1:-1].max() == pytest.approx(most, rel=5e-3)


def test_an_acceleration_that_is_there_at_once_is_a_jerk() -> None:
    time = np.linspace(0.0, 1.0, 101)
    q = 0.5 * 0.2 * time[:, None] ** 2 * (1.0 - time[:, None]) ** 2  # begins with 0.2 rad/s^2
    use = measure_smooth_use(q, time, NONE, NONE, np.array([40.0]))
    assert use[0] == pytest.approx(np.sqrt(0.2 / 1e-3 / 40.0), rel=1e-3)


@pytest.mark.parametrize("after", [0.05, 0.4])
def test_a_run_with_corners_holds_its_limits_at_every_millisecond(after: float) -> None:
    task = make_task(square_path(feed=0.4))
    task = replace(task, rests=np.zeros(len(task), bool), jerk_limits=ROBOT.acceleration_limits / after)
    free = time_command(replace(task, jerk_limits=None), task.q_start)
    held = time_command(task, task.q_start)
    use = sample_use(task.q_start, held.time, cutting_runs(task.nominal.rapid), *_limits(task))
    assert max(use.values()) <= 1.001
    loose = sample_use(task.q_start, free.time, cutting_runs(task.nominal.rapid), *_limits(task))
    assert loose["jerk"] > 1.2 and held.time[-1] > free.time[-1]
    assert find_slowdown(task, task.q_start, held.time).max() == 1.0


def test_a_run_that_has_to_stand_still_on_its_way_is_timed_within_its_jerk(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop_halfway(*words: Any, **more: Any) -> Any:
        found = time_cut(*words, **more)
        found[len(found) // 2] = 0.0
        return found

    task = make_task(arc_path(0.3, 1.2, 120))
    task = replace(task, jerk_limits=ROBOT.acceleration_limits / 0.1)
    monkeypatch.setattr("compplan.planning.timing.time_cut", stop_halfway)
    held = time_command(task, task.q_start)
    assert np.isfinite(held.time).all() and (np.diff(held.time) >= 0.0).all()
    assert measure_smooth_use(task.q_start, held.time, *_limits(task)).max() < 1.001


def test_limits_that_a_run_does_not_reach_change_nothing() -> None:
    task = make_task(arc_path(0.3, 0.02))
    wide = replace(task, jerk_limits=np.full(6, 1e5))
    assert np.array_equal(time_command(task, task.q_start).time, time_command(wide, task.q_start).time)


def test_torques_are_held_by_the_timed_run_in_an_engine_of_another() -> None:
    task = make_task(arc_path(0.3, 1.5, 200))
    still = np.abs(TorqueRules(ROBOT, task.q_start, task.wrench).held).max(axis=0)
    weak = {name: float(1.08 * still[k] + 4.0) for k, name in enumerate(ROBOT.joint_names)}
    joints = tuple(replace(j, effort=weak.get(j.name, j.effort)) for j in ROBOT.joints)
    task = replace(task, robot=replace(ROBOT, joints=joints))
    uses = []
    for torque in (False, True):
        timing = time_run(task, task.q_start, FeedRequest(torque=torque))[1]
        use = sample_use(
            task.q_start, timing.time, cutting_runs(task.nominal.rapid), *_limits(task),
            arm=ROBOT.folder, effort=np.array(list(weak.values())), wrench=task.wrench,
        )  # fmt: skip
        uses.append(use["torque"])
    assert uses[0] > 1.01 and uses[1] <= 1.001


def _limits(task) -> tuple[Array, Array, Array | None]:
    return task.velocity_limits, task.acceleration_limits, task.jerk_limits


@pytest.mark.parametrize("wrong", [False, True])
def test_the_check_of_a_plan_finds_a_jerk_beyond_the_limit(wrong: bool) -> None:
    task = make_task(square_path(feed=0.4))
    limits = ROBOT.acceleration_limits / 0.4
    task = replace(task, rests=np.zeros(len(task), bool))
    held = time_command(replace(task, jerk_limits=None if wrong else limits), task.q_start)
    joints = replace(read_joints(ROBOT.folder), jerk=limits)
    found = [check for check in _check_jerk(task, task.q_start, held.time, joints) if check.fails]
    assert bool(found) == wrong and all("jerks" in check.sentence for check in found)
    assert "jerk_limits of the robot folder" in describe_jerk(replace(ROBOT, jerk_limits=limits))
    assert not describe_jerk(ROBOT)
