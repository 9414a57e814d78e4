"""Collision solids: primitives, meshes, and their geometries in coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from compplan.robot import Array

#: Subdivisions of a mesh to cut out the tip zone.
CUT_ROUNDS = 6
#: Sides of a triangulated cylinder.
SECTIONS = 24


@dataclass(frozen=True)
class UrdfShape:
    """One collision shape of a URDF."""

    name: str  #: Name of its link, numbered where the link has several.
    link: str  #: Its link.
    #: ("box", size (3,)), ("cylinder" or "capsule", radius, length), ("sphere", radius) or a mesh (trimesh); the length
    #: of a capsule is that between its two centres. [m]
    form: Any
    placement: Array  #: Its pose in the link's frame. Shape (4, 4). [m]

    def mesh(self) -> Any:
        """The shape as a mesh in the frame of the link."""
        return as_mesh(self.form).apply_transform(self.placement)


def as_mesh(form: Any) -> Any:
    """Return a shape as a mesh (trimesh)."""
    import trimesh

    if not isinstance(form, tuple):
        return form.copy()
    if form[0] == "box":
        return trimesh.creation.box(form[1])
    if form[0] == "cylinder":
        return trimesh.creation.cylinder(form[1], form[2], sections=SECTIONS)
    if form[0] == "capsule":
        return trimesh.creation.capsule(height=form[2], radius=form[1], count=[SECTIONS, SECTIONS])
    return trimesh.creation.icosphere(subdivisions=2, radius=form[1])


def make_geometry(form: Any, placement: Array | None = None) -> tuple[Any, Array, float, Array]:
    """Build the coal geometry of a shape, in its own frame.

    Args:
        form: A mesh (trimesh), or a primitive as in `UrdfShape`.
        placement: Pose of the shape in the frame of the bounds. Shape (4, 4). [m]

    Returns:
        Geometry, centre (3,) and radius of its bounding sphere, bounding box (2, 3). [m]

    """
    import coal

    mesh = as_mesh(form)
    if placement is not None:
        mesh.apply_transform(placement)
    box = np.array(mesh.bounds)
    centre = box.mean(axis=0)
    radius = 1.01 * float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    if isinstance(form, tuple):
        kinds = {"box": coal.Box, "cylinder": coal.Cylinder, "capsule": coal.Capsule, "sphere": coal.Sphere}
        sizes = form[1] if form[0] == "box" else form[1:]
        return kinds[form[0]](*(float(size) for size in sizes)), centre, radius, box
    geometry = coal.BVHModelOBBRSS()
    geometry.beginModel(len(mesh.faces), len(mesh.vertices))
    geometry.addVertices(np.asarray(mesh.vertices, float))
    geometry.addTriangles(np.asarray(mesh.faces))
    geometry.endModel()
    return geometry, centre, radius, box


def cut_tip(mesh: Any, tip: Array, zone: float) -> Any:
    """Remove the part of a mesh within `zone` of the tip; None where nothing is left.

    Args:
        mesh: The tool (trimesh). [m]
        tip: Tool centre point in the mesh's frame. Shape (3,). [m]
        zone: Radius about the tip. [m]

    """
    import trimesh

    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    for _ in range(CUT_ROUNDS):
        corners = vertices[faces]
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        nearest = trimesh.triangles.closest_point(corners, np.tile(tip, (len(faces), 1)))
        near = np.linalg.norm(nearest - tip, axis=1) < zone
        inside = (np.linalg.norm(corners - tip, axis=2) < zone).all(axis=1)
        straddling = near & ~inside & (edges > 0.2 * zone)
        if zone <= 0 or not straddling.any():
            break
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, face_index=np.flatnonzero(straddling))
    corners = vertices[faces]
    nearest = trimesh.triangles.closest_point(corners, np.tile(tip, (len(faces), 1)))
    kept = faces[np.linalg.norm(nearest - tip, axis=1) >= zone]
    return trimesh.Trimesh(vertices, kept, process=False) if len(kept) else None
