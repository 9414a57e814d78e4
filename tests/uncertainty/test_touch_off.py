"""What the repeatability of touched points makes of the place of a part."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import compplan
from compplan.robot.pose import fit_displacement
from compplan.uncertainty.touch_off import TouchedPart


def test_the_spread_of_a_fitted_part_is_that_of_parts_fitted_to_drawn_points() -> None:
    """1000 draws: each coordinate of three points 100 mm apart with 20 um, the part fitted to them."""
    robot = compplan.load_robot("kuka_kr270")
    points = np.array([[1.7, 0.0, 0.9], [1.8, 0.0, 0.9], [1.7, 0.1, 0.9]])
    place = np.array([[1.75, 0.05, 0.88], [1.9, 0.2, 0.9]])
    touched = TouchedPart(robot, np.zeros((3, 6)), points, None, 2e-5)
    columns = touched.spread_part(place)
    random, off = np.random.default_rng(3), []
    for _ in range(1000):
        pose = fit_displacement(points, points + 2e-5 * random.standard_normal((3, 3)))
        off.append(place @ pose[:3, :3].T + pose[:3, 3] - place)
    seen = np.sqrt((np.array(off) ** 2).mean(axis=0))
    assert np.sqrt((columns**2).sum(axis=2)) == pytest.approx(seen, rel=0.1)


def test_a_part_follows_rigid_motions_of_its_points_exactly() -> None:
    robot = compplan.load_robot("kuka_kr270")
    points = np.array([[1.7, 0.0, 0.9], [1.8, 0.0, 0.9], [1.7, 0.1, 0.9]])
    touched = TouchedPart(robot, np.zeros((3, 6)), points, None)
    turn = Rotation.from_rotvec([1e-7, -2e-7, 3e-7])
    place = np.array([[1.75, 0.05, 0.88]])
    moved = (turn.apply(points) - points)[:, :, None]
    assert touched.follow(moved, place)[:, :, 0] == pytest.approx(turn.apply(place) - place, abs=1e-12)
