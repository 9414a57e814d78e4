"""Effects of a joint that another joint follows: it follows the true position, and no spring of its driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compplan.effects import Effect, apply_effects, build_model, command_campaign, fold_effects, solve_model_poses
from compplan.effects.joint_stiffness import signatures
from compplan.effects.linearization import linearize_model
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder

FOLLOWS, ZERO, COMPLIANCE = -2.0, 0.3, 1e-6


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    """Two links of a metre each; the second joint follows the first."""
    (tmp_path / "robot.urdf").write_text(
        f"""<robot name="pair"><link name="a"/><link name="b"/><link name="c"/><link name="tool0"/>
        <joint name="one" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
        <joint name="two" type="revolute"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
        <limit lower="-6" upper="6" velocity="1" effort="1"/>
        <mimic joint="one" multiplier="{FOLLOWS}" offset="{ZERO}"/></joint>
        <joint name="tip" type="fixed"><parent link="c"/><child link="tool0"/><origin xyz="1 0 0"/></joint></robot>"""
    )
    (tmp_path / "elasticity.toml").write_text(
        f'schema = 1\ntcp = "tool0"\n[[spring]]\njoint = "one"\naxis = "own"\ncompliance = {COMPLIANCE}\n'
    )
    return read_robot_folder(tmp_path)


def tip(first: float, follower: float) -> np.ndarray:
    """Return the tip where the first joint and its follower stand at these angles."""
    return np.array([np.cos(first) + np.cos(first + follower), np.sin(first) + np.sin(first + follower), 0.0])


def test_a_follower_follows_the_true_position_of_an_offset_joint(robot: Robot) -> None:
    offset, q = 0.01, 0.4
    shifted = fold_effects(robot, [Effect("joint_offset", "one", None, {"offset_rad": offset})])
    attained = solve_model_poses(build_model(shifted, command_campaign(np.array([[q]]))))
    true = q + offset
    np.testing.assert_allclose(attained.position[0], tip(true, ZERO + FOLLOWS * true), atol=1e-12)


def test_a_follower_stays_where_its_driver_bends(robot: Robot) -> None:
    q, force = 0.4, np.array([[0.0, 50.0, 0.0, 0.0, 0.0, 0.0]])
    attained = solve_model_poses(build_model(robot, command_campaign(np.array([[q]]), force)))
    bent = float(attained.theta[0, 0])
    moment = force[0, 1] * attained.position[0, 0]
    assert bent == pytest.approx(COMPLIANCE * moment, rel=1e-6)
    np.testing.assert_allclose(attained.position[0], tip(q + bent, ZERO + FOLLOWS * q), atol=1e-12)


def test_the_signature_of_a_soft_joint_is_the_derivative_of_the_exact_model(robot: Robot) -> None:
    force = np.array([[30.0, 50.0, 0.0, 0.0, 0.0, 0.0]] * 3) * np.array([[1.0], [-0.5], [0.2]])
    scene = build_model(robot, command_campaign(np.array([[0.4], [0.9], [-0.7]]), force))
    attained = solve_model_poses(scene)
    (signature,) = signatures(linearize_model(scene, attained))
    step = 1e-9
    softer = apply_effects(scene, [Effect("joint_stiffness", "one", None, {signature.keys[0]: step})])
    slope = (solve_model_poses(softer).position - attained.position) / step
    np.testing.assert_allclose(signature.twist[:, :3, 0], slope, rtol=2e-3, atol=1e-3)
