"""Feeds: one constant feed, rounded corners, torque limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.limits import sample_use
from compplan.job.job import check_job
from compplan.planning.feed import find_constant_feed, time_run
from compplan.planning.plan import PlanOptions, build_task
from compplan.planning.task import cutting_runs
from compplan.robot import load_robot
from compplan.simulation.torque import TorqueRules
from compplan.toolpath.corners import SLOWED, compute_parameters, find_corners, find_roundings, round_corners
from compplan.toolpath.toolpath import Toolpath, divide_toolpath

ROBOT = load_robot("kuka_kr270")


def square_path(side: float = 0.2, step: float = 0.01, feed: float = 0.1) -> Toolpath:
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side
    legs = [np.linspace(a, b, round(side / step), endpoint=False) for a, b in pairwise(corners)]
    flat = np.vstack([*legs, corners[-1:]])
    position = np.column_stack([1.6 + flat[:, 0], flat[:, 1] - 0.1, np.full(len(flat), 0.9)])
    n = len(position)
    return Toolpath(position, np.tile([0, 0, 1.0], (n, 1)), np.full(n, feed), np.zeros(n, bool), frame="base")


def arc_path(radius: float, feed: float, n: int = 400) -> Toolpath:
    angle = np.linspace(0, np.pi, n)
    position = np.column_stack([1.7 + radius * np.cos(angle), radius * np.sin(angle), np.full(n, 0.9)])
    return Toolpath(position, np.tile([0, 0, 1.0], (n, 1)), np.full(n, feed), np.zeros(n, bool), frame="base")


def make_task(nominal: Toolpath, robot=ROBOT):
    return build_task(robot, nominal, PlanOptions(spin_free=False, inertia=False))


def test_only_sharp_corners_are_corners() -> None:
    assert find_corners(square_path())[0].tolist() == [20, 40]
    assert len(find_corners(arc_path(0.1, 0.1))[0]) == 0


def test_rounded_corners_stay_within_the_tolerance_and_reach_it() -> None:
    path, tolerance = square_path(), 2e-4
    rounded = round_corners(path, tolerance)
    legs = [(path.position[a], path.position[b]) for a, b in ((0, 20), (20, 40), (40, 60))]
    distance = np.full(len(rounded), np.inf)
    for a, b in legs:
        along = np.clip(((rounded.position - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(rounded.position - a - along[:, None] * (b - a), axis=1))
    assert distance.max() <= tolerance
    corner = np.linalg.norm(rounded.position - path.position[20], axis=1).min()
    assert corner == pytest.approx(tolerance, rel=1e-6)
    assert np.diff(rounded.position, axis=0).any(axis=1).all()
    assert rounded.position[[0, -1]] == pytest.approx(path.position[[0, -1]])


def test_a_rounded_corner_that_is_divided_again_stays_on_its_parabola() -> None:
    rounded = round_corners(square_path(), 2e-4)
    assert rounded.rounded is not None and rounded.rounded.max() == pytest.approx(2e-4, rel=1e-6)
    rows = np.arange(len(rounded))
    divided = divide_toolpath(rounded, np.sort(np.r_[rows, rows[:-1] + 0.25, rows[:-1] + 0.5]))
    step = np.diff(divided.position, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    turn = np.degrees(np.arccos(np.clip((step[1:] * step[:-1]).sum(axis=1), -1.0, 1.0)))
    assert turn.max() < 9.0  # a right angle in 18 uneven parts; the chords of six turn by up to 21 deg


@pytest.mark.parametrize("turn", [30.0, 90.0, 150.0])
def test_a_corner_that_the_tool_slows_down_at_is_passed_at_the_tolerance_and_its_shares_are_found(turn: float) -> None:
    way = np.radians(turn)
    corner = np.array([1.6, 0.0, 0.9])
    position = corner + 0.05 * np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [np.cos(way), np.sin(way), 0.0]])
    path = Toolpath(position, np.tile([0, 0, 1.0], (3, 1)), np.full(3, 0.1), np.zeros(3, bool), frame="base")
    rounded = round_corners(path, 2e-4, SLOWED)
    ((first, last),) = find_roundings(rounded)
    x, u = rounded.position[first : last + 1] - corner, np.linspace(0.0, 1.0, 17)
    reach = 8.0 * 2e-4 / np.sin(0.5 * way)
    ahead = position[2] / 0.05 - corner / 0.05
    assert x == pytest.approx(reach * (-np.outer((1 - u) ** 4, [1.0, 0.0, 0.0]) + np.outer(u**4, ahead)), abs=1e-9)
    assert np.linalg.norm(x, axis=1).min() == pytest.approx(2e-4)
    shares, part = compute_parameters(rounded.position[first : last + 1])
    assert shares == pytest.approx(u, abs=0.02)
    assert part * np.linalg.norm(np.diff(x, axis=0), axis=1).sum() == pytest.approx(reach, rel=0.01)


def test_a_rounded_corner_takes_less_time_than_a_rest_and_the_tool_slows_down_there_without_a_jolt() -> None:
    sharp = square_path(step=0.05, feed=0.03)
    paths = (sharp, round_corners(sharp, 5e-5, SLOWED))
    rested, rounded = (build_task(ROBOT, path, PlanOptions(spin_free=False)) for path in paths)
    assert rested.rests.sum() == 2 and not rounded.rests.any()
    slow, fast = (time_run(task, task.q_start)[1] for task in (rested, rounded))
    assert slow.time[-1] - fast.time[-1] > 2 * 0.3 * rounded.smoothing
    bend = np.flatnonzero(rounded.nominal.rounded > 0.0)
    assert 0.02 < fast.share[bend].min() < 0.5
    assert fast.velocity_ratio <= 1.0 and fast.acceleration_ratio <= 1.0
    tip = np.diff(rounded.position, axis=0) / np.diff(fast.time)[:, None]
    push = np.linalg.norm(np.diff(tip, axis=0), axis=1) / (0.5 * (fast.time[2:] - fast.time[:-2]))
    assert push[bend[0] - 1 : bend[-1]].max() < 3.0 * 0.03 / rounded.smoothing  # from feed to rest within a period


def test_no_tolerance_leaves_the_path_alone() -> None:
    path = square_path()
    assert round_corners(path, 0.0) is path


def test_the_constant_feed_is_the_highest_that_holds() -> None:
    nominal = arc_path(0.3, 2.0)
    task = make_task(nominal)
    feed, note = find_constant_feed(task, task.q_start)
    assert 0 < feed < 2.0 and "held down by the" in note
    rates = {}
    for share in (0.995, 1.02):
        h = nominal.steps.mean() / (feed * share)
        velocity = np.abs(np.gradient(task.q_start, h, axis=0))[3:-3] / task.velocity_limits
        acceleration = np.abs(np.diff(task.q_start, 2, axis=0) / h**2)[3:-3] / task.acceleration_limits
        rates[share] = max(velocity.max(), acceleration.max())
    assert rates[0.995] <= 1.0 < rates[1.02]


def test_a_constant_feed_holds_between_start_and_stop_and_is_told() -> None:
    task = make_task(arc_path(0.3, 2.0))
    changed, timing, notes = time_run(replace(task, constant_feed=True), task.q_start)
    wanted = changed.nominal.feed[5]
    middle = slice(len(task) // 3, 2 * len(task) // 3)
    assert timing.feed[middle] == pytest.approx(wanted, rel=1e-2)
    assert timing.velocity_ratio < 1.01 and timing.acceleration_ratio < 1.05
    assert any("One feed for the whole cut" in note for note in notes)


def test_a_slow_feed_stays_as_programmed() -> None:
    task = make_task(arc_path(0.3, 0.05))
    assert find_constant_feed(task, task.q_start) == (0.05, "")


def test_rounding_corners_raises_the_constant_feed() -> None:
    sharp = make_task(square_path(step=0.001))
    rounded = make_task(round_corners(square_path(step=0.02), 5e-3))
    slow = find_constant_feed(sharp, sharp.q_start)[0]
    assert find_constant_feed(rounded, rounded.q_start)[0] > 1.5 * slow


def test_torque_rows_agree_with_inverse_dynamics() -> None:
    import pinocchio as pin

    task = make_task(arc_path(0.3, 0.5, 50))
    wrench = np.tile([100.0, -50.0, 200.0, 1.0, 2.0, 3.0], (50, 1))
    rules = TorqueRules(ROBOT, task.q_start, wrench)
    rng = np.random.default_rng(0)
    rate, change = rng.standard_normal((50, 6)), rng.standard_normal((50, 6))
    a, b, c, _ = rules.rows(0, 49, rate, change)
    u, x = 0.7, 1.3
    data = rules.model.createData()
    for i in (0, 20, 49):
        q, v = rules.positions[i], rate[i] * np.sqrt(x)
        columns = pin.computeFrameJacobian(
            rules.model, data, q, rules.model.getFrameId("tcp"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        torque = pin.rnea(rules.model, data, q, v, rate[i] * u + change[i] * x) - columns.T @ wrench[i]
        assert a[i] * u + b[i] * x + c[i] == pytest.approx(torque, abs=1e-6)


def test_tight_torque_limits_slow_the_run_down_and_are_kept() -> None:
    nominal = arc_path(0.3, 1.0)
    task = make_task(nominal)
    rules = TorqueRules(ROBOT, task.q_start, task.wrench)
    static = np.abs(rules.held).max(axis=0)
    weak = replace(
        ROBOT,
        joints=tuple(
            replace(j, effort=float(1.1 * static[ROBOT.joint_names.index(j.name)] + 5.0)) if j.actuated else j
            for j in ROBOT.joints
        ),
    )
    tight = replace(task, robot=weak)
    plain = time_run(tight, task.q_start)[1]
    slowed = time_run(replace(tight, torque_limits=True), task.q_start)[1]
    assert slowed.time[-1] > 1.02 * plain.time[-1]


@pytest.mark.parametrize(
    ("process", "feed", "wanted"),
    [({"model": "columns"}, {}, 5e-5), ({"model": "isf", "axial_N": 9.0}, {}, 5e-5),
     ({"model": "isf", "axial_N": 9.0}, {"mode": "constant"}, 0.0),
     ({"model": "columns"}, {"corner_tolerance_mm": 0.0}, 0.0),
     ({"model": "isf", "axial_N": 9.0}, {"corner_tolerance_mm": 0.3}, 3e-4)],
)  # fmt: skip
def test_corners_are_rounded_unasked_but_where_one_feed_is_kept_and_the_force_turns(process, feed, wanted) -> None:
    data = {"schema": 1, "robot": "ur10", "toolpath": "a.csv", "process": process, "feed": feed}
    assert check_job({**data, "plan": {"tolerance_mm": 0.2}}).corner_tolerance == pytest.approx(wanted)


def test_torques_are_held_by_the_timed_run_in_an_engine_of_another() -> None:
    task = make_task(arc_path(0.3, 1.5, 200))
    still = np.abs(TorqueRules(ROBOT, task.q_start, task.wrench).held).max(axis=0)
    weak = {name: float(1.08 * still[k] + 4.0) for k, name in enumerate(ROBOT.joint_names)}
    joints = tuple(replace(j, effort=weak.get(j.name, j.effort)) for j in ROBOT.joints)
    task = replace(task, robot=replace(ROBOT, joints=joints))
    uses = []
    for torque in (False, True):
        timing = time_run(replace(task, torque_limits=torque), task.q_start)[1]
        use = sample_use(
            task.q_start, timing.time, cutting_runs(task.nominal.rapid), task.velocity_limits, task.acceleration_limits,
            arm=ROBOT.folder, effort=np.array(list(weak.values())), wrench=task.wrench,
        )  # fmt: skip
        uses.append(use["torque"])
    assert uses[0] > 1.01 and uses[1] <= 1.001
