"""A still picture of a robot and a path, for pages that cannot turn a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.files.transaction import replace_file
from compplan.report.robot_scene import EYE, Shape, place_shapes, shade_faces
from compplan.report.style import SEQUENTIAL
from compplan.robot import Array, Robot

#: Triangles are cut until no edge is longer, so that near ones cover far ones. [m]
LONGEST_EDGE = 0.05


def save_robot_picture(
    robot: Robot,
    q: Array,
    file: str | Path,
    *,
    path: Array | None = None,
    value: Array | None = None,
    label: str = "",
    width: int = 1200,
    height: int = 800,
) -> None:
    """Save a PNG of a robot in one pose, with a path coloured by a value.

    Args:
        robot: The robot.
        q: Joint positions. Shape (nq,). [rad or m]
        file: The PNG file.
        path: Path of the tool tip, base frame. Shape (n, 3). [m]
        value: What colours the path, in the unit that `label` names. Shape (n,).
        label: What the colour bar is called.
        width: Width of the picture. [px]
        height: Height of the picture. [px]
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0 if value is None else 0.88, 1.0))
    draw_robot_flat(axes, robot, q)
    if path is not None:
        _draw_path(figure, axes, path, value, label)
    axes.set_aspect("equal")
    axes.margins(0.04)
    axes.set_axis_off()
    with replace_file(file) as part:
        figure.savefig(part, format="png", transparent=False, facecolor="white")


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


def _draw_path(figure: Any, axes: Any, path: Array, value: Array | None, label: str) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap

    flat = project_points(path)
    axes.update_datalim(flat)
    if value is None:
        axes.plot(*flat.T, color=SEQUENTIAL[0][1], linewidth=2.0)
        return
    colours = LinearSegmentedColormap.from_list("deviation", list(SEQUENTIAL))
    pieces = list(np.stack([flat[:-1], flat[1:]], axis=1))
    lines = LineCollection(pieces, cmap=colours, linewidths=3.4, capstyle="round")
    lines.set_array((value[:-1] + value[1:]) / 2)
    axes.add_collection(lines)
    bar = figure.colorbar(lines, cax=figure.add_axes((0.9, 0.2, 0.014, 0.6)))
    bar.outline.set_visible(False)
    bar.set_label(label)


def _cut(shape: Shape) -> Shape:
    """Cut the triangles of a shape until none is long."""
    from trimesh.remesh import subdivide_to_size

    vertices, faces = subdivide_to_size(shape.vertices, shape.faces, LONGEST_EDGE, max_iter=12)
    return Shape(shape.link, np.asarray(vertices, float), np.asarray(faces, int), shape.colour)
