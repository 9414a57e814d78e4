"""Stops, turns on the spot, single moves and weights: what the timing of a run makes of them, in closed form."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from compplan.planning.timing import FULL_USE, _turn_in_place, state_timing, time_command
from compplan.statics.chain import build_chain, locate_frames
from compplan.toolpath.toolpath import select_waypoints
from tests.planning.test_feed import ROBOT, arc_path, make_task


@pytest.mark.parametrize("rows", [2, 6])
def test_a_turn_on_the_spot_takes_what_its_joint_needs_and_a_tenth_more(rows: int) -> None:
    """Joint 6 turns about the tool axis, so that the tip stays: 1.875 d / T is the greatest speed of a gentle move."""
    q = np.tile(np.radians([10.0, 20, -100, 15, 40, 0]), (rows, 1))
    q[:, 5] = np.linspace(0.0, 1.2, rows)
    task = still_task(velocity=2.0, acceleration=1e6, feed=0.02)
    assert np.ptp(locate_frames(task.chain, q).tcp_position, axis=0).max() < 1e-12
    assert _turn_in_place(task, q, 0)[-1] == pytest.approx(1.1 * 1.875 * 1.2 / (FULL_USE * 2.0), rel=1e-9)
    hurried = still_task(velocity=1e6, acceleration=3.0, feed=0.02)
    assert _turn_in_place(hurried, q, 0)[-1] == pytest.approx(1.1 * np.sqrt(5.774 * 1.2 / (FULL_USE * 3.0)), rel=1e-9)


def test_a_commanded_tip_that_moves_on_the_spot_keeps_to_the_feed() -> None:
    q = np.tile(np.radians([0.0, 20, -100, 15, 40, 0]), (5, 1))
    q[:, 0] = np.linspace(0.0, 0.02, 5)
    task = still_task(velocity=2.0, acceleration=1e6, feed=0.01)
    tip = locate_frames(task.chain, q[:1]).tcp_position[0]
    chord = 2 * np.sin(0.01) * np.hypot(tip[0], tip[1])
    assert _turn_in_place(task, q, 0)[-1] == pytest.approx(1.875 * chord / 0.01, rel=1e-9)


def still_task(velocity: float, acceleration: float, feed: float):
    """What the timing of a turn asks of a task."""
    return SimpleNamespace(
        velocity_limits=np.full(6, velocity), acceleration_limits=np.full(6, acceleration),
        nominal=SimpleNamespace(feed=np.full(10, feed)), chain=build_chain(ROBOT), gentle_time=0.0,
    )  # fmt: skip


def test_a_rest_within_a_cut_ends_one_run_and_begins_another() -> None:
    task = make_task(arc_path(0.3, 0.05, 60))
    through = time_command(task, task.q_start)
    rests = np.zeros(len(task), bool)
    rests[30] = True
    stopped = time_command(replace(task, rests=rests), task.q_start)
    half = make_task(select_waypoints(arc_path(0.3, 0.05, 60), np.arange(31)))
    alone = time_command(half, half.q_start)
    assert stopped.time[30] == pytest.approx(alone.time[-1], rel=1e-3)
    assert stopped.time[-1] - through.time[-1] > 1e-3


def test_where_inertia_counts_no_acceleration_sets_in_faster_than_within_half_a_window() -> None:
    task = make_task(arc_path(0.05, 0.05, 600))
    length, ends, jolts, pushes = np.r_[0.0, np.cumsum(task.nominal.steps)], [], [], []
    for inertia in (False, True):
        time = time_command(replace(task, inertia=inertia), task.q_start).time
        push = np.diff(np.diff(length) / np.diff(time)) / (0.5 * (time[2:] - time[:-2]))
        ends.append(time[-1])
        pushes.append(np.abs(push).max())
        jolts.append(np.abs(np.diff(push) / np.diff(time[1:-1])).max())
    assert jolts[1] < 2.0 * pushes[0] / task.smoothing < jolts[0]
    assert 0.0 < ends[1] - ends[0] < (1.0 + 0.5) * task.smoothing  # two further windows


def test_feeds_of_a_run_are_length_over_time_and_the_first_waypoint_has_that_of_the_first_move() -> None:
    task = make_task(arc_path(0.3, 0.05, 60))
    length = task.nominal.steps[0]
    slow = state_timing(task, task.q_start, np.arange(60) * length / 0.02)
    assert slow.feed[1:] == pytest.approx(np.full(59, 0.02))
    assert slow.share == pytest.approx(np.full(60, 0.4)) and slow.lowered.all()
    mean = np.diff(task.q_start, axis=0) * 0.02 / length
    assert slow.velocity[30] == pytest.approx(0.5 * (mean[29] + mean[30]))
    assert slow.acceleration[30] == pytest.approx((mean[30] - mean[29]) * 0.02 / length)
