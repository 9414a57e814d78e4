from __future__ import annotations

import numpy as np
import pytest

from compplan.errors import InfeasibleError
from compplan.reproduce.service_sphere import serve_point, spread_directions
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import build_arm

POINT = np.array([1.3, 0.1, 0.2])
WRENCH = np.array([0.0, 200, 400, 0, 0, 0])


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
