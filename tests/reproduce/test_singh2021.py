from __future__ import annotations

import numpy as np
import pytest

from compplan.reproduce.paper import Reproduction
from compplan.reproduce.singh2021 import DEXTEROUS, PEDESTALS, PLAIN, cloud, reach_around, reproduce, spread_directions
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.ik import build_arm


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return reproduce(load_robot)


def test_the_cloud_has_25_points_a_radius() -> None:
    points = cloud(0.8)
    assert points.shape == (25, 3)
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 0.8)
    assert set(np.round(points[:, 2], 9)) == {0.5, 0.7, 0.9, 1.1, 1.3}


def test_the_cloud_is_reached_from_a_pedestal_only(result: Reproduction) -> None:
    ground, raised = (
        result.row(f"125 points reached tool down, base {height:g} m above the ground") for height in PEDESTALS
    )
    assert ground.ours == "r = 0.4 m: 25, r = 0.6 m: 25, r = 0.8 m: 20, r = 1 m: 20, r = 1.2 m: 15"
    assert ground.verdict == "cannot be reproduced because the height of the pedestal is missing"
    assert str(raised.ours).count("25") == 5 and raised.verdict == "fitted"


def test_the_arithmetic_of_table_i_holds(result: Reproduction) -> None:
    rows = [row for row in result.rows if row.quantity.startswith("Table i:")]
    assert len(rows) == 6 and all(row.verdict == "arithmetic" and row.ours == row.paper for row in rows)


def test_the_stiffer_set_of_table_i_deflects_less(result: Reproduction) -> None:
    """Each stiffness is 2 to 40 % greater, and a deflection shrinks by the share of one of them at most."""
    shares = result.row("Improvement that the dexterous stiffness set of Table i alone makes").ours
    least, most = (float(text.strip("% ")) / 100 for text in str(shares).split("to"))
    gain = 1.0 - np.divide(PLAIN, DEXTEROUS)
    assert gain.min() - 0.005 <= least <= most <= gain.max() + 0.005
    assert gain.min() > 0.0


def test_numbers_that_hang_on_the_unknown_wrench_are_not_claimed(result: Reproduction) -> None:
    rows = [row for row in result.rows if row.quantity.startswith(("Growth", "Average improvement"))]
    assert len(rows) == 4
    assert all(row.verdict.startswith("cannot be reproduced because") for row in rows)
    ratios = result.row("Improvement of the largest deflections at r1, r3, r5")
    assert ratios.ours == "22%, 29%, 28%" and ratios.verdict == "inconsistent in the paper"


def test_directions_spread_evenly_and_are_reached_inside_the_limits() -> None:
    directions = spread_directions(500)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions.mean(axis=0), 0, atol=5e-3)
    np.testing.assert_allclose(directions.T @ directions / 500, np.eye(3) / 3, atol=5e-3)
    robot, point = load_robot("fanuc_m10ia"), np.array([1.3, 0.1, 0.2])
    q, owner = reach_around(build_arm(robot), point, spread_directions(60))
    assert 0.2 < len(np.unique(owner)) / 60 < 1
    assert ((q >= robot.lower - 2e-6) & (q <= robot.upper + 2e-6)).all()
    frames = locate_frames(build_chain(robot), q)
    np.testing.assert_allclose(frames.tcp_position, np.tile(point, (len(q), 1)), atol=1e-6)
    np.testing.assert_allclose(frames.tcp_rotation[:, :, 2], spread_directions(60)[owner], atol=1e-6)
