"""Triangles of boxes and cylinders, for drawings: trimesh makes the same, and takes half a second to load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.robot import Array

#: Triangles of a box whose corners count up in x, then y, then z, seen from outside counterclockwise.
BOX_FACES = np.array([
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
])  # fmt: skip


def triangulate_box(low: Array, high: Array) -> tuple[Array, NDArray[np.int_]]:
    """Return corners, shape (8, 3) [m], and triangles, shape (12, 3), of a box between two corners. [m]."""
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)[:, ::-1]
    return np.where(corners == 0, np.asarray(low, float), np.asarray(high, float)), BOX_FACES


def triangulate_cylinder(radius: float, length: float, sections: int) -> tuple[Array, NDArray[np.int_]]:
    """Return vertices, shape (2 m + 2, 3) [m], and triangles, shape (4 m, 3), of a cylinder along z about the origin.

    Args:
        radius: [m].
        length: [m].
        sections: Sides m of its outline.

    """
    angle = 2.0 * np.pi * np.arange(sections) / sections
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    ring = np.vstack([ring, [0.0, 0.0]])
    ends = [np.column_stack([ring, np.full(sections + 1, z)]) for z in (-length / 2, length / 2)]
    this, other = np.arange(sections), np.roll(np.arange(sections), -1)
    above, hub = sections + 1, np.full(sections, sections)
    faces = [
        (hub, other, this), (hub + above, this + above, other + above),
        (this, other, this + above), (other, other + above, this + above),
    ]  # fmt: skip
    return np.vstack(ends), np.vstack([np.column_stack(each) for each in faces])


def triangulate_rod(start: Array, end: Array, radius: float, sections: int) -> tuple[Array, NDArray[np.int_]]:
    """Return vertices [m] and triangles of a cylinder from a point to another, each of shape (3,). [m]."""
    way = np.asarray(end, float) - start
    length = float(np.linalg.norm(way))
    upright, faces = triangulate_cylinder(radius, length, sections)
    turn = Rotation.align_vectors([way / length], [[0.0, 0.0, 1.0]])[0]
    return turn.apply(upright) + 0.5 * (np.asarray(start, float) + end), faces
