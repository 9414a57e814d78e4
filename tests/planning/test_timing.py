"""Timing: closed forms of rapid moves and cuts, and limits that are kept."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from compplan.planning.fixed_point import _moving_feed
from compplan.planning.motion_limits import measure_use, spread_factors
from compplan.planning.timing import find_slowdown, overlap_legs, time_cut, time_rapids
from tests.oracles.forces import DrivenRows, _speeds


def times(along, speed):
    return np.r_[0.0, np.cumsum(2 * np.diff(along) / (speed[1:] + speed[:-1]))]


def differentiate(along, q):
    curve = CubicSpline(along, q, bc_type="natural")
    return curve(along, 1), curve(along, 2)


def test_a_short_rapid_move_is_a_triangle_and_a_long_one_a_trapezoid():
    velocity, acceleration = np.array([2.0, 1.0]), np.array([4.0, 4.0])
    spent = time_rapids(np.array([[0.25, 0.0], [3.0, 0.1], [0.0, 0.0]]), velocity, acceleration)
    assert spent == pytest.approx([2 * np.sqrt(0.25 / 4.0), 3.0 / 2.0 + 2.0 / 4.0, 0.0])


def test_a_straight_cut_of_one_joint_is_as_fast_as_a_trapezoid_may_be():
    along = np.linspace(0.0, 1.0, 2001)
    speed = time_cut(along, 3.0 * along[:, None], np.array([1.5]), np.array([2.0]))
    assert times(along, speed)[-1] == pytest.approx(3.0 / 1.5 + 1.5 / 2.0, rel=1e-3)
    assert speed.max() == pytest.approx(0.5)


def test_the_programmed_feed_is_the_upper_bound():
    along = np.linspace(0.0, 2.0, 801)
    speed = time_cut(along, 0.1 * along[:, None], np.array([10.0]), np.array([10.0]))
    assert speed.max() == pytest.approx(1.0)
    assert times(along, speed)[-1] == pytest.approx(2.0 + 0.1 / 10.0, rel=1e-3)


def test_no_rate_limit_is_left_on_a_winding_path():
    rng = np.random.default_rng(0)
    along = np.linspace(0.0, 4.0, 1500)
    q = sum(np.outer(np.sin(k * along + rng.uniform(0, 6)), rng.normal(size=6)) / k for k in range(1, 6))
    velocity, acceleration = np.full(6, 1.0), np.full(6, 3.0)
    speed, (rate, change) = time_cut(along, q, velocity, acceleration), differentiate(along, q)
    push = np.r_[0.5 * np.diff(speed**2) / np.diff(along), 0.0]
    attained = rate * speed[:, None]
    assert np.abs(attained).max() <= 1.0 + 1e-6
    assert np.abs(change * speed[:, None] ** 2 + rate * push[:, None]).max() <= 3.0 * 1.02
    assert max(np.abs(attained).max(), np.abs(change[1:-1] * speed[1:-1, None] ** 2).max() / 3.0) > 0.9


def _run_toppra(along, q, velocity, acceleration, torques):
    """Return the share of the feed that TOPP-RA finds, torques a u + b x + c within their limits."""
    import toppra
    from toppra import algorithm, constraint
    from toppra.constraint.linear_constraint import LinearConstraint, canlinear_colloc_to_interpolate

    curve = CubicSpline(along, q, bc_type="natural")
    a, b, c, most = torques

    class Path:
        dof, path_interval, duration = q.shape[1] + 1, np.array([along[0], along[-1]]), along[-1] - along[0]

        def __call__(self, s, order=0):
            last = np.atleast_1d(s)[:, None] if order == 0 else np.full((np.size(s), 1), 1.0 if order == 1 else 0.0)
            return np.hstack([np.atleast_2d(curve(np.atleast_1d(s), order)), last])

    class Torques(LinearConstraint):
        def __init__(self):
            super().__init__()
            self.dof, self.identical = q.shape[1] + 1, True
            self.set_discretization_type(toppra.constraint.DiscretizationType.Interpolation)

        def compute_constraint_params(self, path, gridpoints):
            both = np.vstack([np.eye(a.shape[1]), -np.eye(a.shape[1])])
            limits = np.r_[most, most]
            return canlinear_colloc_to_interpolate(a, b, c, both, limits, None, None, gridpoints, identical=True)

    wide = np.column_stack([-np.r_[velocity, 1.0], np.r_[velocity, 1.0]])
    push = np.column_stack([-np.r_[acceleration, 1e4], np.r_[acceleration, 1e4]])
    scheme = toppra.constraint.DiscretizationType.Interpolation
    rules = [constraint.JointVelocityConstraint(wide), Torques(),
             constraint.JointAccelerationConstraint(push, discretization_scheme=scheme)]  # fmt: skip
    found = algorithm.TOPPRA(rules, Path(), gridpoints=along, solver_wrapper="seidel")
    return found.compute_parameterization(0.0, 0.0)[1]


@pytest.mark.parametrize("seed", range(4))
def test_topp_ra_finds_the_same_run(seed):
    rng = np.random.default_rng(seed)
    along = np.r_[0.0, np.cumsum(rng.uniform(0.005, 0.02, 250))]
    swing, pace, phase = rng.uniform(0.05, 1.0, 6), rng.uniform(0.5, 8.0, 6), rng.uniform(0.0, 6.0, 6)
    q = swing * np.sin(along[:, None] * pace + phase)
    velocity, acceleration = rng.uniform(1.0, 3.0, 6), rng.uniform(3.0, 10.0, 6)
    inertia, held = rng.uniform(5.0, 20.0, 6), 10.0 * np.sin(q)

    def torques(rate, change):
        return inertia * rate, inertia * change, held, np.full(6, 25.0)

    speed, (rate, change) = time_cut(along, q, velocity, acceleration, torques), differentiate(along, q)
    theirs = _run_toppra(along, q, velocity, acceleration, torques(rate, change))
    assert np.percentile(np.abs(speed - theirs), 95) < 1e-5 and speed[1:-1].min() < 0.9
    assert times(along, speed)[-1] == pytest.approx(times(along, theirs)[-1], rel=1e-4)
    free = times(along, time_cut(along, q, velocity, acceleration))[-1]
    assert times(along, speed)[-1] > 1.01 * free


def test_a_corner_is_taken_slowly():
    along = np.linspace(0.0, 2.0, 1001)
    q = np.column_stack([np.minimum(along, 1.0), np.maximum(along - 1.0, 0.0)])
    speed = time_cut(along, q, np.full(2, 10.0), np.full(2, 5.0))
    corner = speed[495:506].min()
    assert corner < 0.15 < 0.9 < speed[200]


def test_velocity_limits_alone_do_where_no_acceleration_limit_is_known():
    along = np.linspace(0.0, 1.0, 301)
    speed = time_cut(along, 4.0 * along[:, None], np.array([2.0]), np.array([np.inf]))
    assert speed[150] == pytest.approx(0.5)
    assert times(along, speed)[-1] == pytest.approx(2.0, rel=1e-2)


def fall(steps):
    """Times, and a joint that speeds up by 2 rad/s every second from rest."""
    time = np.r_[0.0, np.cumsum(steps)]
    return time, time[:, None] ** 2


def test_a_run_is_too_fast_by_the_root_of_its_acceleration_or_by_its_speed_whatever_its_steps():
    time, q = fall([0.1, 0.3, 0.2, 0.4, 0.1])
    # twice as slow is a quarter of the acceleration: 2 rad/s^2 against 0.5 are too fast by 2
    use = measure_use(q, time, np.array([100.0]), np.array([0.5]))
    assert use[:-1] == pytest.approx(np.full(5, 2.0))
    # it stops at the last waypoint, from 2.1 rad/s within half of the last step: 42 rad/s^2
    assert use[-1] == pytest.approx(np.sqrt(42.0 / 0.5))
    # mean speeds 0.1, 0.5, 1.0, 1.6, 2.1 rad/s against 0.5, on either side of a waypoint the greater one
    use = measure_use(q, time, np.array([0.5]), np.array([1e9]))
    assert use == pytest.approx([0.2, 1.0, 2.0, 3.2, 4.2, 4.2])


def test_what_is_too_fast_is_slowed_down_within_reach_in_time_and_the_greatest_of_a_group_counts():
    time = np.r_[0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.9, 1.0, 1.1]
    use = np.array([0.5, 0.5, 0.9, 1.2, 1.5, 0.9, 0.9, 0.9, 1.1])
    assert spread_factors(use, time, 0.15) == pytest.approx([1, 1, 1.5, 1.5, 1.5, 1.5, 1, 1.1, 1.1])
    assert spread_factors(0.5 * use, time, 0.15) == pytest.approx(np.ones(9))


def test_rests_and_turns_on_the_spot_count_for_how_much_slower_a_run_has_to_be():
    time, q = fall([0.1] * 5)
    there = np.vstack([q, 2 * q[-1] - q[-2::-1]])  # faster and faster, then slower and slower
    time = np.r_[time, time[-1] + time[1:]]
    task = SimpleNamespace(
        moving_runs=[(0, 5), (5, 10)], torque_limits=False,
        velocity_limits=np.array([100.0]), acceleration_limits=np.array([2.0]), smoothing=0.0,
    )  # fmt: skip
    # at its limit on the way; it arrives at waypoint 5 with 0.9 rad/s and stops there within 0.05 s: 18 rad/s^2
    assert find_slowdown(task, there, time)[[2, 5, 8]] == pytest.approx([1.0, 3.0, 1.0])
    task.moving_runs = [(0, 10)]  # without the rest it goes on as fast
    assert find_slowdown(task, there, time) == pytest.approx(np.ones(11))
    task.acceleration_limits = np.array([0.5])
    assert find_slowdown(task, there, time) == pytest.approx([2.0] * 5 + [1.0] + [2.0] * 5)
    task.moving_runs = []  # a turn on the spot is timed by itself
    assert find_slowdown(task, there, time) == pytest.approx(np.ones(11))


def test_joints_keep_their_acceleration_on_a_path_that_bends_by_its_closed_form():
    """q = (cos 3s, sin 3s): what q'' v^2 + q' v v' really is, by hand, never passes the limit and comes near it."""
    along = np.linspace(0.0, 3.0, 1201)
    q = np.column_stack([np.cos(3.0 * along), np.sin(3.0 * along)])
    speed, change = time_cut(along, q, np.full(2, 100.0), np.full(2, 4.0)), differentiate(along, q)[1]
    push = np.gradient(0.5 * speed**2, along)
    bend, slope = -9.0 * q, 3.0 * np.column_stack([-q[:, 1], q[:, 0]])
    inner = slice(20, -20)
    assert change[inner] == pytest.approx(bend[inner], abs=1e-3)
    acceleration = np.abs(bend * speed[:, None] ** 2 + slope * push[:, None])[inner]
    assert 4.0 * 0.9 < acceleration.max() < 4.0 * 1.05


@pytest.mark.parametrize("programmed", [0.02, 0.1])
def test_a_rounding_goes_on_at_the_speed_of_the_run_and_no_faster(programmed: float) -> None:
    """x(u) = p(-a (1 - u)^4) + p(a u^4) of a right angle; the legs have slowed down nowhere when they reach it."""
    u, reach, speed = np.linspace(0.0, 1.0, 17), 1e-3, 0.02
    corner = np.column_stack([-reach * (1.0 - u) ** 4, reach * u**4, 0.0 * u])
    position = np.vstack([[-2e-3, 0.0, 0.0], corner, [0.0, 2e-3, 0.0]])
    length = np.linalg.norm(np.diff(position, axis=0), axis=1)
    time = np.r_[0.0, np.cumsum(length / speed)]
    step = np.diff(overlap_legs(time, position, np.full(19, programmed), [(1, 9, 17)]))
    assert (length <= speed * step * (1.0 + 1e-9)).all()
    # |x'(0)| = 4 a / g is the speed of the run; over the first sixteenth its mean is 4 (1 - (15/16)^4) of that
    mean = 4.0 * (1.0 - (15.0 / 16.0) ** 4) * speed
    assert (length / step)[[1, -2]] == pytest.approx([mean, mean], rel=1e-3)


def test_the_feed_at_a_waypoint_of_uneven_moves_is_that_of_an_even_acceleration() -> None:
    """s = t^2: the speed is 2 t, for the planner and for its judge; where a rapid move follows, that of the move."""
    time = np.r_[0.0, np.cumsum([0.1, 0.001, 0.2, 0.05, 0.001, 0.1])]
    rapid = np.array([False, False, False, False, False, False, True])
    feed = np.r_[0.0, np.diff(time**2) / np.diff(time)]
    wanted = np.r_[feed[1], 2.0 * time[1:5], feed[5], feed[6]]
    task = SimpleNamespace(nominal=SimpleNamespace(rapid=rapid))
    assert _moving_feed(task, SimpleNamespace(feed=feed, time=time)) == pytest.approx(wanted)
    place = np.outer(time**2, [1.0, 0.0, 0.0])
    rows = DrivenRows(place, np.tile([0.0, 0.0, 1.0], (7, 1)), rapid, np.zeros(7, bool), time)
    assert _speeds(rows) == pytest.approx(wanted)
