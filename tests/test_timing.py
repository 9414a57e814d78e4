"""Timing: closed forms of rapid moves and cuts, and limits that are kept."""

import numpy as np
import pytest

from compplan.plan.timing import time_cut, time_rapids


def times(along, speed):
    return np.r_[0.0, np.cumsum(2 * np.diff(along) / (speed[1:] + speed[:-1]))]


def test_a_short_rapid_move_is_a_triangle_and_a_long_one_a_trapezoid():
    velocity, acceleration = np.array([2.0, 1.0]), np.array([4.0, 4.0])
    spent = time_rapids(np.array([[0.25, 0.0], [3.0, 0.1], [0.0, 0.0]]), velocity, acceleration)
    assert spent == pytest.approx([2 * np.sqrt(0.25 / 4.0), 3.0 / 2.0 + 2.0 / 4.0, 0.0])


def test_a_straight_cut_of_one_joint_is_as_fast_as_a_trapezoid_may_be():
    along = np.linspace(0.0, 1.0, 2001)
    rate, _, speed, _ = time_cut(along, 3.0 * along[:, None], np.array([1.5]), np.array([2.0]))
    assert rate == pytest.approx(3.0)
    assert times(along, speed)[-1] == pytest.approx(3.0 / 1.5 + 1.5 / 2.0, rel=1e-3)
    assert speed.max() == pytest.approx(0.5)


def test_the_programmed_feed_is_the_upper_bound():
    along = np.linspace(0.0, 2.0, 801)
    _, _, speed, _ = time_cut(along, 0.1 * along[:, None], np.array([10.0]), np.array([10.0]))
    assert speed.max() == pytest.approx(1.0)
    assert times(along, speed)[-1] == pytest.approx(2.0 + 0.1 / 10.0, rel=1e-3)


def test_no_rate_limit_is_left_on_a_winding_path():
    rng = np.random.default_rng(0)
    along = np.linspace(0.0, 4.0, 1500)
    q = sum(np.outer(np.sin(k * along + rng.uniform(0, 6)), rng.normal(size=6)) / k for k in range(1, 6))
    velocity, acceleration = np.full(6, 1.0), np.full(6, 3.0)
    rate, change, speed, push = time_cut(along, q, velocity, acceleration)
    attained = rate * speed[:, None]
    assert np.abs(attained).max() <= 1.0 + 1e-6
    assert np.abs(change * speed[:, None] ** 2 + rate * push[:, None]).max() <= 3.0 * 1.02
    assert max(np.abs(attained).max(), np.abs(change[1:-1] * speed[1:-1, None] ** 2).max() / 3.0) > 0.9


def test_a_corner_is_taken_slowly():
    along = np.linspace(0.0, 2.0, 1001)
    q = np.column_stack([np.minimum(along, 1.0), np.maximum(along - 1.0, 0.0)])
    _, _, speed, _ = time_cut(along, q, np.full(2, 10.0), np.full(2, 5.0))
    corner = speed[495:506].min()
    assert corner < 0.15 < 0.9 < speed[200]


def test_velocity_limits_alone_do_where_no_acceleration_limit_is_known():
    along = np.linspace(0.0, 1.0, 301)
    _, _, speed, _ = time_cut(along, 4.0 * along[:, None], np.array([2.0]), np.array([np.inf]))
    assert speed[150] == pytest.approx(0.5)
    assert times(along, speed)[-1] == pytest.approx(2.0, rel=1e-2)
