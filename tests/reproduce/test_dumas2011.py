from __future__ import annotations

import numpy as np
import pytest

from compplan.errors import InfeasibleError
from compplan.reproduce.dumas2011 import (
    MASS_KG,
    TESTS,
    draw_tests,
    identify,
    map_quality,
    monte_carlo,
    zones_of_table_1,
)
from compplan.reproduce.service_sphere import serve_point, spread_directions
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import build_arm
from compplan.statics.quality import DexterityMap, mean_inside
from compplan.statics.stiffness import complementary_influence

ROBOT = load_robot("kuka_kr240")
CHAIN = build_chain(ROBOT)
POINT = np.array([1.3, 0.1, 0.2])
WRENCH = np.array([0.0, 200, 400, 0, 0, 0])


@pytest.fixture(scope="module")
def quality() -> DexterityMap:
    return map_quality(ROBOT, CHAIN)


def test_the_zones_are_half_again_as_dexterous_as_the_rest(quality: DexterityMap) -> None:
    inside, outside = mean_inside(quality, zones_of_table_1())
    assert inside["Z1"] == pytest.approx(0.508, abs=0.02)
    assert inside["Z2"] == pytest.approx(0.505, abs=0.02)
    assert inside["Z3"] == pytest.approx(0.460, abs=0.02)
    assert outside == pytest.approx(0.291, abs=0.02)
    assert min(inside.values()) > 1.5 * outside
    assert quality.length == pytest.approx(0.8, abs=0.1)


def test_the_folded_arm_is_a_singular_line(quality: DexterityMap) -> None:
    row = int(np.abs(np.degrees(quality.second) + 87).argmin())
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


def test_directions_spread_evenly() -> None:
    directions = spread_directions(500)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions.mean(axis=0), 0, atol=5e-3)
    np.testing.assert_allclose(directions.T @ directions / 500, np.eye(3) / 3, atol=5e-3)


def test_every_direction_that_counts_is_reached_inside_the_limits() -> None:
    robot = load_robot("fanuc_m10ia")
    sphere = serve_point(build_arm(robot), POINT, WRENCH, 0.3, 60)
    assert 0.2 < sphere.share < 1
    q = sphere.q[sphere.reached]
    assert ((q >= robot.lower - 2e-6) & (q <= robot.upper + 2e-6)).all()
    frames = locate_frames(build_chain(robot), q)
    np.testing.assert_allclose(frames.tcp_position, np.tile(POINT, (len(q), 1)), atol=1e-6)
    np.testing.assert_allclose(frames.tcp_rotation[:, :, 2], sphere.direction[sphere.reached], atol=1e-6)


def test_the_directions_go_by_the_deflection_under_the_wrench() -> None:
    robot = load_robot("fanuc_m10ia")
    sphere = serve_point(build_arm(robot), POINT, WRENCH, 0.3, 60)
    best, worst = int(np.nanargmin(sphere.deflection)), int(np.nanargmax(sphere.deflection))
    assert sphere.deflection[best] < 0.7 * sphere.deflection[worst]
    moved = cartesian_compliance(build_chain(robot), sphere.q[[best]])[0] @ WRENCH
    assert np.linalg.norm(moved[:3]) == pytest.approx(sphere.deflection[best])


def test_demanding_dexterity_leaves_fewer_directions() -> None:
    arm = build_arm(load_robot("fanuc_m10ia"))
    free, demanding = (serve_point(arm, POINT, WRENCH, 0.3, 60, least_dexterity=least) for least in (0.0, 0.3))
    assert 0 < demanding.share < free.share
    assert np.nanmin(demanding.inverse_condition) >= 0.3


def test_a_point_out_of_reach_is_answered() -> None:
    with pytest.raises(InfeasibleError, match="no direction reaches"):
        serve_point(build_arm(load_robot("fanuc_m10ia")), np.array([3.0, 0, 0]), WRENCH, 0.3, 10)
