"""The drawing of an arm has no gaps: rods close what shapes for collision checks leave open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from compplan.reporting import figure as go
from compplan.reporting.reach_section import _fill_band
from compplan.reporting.robot_bridges import bridge_gaps
from compplan.reporting.robot_scene import locate_links, place_shapes
from compplan.robot import load_robot


def count_outside(shapes, points) -> int:
    """Points in none of the convex shapes, by their tetrahedra."""
    return int((np.array([Delaunay(shape.vertices).find_simplex(points) for shape in shapes]) < 0).all(axis=0).sum())


@pytest.mark.parametrize("name", ["kuka_kr16_2", "abb_irb6640_185_280"])
def test_from_the_wrist_to_the_flange_nothing_is_open(name: str) -> None:
    robot, q = load_robot(name), np.radians([20.0, -40.0, 60.0, 0.0, 70.0, 0.0])
    poses, shapes = locate_links(robot, q), place_shapes(robot, q)
    line = np.vstack([
        poses[a][:3, 3] + np.linspace(0.02, 0.98, 50)[:, None] * (poses[b][:3, 3] - poses[a][:3, 3])
        for a, b in (("link_3", "link_4"), ("link_5", robot.flange))
    ])  # fmt: skip
    bridges = bridge_gaps(robot, q, shapes)
    assert 0 < len(bridges) <= 4 and count_outside(shapes, line) > 0
    assert count_outside([*shapes, *bridges], line) == 0


def test_an_arm_that_is_drawn_from_meshes_is_left_as_it_is() -> None:
    robot, q = load_robot("kuka_kr16_2"), np.zeros(6)
    shapes = place_shapes(robot, q)
    fine = np.tile(shapes[0].faces, (100, 1))
    assert bridge_gaps(robot, q, [type(shapes[0])("link", shapes[0].vertices, fine, (1, 1, 1, 1)), *shapes]) == []


def test_the_band_is_filled_where_it_is_known_alone() -> None:
    figure = go.Figure(go.Scatter(x=[0, 1, 2, 3, 4, 5], y=[2, 2, np.nan, np.nan, 3, 3], name="true tip, 95 %"))
    _fill_band(figure)
    fill = figure.data[0]
    assert fill.x.tolist() == [0, 0, 1, 1, 2, 3, 4, 4, 5, 5] and fill.y.tolist() == [0, 2, 2, 0, 0, 0, 0, 3, 3, 0]
    assert figure.data[1].showlegend is False and fill.legendgroup == figure.data[1].legendgroup
