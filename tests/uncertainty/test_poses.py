"""Poses that a ladder forecasts: what they see of the arm, behind unknown frames and with held joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.effects import solve_model_poses
from compplan.measurement.pose_selection import approach_poses, draw_postures
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.ladder import observe_poses
from compplan.uncertainty.posture_errors import vary_response
from compplan.uncertainty.sensitivities import build_path_model, measure_slopes, vary_model

POSTURE = np.radians([0.0, -60, 80, 10, 50, 5])
SIGMA = 4e-5


def soft_joints(*joints: int, deviation: float = 1e-7) -> tuple[Unknown, ...]:
    key = ("compliance_change_rad_per_Nm",)
    return tuple(Unknown("joint_stiffness", f"joint_{k}", None, key, np.array([deviation])) for k in joints)


def foresee(known: Uncertainty, pull: float) -> tuple[np.ndarray, np.ndarray]:
    """Deviation of each z after twelve poses, and what the poses see of each."""
    robot, q = load_robot("kuka_kr270"), POSTURE + 0.1 * np.arange(6) * np.linspace(0, 1, 5)[:, None]
    scene = build_path_model(robot, q, np.tile([400.0, 900.0, -600.0, 0, 0, 0], (5, 1)))
    target = measure_slopes(scene, known.unknowns, np.arange(5)) @ known.spread
    seen = observe_poses(robot, known, target, q, 0.5, 12, pull, SIGMA**2)
    after = np.linalg.inv(np.eye(seen.shape[1]) + seen.T @ seen / SIGMA**2)
    return np.sqrt(np.diag(after)), np.linalg.norm(seen, axis=0)


def test_a_zero_that_turns_the_whole_arm_is_not_seen_by_a_tracker_anywhere() -> None:
    zeros = tuple(Unknown("joint_offset", f"joint_{k}", None, ("offset_rad",), np.array([1e-4])) for k in (1, 2, 3))
    left, seen = foresee(Uncertainty("assumed", "made up", zeros, np.eye(3)), 400.0)
    assert seen[0] == pytest.approx(0.0, abs=1e-9)
    assert left[0] == pytest.approx(1.0, rel=1e-6)
    assert (left[1:] < 0.5).all()


def test_only_a_pull_shows_how_soft_the_vertical_first_joint_is() -> None:
    known = Uncertainty("assumed", "made up", soft_joints(1, 2, 3), np.eye(3))
    assert foresee(known, 0.0)[0][0] == pytest.approx(1.0, rel=1e-3)
    assert foresee(known, 400.0)[0][0] < 0.5


def test_what_the_force_moves_changes_with_the_compliance_as_by_difference() -> None:
    robot, wrench = load_robot("kuka_kr270"), np.array([[400.0, 900.0, -600.0, 0, 0, 0]])
    unknowns = soft_joints(2, deviation=1e-8)

    def answer(change: float) -> np.ndarray:
        pushed, still = (vary_model(build_path_model(robot, POSTURE[None], w), unknowns, np.array([change]))
                         for w in (wrench, 0.0 * wrench))  # fmt: skip
        return np.asarray(solve_model_poses(pushed).position - solve_model_poses(still).position)

    found = vary_response(build_path_model(robot, POSTURE[None], wrench), np.arange(1),
                          Uncertainty("assumed", "made up", unknowns, np.eye(1)))  # fmt: skip
    half = 0.5 * (answer(1e-8) - answer(-1e-8))
    assert found[:, :, 0] == pytest.approx(half, abs=0.01 * np.abs(half).max())


def test_a_held_joint_stays_in_every_posture_and_approach() -> None:
    robot = load_robot("kuka_kr270")
    fixed = {"lower": POSTURE[3], "upper": POSTURE[3]}
    joints = tuple(replace(joint, **fixed) if joint.name == "joint_4" else joint for joint in robot.joints)
    held = replace(robot, joints=joints)
    drawn = draw_postures(held, POSTURE[None], 0.5, 0, 200)
    assert len(drawn) > 20
    log = approach_poses(held, drawn, np.ones(len(drawn)), np.zeros((len(drawn), 3)))
    assert (log.q[:, 3] == POSTURE[3]).all()
    assert (np.abs(log.q[::2, :3] - log.q[1::2, :3]) > 0.0).all()
