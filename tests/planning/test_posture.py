"""The ladder graph: finds what brute force finds, keeps within limits, passes singularities or names the waypoint."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from posture_cases import brute_force, cut_stations, make_case, mean_square

from compplan.errors import InfeasibleError
from compplan.planning.plan import PlanOptions, plan_compensation
from compplan.planning.posture.choose import _choose_line, choose_posture_path
from compplan.planning.posture.costs import Weights
from compplan.planning.posture.lattice import orient_tool
from compplan.planning.posture.search import Rungs, _step
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.summary import PostureSummary
from compplan.robot import load_robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm
from compplan.toolpath.toolpath import Toolpath

FLAT = np.array([1.0, 0.0, 0.0])


def straight_path(start: list[float], end: list[float], n: int = 120, force: float = 500.0) -> Toolpath:
    position = np.linspace(start, end, n)
    wrench = np.tile([force, 0.3 * force, force, 0.0, 0.0, 0.0], (n, 1))
    return Toolpath(
        position, np.tile([0.0, 0.0, 1.0], (n, 1)), np.full(n, 0.05), np.zeros(n, bool), wrench, frame="base"
    )


def check_on_path(robot, nominal: Toolpath, posture_choice) -> None:
    frames = locate_frames(build_arm(robot).chain, posture_choice.q)
    assert np.abs(frames.tcp_position - nominal.position).max() < 1e-6
    assert np.abs(frames.tcp_rotation[:, :, 2] + posture_choice.axis).max() < 1e-6
    assert (posture_choice.q >= robot.lower).all() and (posture_choice.q <= robot.upper).all()


def choose(*given) -> PostureSummary:
    return choose_posture_path(PostureProblem(*given))


@pytest.fixture(scope="module")
def angled():
    case = make_case("kuka_kr240", "circle", 45.0)
    axes = case.job.T_base_part[:3, :3]
    settings = PostureSettings(stations=160, axes=axes)  # what is left under load, alone; no plain posture beside it
    return case, _choose_line(PostureProblem(case.robot, case.nominal, case.job.tool_x_base, settings))


def test_the_chosen_posture_is_within_two_percent_of_brute_force_that_shares_no_cost_code(angled) -> None:
    case, posture_choice = angled
    rows, share = cut_stations(case.nominal)
    optimum = brute_force(case, rows[::2], share[::2] / share[::2].sum())
    ours = mean_square(case, posture_choice.q, rows[::2], share[::2] / share[::2].sum())
    assert np.sqrt(ours / optimum) < 1.02


def test_each_preset_is_the_best_of_the_three_at_what_it_is_for(angled) -> None:
    case, _ = angled
    axes = case.job.T_base_part[:3, :3]
    found = {
        preset: choose(case.robot, case.nominal, case.job.tool_x_base, settings).costs
        for preset in ("accurate", "smooth", "fast")
        if (settings := PostureSettings(stations=120, preset=preset, axes=axes))
    }
    for preset, key, slack in (("accurate", "sensitivity_rms_mm", 1.001), ("smooth", "joint_travel_deg", 1.03),
                               ("fast", "time_s", 1.001)):  # fmt: skip
        assert found[preset][key] <= slack * min(costs[key] for costs in found.values())
    assert found["accurate"]["sensitivity_rms_mm"] < 0.95 * found["smooth"]["sensitivity_rms_mm"]
    assert found["smooth"]["joint_travel_deg"] < 0.5 * found["accurate"]["joint_travel_deg"]


def test_the_margin_that_is_asked_for_is_kept_where_some_way_keeps_it() -> None:
    case = make_case("kuka_kr270", "spiral", 45.0)  # the plain posture comes within 1.4 deg of a limit
    posture_choice = choose(case.robot, case.nominal, case.job.tool_x_base, PostureSettings())
    assert posture_choice.costs["limit_distance_deg"] >= 10.0


def test_the_chosen_posture_puts_the_unloaded_tool_on_the_path_within_the_limits(angled) -> None:
    case, posture_choice = angled
    check_on_path(case.robot, case.nominal, posture_choice)
    assert np.abs(np.diff(posture_choice.q, axis=0)).max() < np.radians(20)


def test_spin_turns_the_tool_about_its_own_axis(angled) -> None:
    case, posture_choice = angled
    zero = np.zeros(len(case.nominal))
    rotation = orient_tool(case.nominal, case.job.tool_x_base, np.arange(len(zero)), posture_choice.spin, zero, zero)
    frames = locate_frames(build_arm(case.robot).chain, posture_choice.q)
    assert np.abs(frames.tcp_rotation - rotation).max() < 1e-6


def test_a_tool_along_axis_six_gains_nothing_from_rotation_and_the_stance_says_so() -> None:
    robot, nominal = load_robot("kuka_kr270"), straight_path([1.6, -0.2, 0.9], [1.6, 0.2, 0.9], 40)
    free = choose(robot, nominal, FLAT, PostureSettings(stations=20))
    fixed = choose(robot, nominal, FLAT, PostureSettings(stations=20, free_spin=False))
    assert free.costs["sensitivity_rms_mm"] == pytest.approx(fixed.costs["sensitivity_rms_mm"], rel=1e-6)


def test_the_smooth_preset_moves_the_joints_no_more_than_the_accurate_one() -> None:
    case = make_case("staubli_tx200", "circle", 90.0)
    travel = {}
    for preset in ("accurate", "smooth"):
        settings = PostureSettings(stations=60, preset=preset)
        posture_choice = choose(case.robot, case.nominal, case.job.tool_x_base, settings)
        travel[preset] = posture_choice.costs["joint_travel_deg"], posture_choice.costs["sensitivity_rms_mm"]
    assert travel["smooth"][0] < travel["accurate"][0]
    assert travel["smooth"][1] >= travel["accurate"][1]


def test_a_path_through_a_wrist_singularity_is_followed() -> None:
    # tool level and ahead: the wrist is straight where the path crosses the height of the forearm's line
    robot = load_robot("kuka_kr270")
    n = 160
    position = np.column_stack([np.full(n, 1.7), np.zeros(n), np.linspace(1.0, 1.9, n)])
    axis = np.tile([-1.0, 0.0, 0.0], (n, 1))
    wrench = np.tile([-300.0, 0.0, 0.0, 0.0, 0.0, 0.0], (n, 1))
    nominal = Toolpath(position, axis, np.full(n, 0.05), np.zeros(n, bool), wrench, frame="base")
    posture_choice = choose(robot, nominal, np.array([0.0, 0.0, 1.0]), PostureSettings(stations=80))
    check_on_path(robot, nominal, posture_choice)
    assert np.abs(np.diff(posture_choice.q, axis=0)).max() < np.radians(20)
    assert np.abs(posture_choice.q[:, 4]).min() < np.radians(3) or posture_choice.costs["dexterity_min"] > 0.03


def test_a_path_that_no_posture_can_follow_is_refused_with_the_waypoint() -> None:
    robot, nominal = load_robot("kuka_kr270"), straight_path([1.6, 0.0, 0.9], [3.6, 0.0, 0.9], 60)
    with pytest.raises(InfeasibleError, match=r"no posture at waypoint \d+: .*out of reach") as caught:
        choose(robot, nominal, FLAT, PostureSettings(stations=60))
    reach = caught.value.waypoints[0]
    assert nominal.position[reach, 0] > 2.2


def test_a_change_of_configuration_is_made_in_rapid_moves_alone() -> None:
    # two cuts that one configuration cannot both reach because joint 1 ends between them
    robot = load_robot("kuka_kr270")
    first, second = (
        straight_path([-1.5, -0.5, 1.0], [-1.5, -0.1, 1.0], 30),
        straight_path([-1.5, 0.1, 1.0], [-1.5, 0.5, 1.0], 30),
    )
    lift = np.array([[0.0, 0.0, 0.3]])
    position = np.vstack([first.position, first.position[-1:] + lift, second.position[:1] + lift, second.position])
    n = len(position)
    rapid = np.zeros(n, bool)
    rapid[30:33] = True
    wrench = np.where(rapid[:, None], 0.0, np.r_[first.wrench[0]])
    nominal = Toolpath(position, np.tile([0.0, 0.0, 1.0], (n, 1)), np.full(n, 0.05), rapid, wrench, frame="base")
    narrow = replace(
        robot,
        joints=tuple(replace(j, lower=-3.12, upper=3.12) if j.name == "joint_1" else j for j in robot.joints),
    )
    posture_choice = choose(narrow, nominal, FLAT, PostureSettings(stations=62, configuration={"shoulder": "front"}))
    check_on_path(narrow, nominal, posture_choice)
    jumps = np.flatnonzero(np.abs(np.diff(posture_choice.q, axis=0)).max(axis=1) > np.radians(40)) + 1
    assert set(jumps.tolist()) == {31}


def test_lead_and_lean_stay_within_their_cone_and_never_cost() -> None:
    robot, nominal = load_robot("kuka_kr240"), straight_path([1.6, -0.2, 0.9], [1.6, 0.2, 0.9], 30)
    upright = choose(robot, nominal, FLAT, PostureSettings(stations=15))
    free = choose(robot, nominal, FLAT, PostureSettings(stations=15, lead=np.radians(10), lean=np.radians(10)))
    tilt = np.degrees(np.arccos(np.clip(free.axis @ [0.0, 0.0, 1.0], -1, 1)))
    assert tilt.max() < 10.0 + 1e-6
    assert free.costs["sensitivity_rms_mm"] <= upright.costs["sensitivity_rms_mm"] * 1.001
    check_on_path(robot, nominal, free)


def test_a_rail_is_used_where_it_helps() -> None:
    robot = load_robot("kuka_kr240_rail")
    nominal = straight_path([1.5, 0.6, 1.2], [1.5, 3.4, 1.2], 60)
    posture_choice = choose(robot, nominal, FLAT, PostureSettings(stations=50, spin_step=np.radians(30)))
    check_on_path(robot, nominal, posture_choice)
    assert np.ptp(posture_choice.q[:, 0]) > 1.0


def test_the_plan_keeps_the_chosen_posture_and_stands_on_the_path_under_load(angled, monkeypatch) -> None:
    case, greedy = angled
    monkeypatch.setattr("compplan.planning.plan.better_start", lambda start, asked, **named: start)
    posture_choice = choose(case.robot, case.nominal, case.job.tool_x_base, greedy.settings)
    options = PlanOptions(tool_x=case.job.tool_x_base, posture=posture_choice.settings, inertia=False)
    plan = plan_compensation(case.robot, case.nominal, options, name="angled")
    assert plan.status == "solved"
    assert plan.after.max_deviation < 1e-8
    assert np.abs(plan.q - plan.task.q_start).max() < np.radians(5)
    assert plan.task.start is not None and plan.task.start.posture_choice is not None
    assert np.abs(plan.task.start.posture_choice.q - posture_choice.q).max() < 1e-9


@pytest.mark.slow
def test_five_thousand_waypoints_take_less_than_ten_seconds() -> None:
    import time

    case = make_case("kuka_kr240", "cone", 45.0)
    from compplan.toolpath.toolpath import resample_toolpath

    nominal = resample_toolpath(case.nominal, case.nominal.cutting_length / 5000)
    clock = time.process_time()
    plan = plan_compensation(case.robot, nominal, PlanOptions(tool_x=FLAT, posture=PostureSettings()))
    assert plan.status == "solved" and len(nominal) >= 5000
    assert time.process_time() - clock < 10.0


def test_a_step_of_the_search_finds_what_a_plain_loop_over_all_edges_finds(monkeypatch) -> None:
    rng, g, b, nq = np.random.default_rng(3), 6, 3, 6
    before, here = rng.uniform(-3, 3, (g, b, nq)), rng.uniform(-3, 3, (g, b, nq))
    here[2, 1], before[4, 0] = np.nan, np.nan
    last = np.r_[rng.uniform(0, 1, (g, b)), np.full((1, b), np.inf)]
    last[4, 0] = np.inf
    around = np.array([[(o - 1) % g, o, -1] for o in range(g)])
    one = np.ones(1)
    rungs = Rungs(np.ones(2), np.ones(2), one, 2.0 * one, 2.5 * one)
    weights, turns = Weights(motion=0.1, time=0.2, rate=0.3, singularity=0.4), np.arange(nq) == 5
    robot = SimpleNamespace(prismatic=np.arange(nq) == 0, velocity_limits=np.full(nq, 2.0))
    least, back = np.full((g, b), np.inf), np.zeros((g, b), int)
    for o, t, w, s in np.ndindex(g, b, around.shape[1], b):
        step = here[o, t] - before[around[o, w], s]
        step[5] -= 2 * np.pi * np.round(step[5] / (2 * np.pi))
        time = np.abs(step / 2.0).max()
        cost = 0.1 * (step**2).sum() + (0.4 if s != t else 0.0) + 0.2 * max(time, 2.0)
        cost += last[around[o, w], s] + 0.3 * max(time / 0.5 - 2.0, 0.0) / 2.0
        if np.abs(step[1:]).max() <= 2.5 and cost < least[o, t]:
            least[o, t], back[o, t] = cost, around[o, w] * b + s
    assert 5 < np.isfinite(least).sum() < g * b
    for block in (60_000, 20):  # all targets at once, and one by one
        monkeypatch.setattr("compplan.planning.posture.search.BLOCK", block)
        found, pointer = _step(last, before, here, around, 1, rungs, weights, robot, turns)
        assert found == pytest.approx(least) and (pointer == back).all()
