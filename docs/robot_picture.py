"""A still picture of a robot, for pages that cannot turn a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from compplan.reporting.scenes import EYE, Shape, place_shapes, shade_faces
from compplan.robot import Array, Robot

#: Triangles are cut until no edge is longer, so that near ones cover far ones. [m]
LONGEST_EDGE = 0.05


def draw_robot_flat(axes: Any, robot: Robot, q: Array) -> None:
    """Draw a robot into matplotlib axes as a parallel projection; see `project_points` for further points.

    Args:
        axes: Matplotlib axes, plain 2D.
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]
    """
    from matplotlib.collections import PolyCollection

    shapes = [_cut(shape) for shape in place_shapes(robot, q)]
    if not shapes:
        return
    corners = np.concatenate([shape.vertices[shape.faces] for shape in shapes])
    colours = shade_faces(shapes)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = normal @ EYE > 0
    corners, colours = corners[seen], colours[seen]
    order = np.argsort(corners.mean(axis=1) @ EYE)
    flat = project_points(corners[order].reshape(-1, 3)).reshape(-1, 3, 2)
    paint = colours[order]
    axes.add_collection(PolyCollection(list(flat), facecolors=paint, edgecolors=paint, linewidths=0.4))
    axes.update_datalim(flat.reshape(-1, 2))


def project_points(points: Array) -> Array:
    """Project points along the view of every robot picture.

    Args:
        points: Base frame. Shape (n, 3). [m]

    Returns:
        To the right and up. Shape (n, 2). [m]
    """
    eye = EYE / np.linalg.norm(EYE)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    return np.asarray(points @ np.column_stack([right, np.cross(eye, right)]))


def _cut(shape: Shape) -> Shape:
    """Cut the triangles of a shape until none is long."""
    from trimesh.remesh import subdivide_to_size

    vertices, faces = subdivide_to_size(shape.vertices, shape.faces, LONGEST_EDGE, max_iter=12)
    return Shape(shape.link, np.asarray(vertices, float), np.asarray(faces, int), shape.colour)
