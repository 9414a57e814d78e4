"""Collision solids: primitives, meshes, and their geometries in coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from compplan.robot import Array

#: Subdivisions of a mesh to cut out the tip zone.
CUT_ROUNDS = 6
#: Sides of a triangulated cylinder.
SECTIONS = 24


@dataclass(frozen=True)
class UrdfShape:
    """One collision shape of a URDF."""

    name: str  #: Name of its link, numbered if the link has several.
    link: str  #: Its link.
    #: ("box", size (3,)), ("cylinder" or "capsule", radius, length), ("sphere", radius) or a mesh (trimesh); the length
    #: of a capsule is that between its two centres. [m]
    form: Any
    placement: Array  #: Its pose in the link's frame. Shape (4, 4). [m]

    def mesh(self) -> Any:
        """The shape as a mesh (trimesh) in the frame of the link."""
        import trimesh

        own = isinstance(self.form, tuple)
        mesh = trimesh.Trimesh(*triangulate(self.form), process=False) if own else self.form.copy()
        return mesh.apply_transform(self.placement)

    @property
    def vertices(self) -> Array:
        """The vertices of that mesh. Shape (k, 3). [m]"""
        return triangulate(self.form)[0] @ self.placement[:3, :3].T + self.placement[:3, 3]


def triangulate(form: Any) -> tuple[Array, NDArray[np.int_]]:
    """Return vertices, shape (k, 3) [m], and outward triangles of a shape; those of primitives need no trimesh."""
    if not isinstance(form, tuple):
        return np.asarray(form.vertices, float), np.asarray(form.faces, int)
    kind, *sizes = form
    if kind == "box":
        return triangulate_box(-0.5 * np.asarray(sizes[0], float), 0.5 * np.asarray(sizes[0], float))
    half = np.array([0.0, 0.0, 0.0 if kind == "sphere" else 0.5 * sizes[1]])
    if kind == "cylinder":
        return triangulate_rod(-half, half, sizes[0], SECTIONS)
    turn, tilt = np.meshgrid(*(2.0 * np.pi * np.arange(count) / SECTIONS for count in (SECTIONS, SECTIONS // 4 + 1)))
    dome = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=2).reshape(-1, 3)
    both = np.vstack([sizes[0] * dome + half, -sizes[0] * dome - half])
    return _triangulate_hull(np.unique(both.round(12), axis=0))


def triangulate_box(low: Array, high: Array) -> tuple[Array, NDArray[np.int_]]:
    """Return corners, shape (8, 3) [m], and triangles, shape (12, 3), of a box between two corners. [m]"""
    at_high = np.indices((2, 2, 2)).reshape(3, 8).T
    return _triangulate_hull(np.where(at_high, np.asarray(high, float), np.asarray(low, float)))


def triangulate_rod(start: Array, end: Array, radius: float, sections: int) -> tuple[Array, NDArray[np.int_]]:
    """Return vertices, shape (2 m, 3) [m], and triangles of a cylinder of m sides between two points. [m]"""
    way = np.asarray(end, float) - start
    angle = 2.0 * np.pi * np.arange(sections) / sections
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sections)])
    ring = Rotation.align_vectors([way / np.linalg.norm(way)], [[0.0, 0.0, 1.0]])[0].apply(ring)
    return _triangulate_hull(np.vstack([ring + start, ring + end]))


def _triangulate_hull(corners: Array) -> tuple[Array, NDArray[np.int_]]:
    """Return vertices and outward triangles of a convex hull."""
    hull = ConvexHull(corners)
    faces = np.array(hull.simplices, int)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def make_geometry(form: Any, placement: Array | None = None) -> tuple[Any, Array, float, Array]:
    """Build the coal geometry of a shape, in the frame of the shape.

    Args:
        form: A mesh (trimesh), or a primitive as in `UrdfShape`.
        placement: Pose of the shape in the frame of the bounds. Shape (4, 4). [m]

    Returns:
        Geometry, centre (3,) and radius of its bounding sphere, bounding box (2, 3). [m]

    """
    import coal

    vertices, faces = triangulate(form)
    if placement is not None:
        vertices = vertices @ placement[:3, :3].T + placement[:3, 3]
    box = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    centre = box.mean(axis=0)
    radius = 1.01 * float(np.linalg.norm(vertices - centre, axis=1).max())
    if isinstance(form, tuple):
        kinds = {"box": coal.Box, "cylinder": coal.Cylinder, "capsule": coal.Capsule, "sphere": coal.Sphere}
        sizes = form[1] if form[0] == "box" else form[1:]
        return kinds[form[0]](*(float(size) for size in sizes)), centre, radius, box
    geometry = coal.BVHModelOBBRSS()
    geometry.beginModel(len(faces), len(vertices))
    geometry.addVertices(vertices)
    geometry.addTriangles(faces)
    geometry.endModel()
    return geometry, centre, radius, box


def cut_tip(mesh: Any, tip: Array, zone: float) -> Any:
    """Remove the part of a mesh within `zone` of the tip; None if nothing is left.

    Args:
        mesh: The tool (trimesh). [m]
        tip: Tool centre point in the mesh's frame. Shape (3,). [m]
        zone: Radius about the tip. [m]

    """
    import trimesh

    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    for count in range(CUT_ROUNDS + 1):
        corners = vertices[faces]
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        nearest = trimesh.triangles.closest_point(corners, np.tile(tip, (len(faces), 1)))
        near = np.linalg.norm(nearest - tip, axis=1) < zone
        inside = (np.linalg.norm(corners - tip, axis=2) < zone).all(axis=1)
        straddling = near & ~inside & (edges > 0.2 * zone)
        if zone <= 0 or count == CUT_ROUNDS or not straddling.any():
            break
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, face_index=np.flatnonzero(straddling))
    kept = faces[~near]
    return trimesh.Trimesh(vertices, kept, process=False) if len(kept) else None
