"""A robot that is known to lose motion: what its effects add at the waypoints is not a reason to divide the path."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compplan.effects.backlash import find_crossings, find_sides, list_plays, lost_motion
from compplan.job.job import load_job
from compplan.planning.plan import PlanOptions, plan_compensation, plan_job
from compplan.planning.sampling import measure_between
from compplan.planning.task import attain_rows
from compplan.robot import load_robot
from compplan.toolpath.generators import CircleTable
from compplan.toolpath.toolpath import place_toolpath

#: Ten waypoints; joint 1 of its robot has a backlash of 0.4 mrad, which is 0.3 mm at the tip.
JOB = Path(__file__).parents[1] / "bad_inputs" / "good" / "job.toml"


@pytest.fixture(scope="module")
def plan():
    return plan_job(load_job(JOB))


def test_a_path_is_not_divided_for_what_no_division_mends(plan):
    assert plan.status == "solved" and len(plan.task) < 100


def test_between_waypoints_the_tip_is_as_far_off_as_at_them(plan):
    task, q = plan.task, plan.task.q_start
    cut = ~task.nominal.rapid & ~task.lead
    off = attain_rows(task, q, np.arange(len(task)), slope=False).position - task.position
    at = np.linalg.norm(off, axis=1)[cut].max()
    assert at > 2e-4  # the lost motion stands uncorrected in the start
    assert measure_between(task, q).joint.max() == pytest.approx(at, rel=0.05)
    assert measure_between(task, plan.command.q).joint.max() < 0.01 * at


@pytest.mark.parametrize("first", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_command_that_leads_by_half_the_play_puts_the_link_where_it_has_to_be(seed: int, first: float) -> None:
    """Through the play operator of the effect, on drawn motions whose swings are wider than what turns no side."""
    width, rng = 3e-4, np.random.default_rng(seed)
    ends = np.cumsum(rng.uniform(2.0 * width, 0.05, 6) * [first * (-1.0) ** k for k in range(6)])
    starts = np.r_[0.0, ends[:-1]]
    link = np.concatenate([np.linspace(a, b, 30, endpoint=False) for a, b in zip(starts, ends, strict=True)])
    command = link + 0.5 * width * find_sides(link, 1e-6, first)
    assert command + lost_motion(command, width, -0.5 * first) == pytest.approx(link, abs=1e-12)


def test_swings_too_small_to_matter_turn_no_side() -> None:
    link = np.array([0.0, 1.0, 2.0, 1.9, 2.1, 3.0, 1.0, 0.0])
    assert find_sides(link, 0.5, 1.0).tolist() == [1, 1, 1, 1, 1, 1, -1, -1]


def test_rounding_crosses_no_play_and_chooses_no_reversal() -> None:
    rng = np.random.default_rng(0)
    links = rng.uniform(-3.0, 3.0, (200, 6))
    lead = 2e-5 * np.where(np.arange(200) < 80, 1.0, -1.0)[:, None]
    assert np.flatnonzero(find_crossings(links + lead, links)).tolist() == [79]
    stands = np.concatenate([np.linspace(0.0, 1.0, 20), np.ones(30), np.linspace(1.0, 0.0, 20)])
    for _ in range(20):
        sides = find_sides(stands + rng.uniform(-1e-13, 1e-13, 70), 1e-6, 1.0)
        assert np.array_equal(sides, np.where(np.arange(70) <= 50, 1.0, -1.0))


def test_the_tip_is_on_the_path_at_its_reversals_too(plan) -> None:
    """Joint 1 has .4 mrad of play; the command crosses it where the link turns, and the approach before the cut."""
    task = plan.task
    assert list_plays(task.robot)[0] == pytest.approx(4e-4)
    lead = plan.command.lead[:, 0]
    assert np.abs(lead) == pytest.approx(np.full(len(lead), 2e-4), abs=1e-12)
    assert plan.status == "solved" and plan.after.max_deviation < 2e-6
    cross = plan.approach.key_q[-1, 0] - plan.q[0, 0]
    assert plan.task.nominal.rapid[0] or cross == pytest.approx(-2.0 * lead[0], abs=1e-12)


def test_a_move_in_which_a_link_turns_is_divided_until_the_path_does_not_go_on_without_it():
    """While the command crosses the play of joint 1 the link stands; 5 mm of a circle later the path is .1 mm away."""
    robot = load_robot("kuka_kr270")
    play = {"effect": "backlash", "joint": "joint_1", "parameters": {"width_rad": 2.2e-4}}
    place = np.eye(4)
    place[:3, 3] = 1.55, 0.35, 0.7
    path = place_toolpath(CircleTable(radius_mm=70, feed_mm_s=10, waypoints=90).generate(), place)
    plan = plan_compensation(replace(robot, effects=(play,)), path, PlanOptions())
    assert plan.status == "solved", plan.explain_failures()
    crosses = np.abs(np.diff(plan.command.lead[:, 0])) > 0.0
    assert crosses.sum() == 2
    assert plan.between.joint[crosses].max() < 2.0 * plan.task.chord


def test_inertia_is_compensated_beside_the_play() -> None:
    """Joint 1 has 1 mrad of play: what is driven strays by 10 um beside its crossing."""
    robot, place = load_robot("kuka_kr270"), np.eye(4)
    play = {"effect": "backlash", "joint": "joint_1", "parameters": {"width_rad": 1e-3}}
    place[:3, 3] = 1.7, 0.0, 0.9
    path = place_toolpath(CircleTable(radius_mm=60, feed_mm_s=30, waypoints=60).generate(), place)
    plan = plan_compensation(replace(robot, effects=(play,)), path, PlanOptions(inertia=True))
    assert plan.status == "solved" and plan.task.inertia, plan.notes
    assert plan.between.max_deviation < 0.2 * PlanOptions().tolerance
    assert plan.after.max_deviation < 0.2 * plan.inertia
