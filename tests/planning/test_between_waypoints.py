"""Between waypoints, at the feed that is driven: profiles, divisions, force and motion that agree, the judge's vote."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from arms import one_joint_arm
from scipy.integrate import odeint

import compplan as cp
from compplan.job.job import check_job
from compplan.planning.approach import DWELL
from compplan.planning.checks import build_check_robot, run_checks
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.motion_limits import measure_use
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.sampling import measure_between
from compplan.planning.strategies import command_path
from compplan.planning.timing import ease, ease_duration, ease_times, smooth_profile
from compplan.simulation.exact import load_by_motion
from compplan.simulation.inertia import load_springs
from compplan.simulation.vibration import build_dynamics
from compplan.statics.chain import locate_frames
from compplan.statics.inertia import build_moving_chain, load_motion
from compplan.statics.stiffness import attain_pose

pytestmark = pytest.mark.usefixtures("graph_alone")


def straight_profile(cap=20.0, n=401):
    """Return the fastest speeds over a way of 1 s that start and end at rest and change by at most `cap` a second."""
    along = np.linspace(0.0, 1.0, n)
    return along, np.sqrt(np.minimum(1.0, 2 * cap * np.minimum(along, 1.0 - along)))


def test_a_smoothed_profile_is_later_by_its_window_and_no_faster():
    along, speed = straight_profile()
    plain, smooth = smooth_profile(along, speed, 0.0), smooth_profile(along, speed, 0.1)
    time, share = smooth
    assert time[-1] == pytest.approx(plain[0][-1] + 0.1)
    assert share.max() <= 1.0 + 1e-12 and share[[0, -1]] == pytest.approx(0.0)
    assert np.abs(np.diff(share) / np.diff(time)).max() <= 20.0 * (1 + 1e-9)
    # the mean of a step of speed over a window: speed and place of the ramp in closed form
    t, place = time[(time > 0.05) & (time < 0.1)], along[(time > 0.05) & (time < 0.1)]
    expected = ((t - 0.025) ** 2 / 2 + 0.05**2 / 24) / 0.1
    assert place == pytest.approx(expected, abs=2e-6)


def test_a_gentle_move_keeps_the_limits_that_it_is_timed_for():
    limits = np.array([2.0]), np.array([5.0])
    duration = ease_duration(np.array([0.7]), *limits)
    share = np.linspace(0.0, 1.0, 200)
    use = measure_use(0.7 * share[:, None], ease_times(share, duration), *limits)
    assert 0.95 < use.max() <= 1.0 + 1e-6


def three_points(tmp_path, process, **tables):
    """Write a job of a few waypoints far apart."""
    rows = ["-60,0,20,0,1", "-60,0,0,0,1", "0,0,0,40,0", "0,50,0,40,0", "0,50,20,0,1"]
    lines = ["x_mm,y_mm,z_mm,feed_mm_s,rapid", *rows]
    (tmp_path / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    data = {
        "schema": 1, "robot": "kuka_kr270", "toolpath": "path.csv", "part": {"position_mm": [1700.0, 0.0, 900.0]},
        "process": process, "plan": {"rotate_about_tool_axis": False, "inertia": False},
        "feed": {"corner_tolerance_mm": 0.0}, **tables,
    }  # fmt: skip
    return check_job(data, tmp_path / "job.toml")


CONSTANT = {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "ramp_mm": 10.0}
MILLING = {
    "model": "milling", "depth_mm": 3.0, "width_mm": 8.0, "diameter_mm": 12.0, "spindle_rpm": 6000.0,
    "kc_N_mm2": 900.0, "ramp_mm": 5.0,
}  # fmt: skip


def test_few_waypoints_far_apart_are_divided_until_the_tip_stays_on_the_straight_line(tmp_path):
    job = three_points(tmp_path, CONSTANT, sampling={"max_step_mm": 1000.0, "chord_mm": 0.01})
    task = build_task(*prepare_job(job))
    assert len(task) < 20
    coarse = measure_between(task, command_path(task, "iterated_mirror").q).max_deviation
    plan = cp.plan_job(job)
    assert coarse > 1e-4
    assert plan.between.max_deviation < 1e-5
    assert plan.status == "solved" and len(plan.task) > len(task)


def test_the_milling_force_is_that_of_the_feed_that_is_driven_and_vanishes_at_corners(tmp_path):
    told = []
    plan = cp.plan_job(three_points(tmp_path, MILLING), progress=told.append)
    assert "force and feed, turn 1" in told
    task, timing = plan.task, plan.timing
    corner = int(np.flatnonzero(task.rests)[0])
    force = np.linalg.norm(task.wrench[:, :3], axis=1)
    assert task.position[corner] == pytest.approx([1.7, 0.0, 0.9])
    assert force[corner] < 0.05 * force.max()
    engaged = ~task.nominal.rapid & (task.nominal.arc_length > 0.020 + 0.005)  # beyond the way down and the ramp
    speed = np.gradient(task.nominal.arc_length, timing.time)
    ratio = force[engaged] / np.where(np.r_[task.nominal.rapid[1:], True], timing.feed, speed)[engaged]
    assert timing.feed[engaged].min() < 0.05 * timing.feed.max()
    assert ratio == pytest.approx(ratio[0], rel=1e-6)  # force over the speed at the waypoint is constant
    assert plan.status == "solved" and plan.after.max_deviation < 1e-8
    assert plan.timing.acceleration_ratio <= 1.0 and plan.timing.velocity_ratio <= 1.0


def test_milling_above_the_stock_and_straight_down_carries_no_lateral_force(tmp_path):
    from compplan.process.force_law import ForceLaw
    from compplan.process.force_models.milling import MillingProcess
    from compplan.toolpath.toolpath import Toolpath

    position = np.array([[0, 0, 5.0], [10, 0, 5], [10, 0, 1], [10, 0, -1], [20, 0, -1], [30, 0, -0.5]]) * 1e-3
    path = Toolpath(position, np.tile([0.0, 0, 1], (6, 1)), np.full(6, 0.02), np.zeros(6, bool))
    process = MillingProcess(**MILLING | {"depth_mm": 1.0, "ramp_mm": 0.0})
    force = np.linalg.norm(ForceLaw(process, stock_top=0.0).predict(path)[:, :3], axis=1)
    assert force[:4] == pytest.approx(0.0, abs=1e-9)  # in the air, down in the air, down into the stock
    assert force[5] == pytest.approx(0.5 * force[4], rel=2e-2)  # half as deep in the end


def test_a_check_of_moves_names_the_waypoint_after_which_either_way_strays(tmp_path):
    plan = cp.plan_job(three_points(tmp_path, CONSTANT))
    checker = build_check_robot(plan.task, plan.timing, None)
    move = int(np.flatnonzero(plan.task.cut)[3])

    def say(way):
        far = np.zeros(len(plan.task) - 1)
        far[move] = 2.0 * plan.task.tolerance
        between = plan.between._replace(**{way: far})
        given = plan.task, plan.command, plan.timing, between, plan.after, checker
        return [check.sentence for check in run_checks(*given) if check.fails and "strays" in check.sentence]

    for way in ("joint", "cartesian"):
        assert [text.endswith(f"after waypoint {move}") for text in say(way)] == [True]


def test_a_planner_that_is_wrong_is_not_confirmed(tmp_path, monkeypatch):
    from compplan.planning import plan as module

    honest = module.build_chain

    def mistaken(robot, **options):
        chain = honest(robot, **options)
        return replace(chain, compliance=-chain.compliance)

    monkeypatch.setattr(module, "build_chain", mistaken)
    plan = cp.plan_job(three_points(tmp_path, CONSTANT))
    assert plan.status == "not_confirmed"
    assert "the independent check finds the loaded tip" in plan.explain_failures()


def test_a_load_beyond_a_joints_effort_is_infeasible_and_names_it(tmp_path):
    heavy = CONSTANT | {"force_N": [0.0, 0.0, 9000.0]}
    plan = cp.plan_job(three_points(tmp_path, heavy, plan={"max_correction_mm": 100.0}))
    assert plan.status == "infeasible"
    assert any(text.startswith("effort limit of joint_") for text in plan.command.failures.values())


def test_a_path_without_a_clear_posture_is_planned_within_the_correction_limit_and_says_what_is_in_the_way(tmp_path):
    # the tool passes through the slab at every posture
    slab = trimesh.creation.box((200.0, 200.0, 20.0))
    slab.apply_translation([0.0, 0.0, 60.0])
    slab.export(tmp_path / "slab.stl")
    tool = {"position_mm": [0.0, 0.0, 300.0]}
    plan = cp.plan_job(three_points(tmp_path, CONSTANT, tool=tool, collision={"fixture": "slab.stl"}))
    assert plan.status == "infeasible" and "clearance" in plan.explain_failures()
    assert plan.max_correction < 2e-3
    assert any("without anything in the way" in note for note in plan.notes)


@pytest.mark.parametrize(
    ("effect", "parameters", "most"),
    [
        ("joint_offset", {"offset_rad": 3e-4}, 20),
        ("backlash", {"width_rad": 3e-4}, 20),
        ("transmission_error", {"sine_rad": [1e-4], "cosine_rad": [0.0], "cycles_per_turn": [60.0]}, 1000),
    ],
)
def test_effects_of_a_folder_count_between_waypoints_too_and_divide_the_path_no_further_than_they_bow(
    tmp_path, effect, parameters, most
):
    # ten waypoints on a line that starts under load: the correction of a shift of the joint is not a bow
    lines = ["x_mm,y_mm,z_mm,feed_mm_s", *(f"{10 * k},0,0,20" for k in range(10))]
    (tmp_path / "path.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    data = {
        "schema": 1, "robot": "kuka_kr270", "toolpath": "path.csv", "part": {"position_mm": [1700.0, 0.0, 900.0]},
        "process": CONSTANT | {"ramp_mm": 0.0}, "sampling": {"max_step_mm": 1000.0},
    }  # fmt: skip
    robot, nominal, options = prepare_job(check_job(data, tmp_path / "job.toml"))
    wrong = {"effect": effect, "joint": "joint_2", "parameters": parameters}
    plan = cp.plan_compensation(replace(robot, effects=(wrong,)), nominal, options)
    assert plan.status == "solved" and 10 <= len(plan.task) <= most
    assert plan.after.max_deviation < 1e-6
    assert max(plan.between.joint.max(), plan.between.cartesian.max()) < 1.05e-5


def test_a_path_that_would_need_too_many_waypoints_is_refused_with_the_waypoint(tmp_path, monkeypatch):
    monkeypatch.setattr("compplan.planning.sampling.MOST_WAYPOINTS", 10)
    job = three_points(tmp_path, CONSTANT, sampling={"max_step_mm": 1000.0, "chord_mm": 0.01})
    with pytest.raises(cp.InfeasibleError, match=r"waypoint \d+, .* mm along the path; raise sampling.chord_mm"):
        cp.plan_job(job)


def test_the_inertia_of_the_motion_is_compensated_and_judged_unless_a_job_says_no(tmp_path):
    plain = cp.plan_job(three_points(tmp_path, MILLING, plan={"rotate_about_tool_axis": False, "inertia": False}))
    plan = cp.plan_job(three_points(tmp_path, MILLING, plan={"rotate_about_tool_axis": False}))
    assert plain.inertia > 2e-5 and not plain.task.inertia
    assert plan.status == "solved" and plan.task.inertia and plan.inertia > 2e-5
    assert plan.after.max_deviation < 0.2 * plan.inertia  # the judge takes masses and motion by itself
    moving = build_check_robot(plan.task, plan.timing, None).bias
    loaded = attain_pose(plan.task.chain, plan.q, plan.task.wrench, slope=False, torque_bias=moving).position
    off = np.linalg.norm(loaded - plan.task.position, axis=1)[plan.task.cut]
    still = attain_pose(plan.task.chain, plan.q, plan.task.wrench, slope=False).position
    assert off.max() < 0.2 * np.linalg.norm(still - plan.task.position, axis=1)[plan.task.cut].max()


def test_with_inertia_a_force_that_sets_in_at_contact_is_corrected_in_the_time_that_the_joints_need(tmp_path):
    plan = cp.plan_job(three_points(tmp_path, CONSTANT, plan={"rotate_about_tool_axis": False, "inertia": True}))
    lead = np.flatnonzero(plan.task.lead)
    assert plan.status == "solved" and len(lead) and np.ptp(plan.q[lead], axis=0).max() > 1e-6
    rate = np.abs(np.diff(plan.q, axis=0)) / np.diff(plan.timing.time)[:, None]
    assert (rate <= plan.task.velocity_limits).all()


def test_the_inertia_of_what_is_out_of_reach_is_left_alone_and_the_note_says_so(tmp_path):
    far = three_points(tmp_path, CONSTANT, plan={"inertia": True}, part={"position_mm": [2700.0, 0.0, 700.0]})
    plan = cp.plan_job(far)
    assert plan.status == "infeasible" and not plan.task.inertia
    assert not any("inertia = true" in note for note in plan.notes)


def test_rows_beside_a_rest_are_so_near_that_they_tell_how_gently_a_run_starts(tmp_path):
    # whoever takes the acceleration at a rest from the rows beside it finds what bends the arm by less than a chord
    plan = cp.plan_job(three_points(tmp_path, MILLING, plan={"rotate_about_tool_axis": False, "inertia": True}))
    task, q, time = plan.task, plan.task.q_start, plan.timing.time
    runs = task.runs
    rests = np.array([row for first, last in runs for row in (first, last) if last > first + 1])
    beside = rests + np.tile([1, -1], len(rests) // 2)
    step = np.abs(time[beside] - time[rests])[:, None]
    push = (q[beside] - q[rests]) / step / (0.5 * (step + DWELL))  # it stands still on the other side
    load = load_by_motion(build_dynamics(plan.robot).inertial, q[rests], 0 * push, push)
    bent, still = (
        attain_pose(task.chain, q[rests], task.wrench[rests], slope=False, torque_bias=bias).position
        for bias in (load, None)
    )
    assert 1e-7 < np.linalg.norm(bent - still, axis=1).max() < task.chord


def test_one_joint_and_a_mass_follow_the_path_in_time_where_they_are_driven_ahead_by_the_load_of_the_path(tmp_path):
    # m l^2 (q + c)'' = -c / C in time: driven with q = q0 + C m l^2 q0'', the link goes where q0 says, as fast as it is
    robot = one_joint_arm(tmp_path, 1.0, 1e-5, mass=50.0)
    time, fine = np.linspace(0.0, 0.5, 401), np.linspace(0.0, 0.5, 20001)
    q0 = 0.1 * ease(time / 0.5)[:, None]
    inside = np.r_[False, np.ones(399, bool), False]
    load = load_motion(build_moving_chain(robot), q0, time, inside)[:, 0]
    u = time[1:-1] / 0.5
    push = 0.1 * (60 * u - 180 * u**2 + 120 * u**3) / 0.5**2
    assert load[1:-1] == pytest.approx(-50.0 * push, abs=1e-3 * 50.0 * np.abs(push).max())
    q = np.interp(fine, time, q0[:, 0] - 1e-5 * load)
    found = odeint(lambda x, t: [x[1], (np.interp(t, fine, q) - x[0]) / (1e-5 * 50.0)], [0.0, 0.0], time, hmax=1e-4)
    bent = 1e-5 * 50.0 * np.abs(push).max()
    assert np.abs(found[:, 0] - q0[:, 0]).max() < 5e-3 * bent


def test_a_point_that_stands_twice_in_a_path_puts_no_load_on_the_arm(tmp_path):
    # the digits of the second may differ, and it takes no time: not a motion of 1e-12 rad in 1e-12 s
    robot = one_joint_arm(tmp_path, 1.0, 1e-5, mass=50.0)
    time, q = np.array([0.0, 0.0, 0.1, 0.2, 0.3, 0.3]), 1e-3 * np.array([[0.0], [1e-9], [1.0], [2.0], [3.0], [3.0]])
    inside, moves = np.array([False, True, True, True, True, False]), np.array([False, True, True, True, True, True])
    load = load_motion(build_moving_chain(robot), q, time, inside)
    assert np.abs(load).max() < 1e-3
    evaluated = load_springs(build_dynamics(robot).inertial, q, time, moves, np.zeros(6, bool))
    assert np.abs(evaluated).max() < 1e-3


def test_standing_while_the_force_comes_and_goes_does_not_lower_the_one_feed_of_a_cut(tmp_path):
    job = three_points(tmp_path, CONSTANT | {"ramp_mm": 0.0}, feed={"mode": "constant"})
    rows = ["-60,0,20,0,1", "-60,0,0,0,1", "-30,0,0,40,0", "0,0,0,40,0", "0,0,20,0,1"]
    (tmp_path / "path.csv").write_text("\n".join(["x_mm,y_mm,z_mm,feed_mm_s,rapid", *rows]), encoding="utf-8")
    plan = cp.plan_job(job)
    assert plan.status == "solved" and plan.task.lead.sum() == 16
    assert not any(note.startswith("One feed") for note in plan.notes)
    assert np.median(plan.timing.feed[plan.task.cut & ~plan.task.nominal.rapid]) == pytest.approx(0.04, rel=0.01)


def test_no_rapid_starts_or_ends_with_a_correction_and_the_rows_that_bring_it_in_and_out_are_marked(tmp_path):
    # the force stands at once and until the end: without a ramp the tool stands while it grows, and while it goes
    plan = cp.plan_job(three_points(tmp_path, CONSTANT | {"ramp_mm": 0.0}))
    cp.write_plan(plan, tmp_path / "out")
    with (tmp_path / "out" / "joints.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    move = np.array([row["move"] for row in rows])
    kinds = move[np.r_[True, move[1:] != move[:-1]]].tolist()
    assert kinds == ["rapid", "approach", "cut", "retract", "rapid"]

    def columns(*names):
        return np.array([[float(row[name]) for name in names] for row in rows])

    q, wanted = np.radians(columns(*(f"q{k}_deg" for k in range(1, 7)))), columns("x_mm", "y_mm", "z_mm")
    force = columns("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
    chain = plan.task.chain
    unloaded = 1e3 * locate_frames(chain, q).tcp_position - wanted
    loaded = 1e3 * attain_pose(chain, q, force, slope=False).position - wanted
    away, held = np.linalg.norm(unloaded, axis=1), np.linalg.norm(loaded, axis=1)
    ends = np.flatnonzero(move == "rapid")
    starts = ends[ends > 0] - 1
    assert away[move == "cut"].min() > 0.1
    assert away[np.union1d(ends, starts)].max() < 1e-3
    # never further into the part than the force that it has there bends back, to the last row
    stays = np.isin(move, ["approach", "retract"])
    assert stays.sum() == 16 and held[stays].max() < 1e-3
    assert (np.diff(away[move == "approach"]) > 0).all() and (np.diff(away[move == "retract"]) < 0).all()


@pytest.mark.parametrize(("share", "divided"), [(0.9, False), (1.2, True)])
def test_a_start_from_rest_is_divided_where_its_acceleration_bends_the_arm_by_more_than_half_a_chord(share, divided):
    """A first move of s in t from rest accelerates by a = 2 s / t^2: the bend by it is `share` of half a chord."""
    job = {
        "schema": 1, "robot": "kuka_kr270_full",
        "toolpath": {"generator": "circle", "radius_mm": 80.0, "feed_mm_s": 100.0, "waypoints": 200},
        "part": {"position_mm": [1800.0, 0.0, 800.0]}, "process": {"model": "constant", "force_N": [0.0, 0.0, 0.0]},
        "plan": {"rotate_about_tool_axis": False, "inertia": True},
    }  # fmt: skip
    robot, nominal, options = prepare_job(check_job(job, "job.toml"))
    task = build_task(robot, nominal, options)
    time = time_run(task, task.q_start)[1].time
    bends = []
    for rest, move, way in ((0, 0, 1.0), (-1, -2, -1.0)):
        push = way * 2.0 * (task.q_start[move + 1] - task.q_start[move]) / (time[move + 1] - time[move]) ** 2
        load = load_by_motion(build_dynamics(robot).inertial, task.q_start[[rest]], 0.0 * push[None], push[None])
        bent, plain = (
            attain_pose(task.chain, task.q_start[[rest]], task.wrench[[rest]], slope=False, torque_bias=bias).position
            for bias in (load, None)
        )
        bends.append(float(np.linalg.norm(bent - plain)))
    found = resolve_starts(replace(task, chord=2.0 * max(bends) / share))
    assert (len(found) > len(task)) is divided
