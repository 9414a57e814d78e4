"""The plan: shipped jobs reach what they promise, limits bind, contacts and approaches."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import compplan as cp
from compplan.api.given import read_table
from compplan.diagnosis import campaign_diagnosis
from compplan.errors import InputError
from compplan.job.job import CollisionTable, check_job
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.posture import collision_scene
from compplan.statics.chain import locate_frames

PATHS = Path(__file__).parents[2] / "paths"


def shipped(name, **tables):
    """Load a shipped job, with some keys of some tables changed."""
    job = cp.load_job(PATHS / f"{name}.toml")
    data = job.model_dump(by_alias=True, exclude_unset=True)
    for table, keys in tables.items():
        data[table] = data.get(table, {}) | keys
    return check_job(data, job.file)


@pytest.fixture(scope="module")
def cone():
    return cp.plan_job(shipped("isf_cone", toolpath={"depth_mm": 5.0}))  # a third of it


def test_loaded_tip_of_the_cone_stays_within_a_micrometre_in_the_exact_cell(cone):
    assert cone.status == "solved"
    assert cone.before.max_deviation > 1e-3
    assert cone.after.max_deviation < 1e-6
    assert cone.after.max_tilt < 1e-6


def test_times_grow_and_rates_stay_within_limits(cone):
    assert (np.diff(cone.timing.time) > 0).all()
    assert cone.timing.velocity_ratio <= 1 + 1e-6
    assert cone.timing.acceleration_ratio <= 1 + 1e-2
    assert cone.limit_room[0] > 0


def test_the_velocity_limit_is_active_in_the_fast_cut_and_lowers_the_feed():
    plan = cp.plan_job(shipped("limits_feed"))
    robot, nominal, options = prepare_job(shipped("limits_feed"))
    joints = [replace(joint, velocity=10 * joint.velocity) for joint in robot.joints]
    free = cp.plan_compensation(replace(robot, joints=tuple(joints)), nominal, options)
    assert plan.status == "solved"
    assert plan.timing.velocity_ratio == pytest.approx(1.0, abs=1e-2)  # smoothing takes the tip off the peak
    assert any("by the velocity limit of joint_1" in note for note in plan.notes)
    middle = len(nominal) // 2
    assert plan.timing.share[middle] < 0.6
    assert free.timing.share[middle] > 1.2 * plan.timing.share[middle]
    assert free.timing.time[-1] < plan.timing.time[-1]


@pytest.fixture(scope="module")
def out_of_reach():
    return cp.plan_job(shipped("limits_reach"))


def test_position_and_correction_limits_are_active_in_the_circle_out_of_limits(out_of_reach):
    plan = out_of_reach
    named = {limit for text in plan.command.failures.values() for limit in text.split(", ")}
    assert plan.status == "infeasible"
    assert named == {"correction limit", "lower position limit of joint_2"}
    assert plan.limit_room[0] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(plan.correction, axis=1).max() <= 1.5e-3 + 1e-6  # hard where joints stop the arm too
    by_correction = [k for k, text in plan.command.failures.items() if text == "correction limit"]
    sizes = np.linalg.norm(plan.correction, axis=1)
    assert sizes[by_correction] == pytest.approx(1.5e-3, abs=1e-6)
    others = np.setdiff1d(np.arange(len(plan.task)), list(plan.command.failures))
    assert plan.after.distance[others].max() < 1e-6


def test_without_its_limits_the_circle_out_of_limits_is_solved():
    robot, nominal, options = prepare_job(shipped("limits_reach"))
    joints = [replace(joint, lower=-4.0, upper=4.0) for joint in robot.joints]
    plan = cp.plan_compensation(replace(robot, joints=tuple(joints)), nominal, replace(options, max_correction=0.01))
    assert plan.status == "solved"
    assert plan.after.max_deviation < 1e-6
    assert plan.q[:, 1].min() < robot.lower[1]
    assert plan.max_correction > 1.5e-3


def test_failing_waypoints_and_limits_are_named_in_a_sentence(out_of_reach):
    sentence = out_of_reach.explain_failures()
    beyond = [k for k, text in sorted(out_of_reach.command.failures.items()) if "joint_2" in text]
    assert f"{len(beyond)} of 400 waypoints are out of reach, the first is waypoint {beyond[0]} (" in sentence
    assert " mm along the path): lower position limit of joint_2" in sentence
    assert "`compplan place` looks for a place" in sentence
    assert f"{len(out_of_reach.command.failures) - len(beyond)} others need more correction than plan." in sentence
    assert len(sentence) <= 300


def test_the_tool_comes_to_a_contact_without_force_and_the_correction_comes_in_while_it_grows():
    # A force that stands at once: the rapid ends unloaded, rows that lead in take it share by share at the same place.
    plan = cp.plan_job(shipped("isf_cone", process={"ramp_mm": 0.0}, toolpath={"depth_mm": 1.0},
                                plan={"inertia": False}))  # fmt: skip
    task, lead = plan.task, np.flatnonzero(plan.task.lead & ~plan.task.leaving)
    contact = lead[0] - 1
    assert task.nominal.rapid[contact] and not task.nominal.rapid[lead].any()
    assert np.linalg.norm(plan.correction[contact]) < 1e-9
    assert np.ptp(task.position[contact : lead[-1] + 1], axis=0).max() < 1e-12
    grown = np.linalg.norm(task.wrench[lead, :3], axis=1) / np.linalg.norm(task.wrench[lead[-1] + 1, :3])
    assert grown == pytest.approx(np.arange(1, len(lead) + 1) / len(lead))
    assert plan.after.max_deviation < 1e-6
    assert (np.diff(plan.timing.time) > 0).all()


def test_a_toolpath_without_rapids_is_approached_and_left_along_the_tool_axis():
    plan = cp.plan_job(shipped("circle_10mm", toolpath={"waypoints": 60}))
    for way, order, end in ((plan.approach, 1, 0), (plan.retract, -1, -1)):
        above, touch = locate_frames(plan.task.chain, way.key_q[::order]).tcp_position
        assert above == pytest.approx(plan.task.position[end] + [0, 0, 0.05], abs=1e-8)
        assert touch == pytest.approx(plan.task.position[end], abs=1e-9)  # unloaded on the path, not inside the part
        load = np.linalg.norm(way.wrench[::order, :3], axis=1)
        assert load[0] == 0 and (np.diff(load) >= 0).all() and load[-1] == np.linalg.norm(plan.task.wrench[end, :3])


def test_plans_from_parts_and_from_a_job_agree():
    job = shipped("circle_10mm", toolpath={"waypoints": 60})
    robot, nominal, options = prepare_job(job)
    assert np.array_equal(cp.plan_compensation(robot, nominal, options).q, cp.plan_job(job).q)


def test_a_robot_with_too_few_joints_is_refused():
    robot, nominal, options = prepare_job(shipped("circle_10mm"))
    joints = tuple(replace(j, kind="fixed") if j.name == "joint_6" else j for j in robot.joints)
    springs = tuple(s for s in robot.springs if s.joint != "joint_6")
    short = replace(robot, joints=joints, springs=springs, acceleration_limits=robot.acceleration_limits[:5])
    with pytest.raises(InputError, match="has 5 joints, the path needs 6"):
        cp.plan_compensation(short, nominal, options)


def test_a_tool_that_the_job_mounts_is_planned_with():
    tool = {"position_mm": [0.0, 0.0, 250.0]}
    plan = cp.plan_job(shipped("circle_10mm", toolpath={"waypoints": 30}, tool=tool, plan={"inertia": False}))
    assert plan.robot.tcp == "tool_tcp"
    assert plan.after.max_deviation < 1e-6


class CancelledError(Exception):
    """What somebody raises who has waited long enough."""


def test_a_plan_tells_its_stages_in_order_and_ends_where_it_is_cancelled():
    job, told = shipped("circle_10mm", toolpath={"waypoints": 12}), []

    def progress(text, until=""):
        told.append(re.split(" of |:|, turn", text)[0])
        if told[-1] == until:
            raise CancelledError

    cp.plan_job(job, progress=progress)
    stages = ["robot and toolpath", "posture", "sampling", "compensation", "force and feed", "virtual cell"]
    assert list(dict.fromkeys(told)) == [*stages, "checks, approach and retract"]
    for stop in ("posture", "compensation"):
        told.clear()
        with pytest.raises(CancelledError):
            cp.plan_job(job, progress=lambda text, stop=stop: progress(text, stop))
        assert told == stages[: stages.index(stop) + 1]


@pytest.mark.usefixtures("graph_alone")
def test_each_scale_lowers_its_own_limits_alone() -> None:
    scales = {"velocity": 0.4, "acceleration": 0.3}
    job = check_job(
        {"schema": 1, "robot": "kuka_kr270", "part": {"position_mm": [1600.0, 0.0, 900.0]},
         "limits": {f"{name}_scale": scale for name, scale in scales.items()},
         "toolpath": {"generator": "circle", "radius_mm": 60.0, "waypoints": 12, "feed_mm_s": 40.0},
         "process": {"model": "constant", "force_N": [0.0, 0.0, 30.0]}}, Path("job.toml"),
    )  # fmt: skip
    task = build_task(*prepare_job(job))
    for name, scale in scales.items():
        given = np.asarray(getattr(task, f"{name}_limits")) / np.asarray(getattr(task.robot, f"{name}_limits"))
        assert given[np.isfinite(given)] == pytest.approx(scale)


def test_six_numbers_of_a_part_are_its_place_and_a_rotation_vector() -> None:
    assert read_table("part", [1.0, 2.0, 3.0]) == {"position_mm": [1.0, 2.0, 3.0]}
    assert read_table("part", [1, 2, 3, 0, 0, 90]) == {"position_mm": [1.0, 2.0, 3.0], "rotation_deg": [0.0, 0.0, 90.0]}


def test_the_zone_of_the_tip_that_may_touch_is_given_in_mm(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, float] = {}
    build = collision_scene.build_scene
    monkeypatch.setattr(
        collision_scene, "build_scene", lambda *_, **given: [asked.update(tip=given["tip_zone"]), build(*_, **given)][1]
    )
    robot = cp.load_robot("kuka_kr270")
    job = SimpleNamespace(
        collision=CollisionTable(tip_zone_mm=45.0), file=Path("job.toml"), T_base_part=np.eye(4), tool=None,
    )  # fmt: skip
    collision_scene.read_scene(job, robot)  # type: ignore[arg-type]
    assert asked["tip"] == pytest.approx(0.045)


def test_the_offset_of_a_target_is_given_in_mm(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(campaign_diagnosis, "diagnose_campaign", lambda robot, campaign, **_: seen.append(campaign))
    place = np.random.default_rng(1).uniform(0.0, 900.0, (30, 3))
    log = {"q_deg": np.zeros((30, 6)) + np.arange(30)[:, None], "position_mm": place}
    cp.diagnose(log, "kuka_kr270", target_offset_mm=(0.0, 0.0, 100.0), assume_ok=True)
    assert seen[0].target_offset == pytest.approx([0.0, 0.0, 0.1])
