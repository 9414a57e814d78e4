"""Rival explanations: what a campaign cannot tell apart stands in the folder with its weight, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_robots import draw_values

import compplan as cp
from compplan.effects import solve_model_poses
from compplan.uncertainty.perturbation import build_varied_model, vary_model

SIGMA = 3e-5


def test_a_soft_first_joint_and_a_soft_base_are_as_probable_and_do_the_same() -> None:
    """Joint 1 turns about the base's z: its spring and one of the base plate about z cannot be told apart, ever."""
    robot, random = cp.load_robot("kuka_kr270"), np.random.default_rng(3)
    n, key = 30, "compliance_change_rad_per_Nm"
    soft = 0.8 * next(spring.compliance for spring in robot.springs if spring.joint == "joint_1")
    q = np.radians([0.0, -60, 100, 0, 40, 0]) + random.uniform(-0.6, 0.6, (n, 6))
    wrench = np.zeros((n, 6))
    wrench[:, 1], wrench[:, 2] = np.where(np.arange(n) % 2, 900.0, 0.0), -300.0
    rows = cp.Campaign(np.array(["static"] * n), q, wrench, np.zeros((n, 3)), sigma=np.full(n, SIGMA))
    truth = [cp.Effect("joint_stiffness", "joint_1", None, {key: soft})]
    seen = cp.solve_model_poses(cp.apply_effects(cp.build_model(robot, rows), truth)).position
    log = cp.Campaign(rows.run, q, wrench, seen + random.normal(0.0, SIGMA, seen.shape), sigma=rows.sigma)
    updated = cp.diagnose_campaign(robot, log, without=("wrench_scale", "wrench_bias")).updated

    known = updated.uncertainty
    assert known is not None
    (rival,) = known.rivals
    assert {rival.explanation, rival.instead} == {"joint_stiffness joint_1", "base_compliance rz"}
    assert rival.weight == pytest.approx(0.5, abs=1e-3)
    moved = rival.shift[np.flatnonzero(rival.shift)]
    assert sorted(moved) == pytest.approx([-soft, soft], rel=0.03)
    # whichever it is: where the tip goes under these loads is the same
    scene = build_varied_model(updated, log)
    tips = [solve_model_poses(vary_model(scene, known.unknowns, s)).position for s in (0.0 * rival.shift, rival.shift)]
    assert np.abs(tips[1] - tips[0]).max() < 0.1 * SIGMA
    # every second robot that is drawn has the other spring
    first = np.flatnonzero(rival.shift)[0]
    there = np.abs(draw_values(known, 400, 1)[:, first]) > 0.5 * soft * known.calibration
    assert there.mean() == pytest.approx(0.5, abs=0.08)
    assert known.width[first] >= known.calibration * np.sqrt(0.5) * abs(rival.shift[first]) * (1.0 - 1e-6)
