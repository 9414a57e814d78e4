"""Boxes and cylinders are drawn as trimesh draws them: closed, outward, of their volume."""

import numpy as np
import pytest
import trimesh

from compplan.robot.primitives import triangulate_box, triangulate_cylinder, triangulate_rod


def test_a_box_is_closed_and_faces_outward() -> None:
    low, high = np.array([-1.0, 2.0, 0.5]), np.array([3.0, 2.5, 4.0])
    mesh = trimesh.Trimesh(*triangulate_box(low, high), process=False)
    assert mesh.is_watertight and mesh.volume == pytest.approx(np.prod(high - low))
    assert np.allclose(mesh.bounds, [low, high])


def test_a_cylinder_is_closed_and_is_that_of_trimesh() -> None:
    mesh = trimesh.Trimesh(*triangulate_cylinder(0.3, 1.2, sections=28), process=False)
    other = trimesh.creation.cylinder(0.3, 1.2, sections=28)
    assert mesh.is_watertight and mesh.volume == pytest.approx(other.volume)
    assert np.allclose(mesh.bounds, other.bounds)


def test_a_rod_goes_from_point_to_point_also_straight_down() -> None:
    for end in ([0.4, -0.2, 1.0], [0.1, 0.2, -3.0]):
        start = np.array([0.1, 0.2, 0.3])
        mesh = trimesh.Trimesh(*triangulate_rod(start, np.array(end), 0.05, sections=20), process=False)
        other = trimesh.creation.cylinder(0.05, segment=[start, end], sections=20)
        assert mesh.is_watertight and mesh.volume == pytest.approx(other.volume)
        assert np.allclose(mesh.center_mass, other.center_mass)
