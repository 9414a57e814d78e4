"""When an effect is offered, where it sits, and what its error follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_campaigns import draw_robot_files, rail_arm

from compplan.effects import (
    EFFECTS,
    Effect,
    apply_effects,
    build_model,
    command_campaign,
    driver_of,
    locate_effect,
    solve_model_poses,
)
from compplan.effects.forward_model import own_springs
from compplan.effects.linearization import Linearization, linearize_model
from compplan.robot import Spring, load_robot
from compplan.uncertainty.assumed import assume_uncertainty, robot_uncertainty
from tests.effects.test_effects_signatures import make_campaign, make_linearization


@pytest.fixture(scope="module")
def arm() -> Linearization:
    return make_linearization(replace(load_robot("kuka_kr270"), link_elasticities=()))


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Linearization:
    return make_linearization(draw_robot_files(rail_arm(), tmp_path_factory.mktemp("rail")).robot)


def test_play_is_offered_with_the_shape_of_half_its_scale_until_the_fit_knows_its_width(arm: Linearization) -> None:
    name = arm.robot.joint_names[2]
    first = next(s for s in EFFECTS["backlash"].signatures(arm) if s.joint == name)
    known = {("backlash", name, None): {"width_rad": 1e-4}}
    half = next(s for s in EFFECTS["backlash"].signatures(replace(arm, current=known)) if s.joint == name)
    assert first.scale == pytest.approx([2e-4]) and np.array_equal(first.twist, half.twist)
    assert first.encoder is not None and np.abs(first.encoder).max() == pytest.approx(0.5)


def test_behind_link_side_feedback_a_softer_drive_shows_nothing(arm: Linearization) -> None:
    mode = np.where(np.arange(120) % 2 == 0, "U2", "U1")
    scene = build_model(arm.robot, replace(make_campaign(arm.robot), mode=mode))
    at = linearize_model(scene, solve_model_poses(scene))
    held = at.campaign.link_controlled
    assert held.sum() == 60
    for signature in EFFECTS["joint_stiffness"].signatures(at):
        assert np.isfinite(signature.twist).all() and not signature.twist[held].any()
        assert signature.twist[~held].any()


def test_no_offset_of_a_sensor_is_offered_where_rows_read_exactly_nothing(arm: Linearization) -> None:
    campaign = make_campaign(arm.robot)
    for zeros, offered in ((2, True), (3, False)):
        wrench = campaign.wrench.copy()
        wrench[:zeros] = 0.0
        scene = build_model(arm.robot, replace(campaign, wrench=wrench))
        at = linearize_model(scene, solve_model_poses(scene))
        assert bool(list(EFFECTS["wrench_bias"].signatures(at))) == offered


def test_the_spring_of_a_slide_that_is_named_by_its_axis_is_its_own(rail: Linearization) -> None:
    slide = next(joint for joint in rail.robot.actuated if joint.kind == "prismatic")
    axis = "xyz"[int(np.argmax(np.abs(slide.axis)))]
    along, about = Spring(slide.name, f"t{axis}", 3e-8), Spring(slide.name, f"r{axis}", 1e-7)
    found = own_springs(replace(rail.robot, springs=(about, along)))
    assert [(spring.spring, spring.compliance) for spring in found.values()] == [(1, 3e-8)]
    assert found[rail.robot.joint_names.index(slide.name)].sign == np.sign(slide.axis["xyz".index(axis)])


@pytest.mark.parametrize(
    ("name", "joint", "place", "driver"),
    [
        ("payload", None, "tool", "gravity"), ("thermal_drift", None, "links", "temperature and time"),
        ("wrench_bias", None, "force sensor", "load"), ("base_frame", None, "base", "posture"),
        ("time_skew", None, "clock", "speed"), ("backlash", "joint_4", "joint_4", "direction of approach"),
        ("joint_stiffness", "joint_2", "joint_2", "load"),
    ],
)  # fmt: skip
def test_an_effect_says_where_it_sits_and_what_its_error_follows(
    name: str, joint: str | None, place: str, driver: str
) -> None:
    assert (locate_effect(name, joint), driver_of(name)) == (place, driver)


def test_commanded_rows_are_a_path_unless_they_are_said_to_be_poses() -> None:
    q = np.zeros((3, 6))
    assert command_campaign(q).on_path.all()
    assert not command_campaign(q, on_path=False).on_path.any()


def test_where_commanded_rows_come_to_is_not_known_before_they_are_driven() -> None:
    campaign = command_campaign(np.zeros((3, 6)))
    assert campaign.position.shape == (3, 3) and np.isnan(campaign.position).all()
    assert not campaign.usable.any()


def test_springs_of_the_base_plate_do_not_hide_those_of_the_joints_behind_them(rail: Linearization) -> None:
    robot = rail.robot
    plate = next(joint for joint in robot.joints if joint.kind == "fixed")
    own = {index: spring.compliance for index, spring in own_springs(robot).items()}
    mounted = replace(robot, springs=(Spring(plate.name, "rx", 1e-8), *robot.springs))
    assert own and {index: spring.compliance for index, spring in own_springs(mounted).items()} == own


@pytest.mark.parametrize(
    ("parameters", "factor", "constant"), [({"zero_m": 0.05}, 1.0, 0.05), ({"reversed": True}, -1.0, 0.0)]
)
def test_a_slide_whose_zero_is_moved_or_that_counts_backwards_carries_the_arm_along_its_axis(
    parameters: dict[str, object], factor: float, constant: float, rail: Linearization
) -> None:
    robot = replace(rail.robot, springs=(), link_elasticities=(), gravity=None)
    slide = next(joint for joint in robot.actuated if joint.kind == "prismatic")
    q = np.full((2, robot.nq), 0.3)
    q[:, robot.joint_names.index(slide.name)] = [0.2, -0.4]
    scene = build_model(robot, command_campaign(q, on_path=False))
    effect = Effect("joint_coupling", slide.name, None, parameters)
    moved = solve_model_poses(apply_effects(scene, [effect])).position - solve_model_poses(scene).position
    before = robot.joints[: robot.joints.index(slide) + 1]
    assert all(joint.kind == "fixed" for joint in before[:-1])
    along = np.linalg.multi_dot([np.eye(3), *(joint.placement[:3, :3] for joint in before)]) @ slide.axis
    travel = np.array([0.2, -0.4])
    assert moved == pytest.approx(np.outer((factor - 1.0) * travel + constant, along), abs=1e-12)


def test_what_is_known_of_a_robot_holds_for_one_that_lies_in_no_folder(arm: Linearization) -> None:
    robot = replace(arm.robot, folder=None)
    known = assume_uncertainty(robot)
    again = robot_uncertainty(replace(robot, uncertainty=known))
    assert [unknown.effect for unknown in again.unknowns] == [unknown.effect for unknown in known.unknowns]
