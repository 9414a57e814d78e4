from __future__ import annotations

import numpy as np
import pytest

from compplan.reproduce.dumas2011 import (
    MASS_KG,
    TESTS,
    DexterityMap,
    draw_tests,
    identify,
    map_quality,
    mean_inside,
    monte_carlo,
)
from compplan.robot import load_robot
from compplan.statics.chain import build_chain
from compplan.statics.stiffness import complementary_influence

ROBOT = load_robot("kuka_kr240")
CHAIN = build_chain(ROBOT)


@pytest.fixture(scope="module")
def quality() -> DexterityMap:
    return map_quality(ROBOT, CHAIN)


def test_the_zones_are_half_again_as_dexterous_as_the_rest(quality: DexterityMap) -> None:
    inside, outside = mean_inside(quality)
    assert inside["Z1"] == pytest.approx(0.508, abs=0.02)
    assert inside["Z2"] == pytest.approx(0.505, abs=0.02)
    assert inside["Z3"] == pytest.approx(0.460, abs=0.02)
    assert outside == pytest.approx(0.291, abs=0.02)
    assert min(inside.values()) > 1.5 * outside
    assert quality.length == pytest.approx(0.8, abs=0.1)


def test_the_folded_arm_is_a_singular_line(quality: DexterityMap) -> None:
    row = int(np.abs(np.degrees(quality.joints["theta_3"]) + 87).argmin())
    assert quality.inverse_condition[row].max() < 0.005


def test_k_c_is_negligible_under_the_robots_payload(quality: DexterityMap) -> None:
    weight = np.array([0, 0, -9.81 * MASS_KG, 0, 0, 0])
    influence = complementary_influence(CHAIN, quality.q.reshape(-1, 6), weight)
    assert 1e-4 < influence.nu_p.max() < 0.016
    assert np.degrees(influence.nu_r.max()) < 0.025


def test_joint_one_cannot_be_told_under_vertical_loads() -> None:
    found = identify(ROBOT, draw_tests(ROBOT, TESTS, np.random.default_rng(0)))
    assert [item.held for item in found.held] == ["joint_1"]
    assert found.free[1:].all()
    true = [spring.compliance for spring in ROBOT.springs]
    np.testing.assert_allclose(found.model_values[1:], true[1:], rtol=1e-4)


def test_joint_six_needs_a_load_beside_its_axis() -> None:
    found = identify(ROBOT, draw_tests(ROBOT, TESTS, np.random.default_rng(0), lever=0.0))
    assert {item.held for item in found.held} == {"joint_1", "joint_6"}


def test_the_errors_of_joints_two_to_six_are_a_few_per_cent() -> None:
    stiffness = 1 / monte_carlo(ROBOT, 25)[:, 1:]
    error = stiffness.std(axis=0) / stiffness.mean(axis=0)
    assert (error > 0.01).all() and (error < 0.2).all()
