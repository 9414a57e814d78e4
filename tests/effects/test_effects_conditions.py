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
    solve_model_poses,
)
from compplan.effects.linearization import Linearization, linearize_model
from compplan.robot import load_robot
from tests.effects.test_effects_signatures import make_campaign, make_linearization


@pytest.fixture(scope="module")
def arm() -> Linearization:
    return make_linearization(replace(load_robot("kuka_kr270"), link_elasticities=()))


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Linearization:
    return make_linearization(draw_robot_files(rail_arm(), tmp_path_factory.mktemp("rail")).robot)


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
