"""The nominal surface of a part, a mesh: where scanned points should lie, and how far along its normal they do not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.io.meshes import UNITS, open_mesh
from compplan.learning.scan import MESHES
from compplan.robot import Array

#: Samples that the triangles near a point are found by; how many of them are looked at first, and where that leaves a
#: point beside an edge.
SAMPLES, NEAR = 200_000, (3, 24)
#: Lengths are compared in micrometres: trimesh takes products below 1e-12 for zero.
SCALE = 1e6
#: A point whose nearest place is an edge of the mesh is off it sideways by more than this share of its distance.
SIDEWAYS = 0.2


@dataclass(frozen=True, eq=False)
class Surface:
    """A nominal surface; f triangles."""

    corners: Array  #: Corners of the triangles. Shape (f, 3, 3). [m]
    reach: float  #: How far from the path of the tip the tool makes it. [m]

    @cached_property
    def normals(self) -> Array:
        """Unit normals. Shape (f, 3)."""
        normal = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    @cached_property
    def _samples(self) -> tuple[cKDTree, Array]:
        """Return places on the triangles, their middles among them, and the triangle of each."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        random = np.random.default_rng(0)
        more = random.choice(len(area), size=SAMPLES, p=area / area.sum())
        share = random.random((SAMPLES, 2))
        share = np.where(share.sum(axis=1, keepdims=True) > 1.0, 1.0 - share, share)
        places = self.corners[more, 0] + np.einsum("nk,nki->ni", share, edges[more])
        return cKDTree(np.vstack([self.corners.mean(axis=1), places])), np.r_[np.arange(len(area)), more]

    def find_nearest(self, point: Array) -> tuple[Array, Array, Array]:
        """Find the nearest places of the surface to points, (m, 3). [m]

        Returns the places (m, 3) [m], the normals there (m, 3), and how far each point is off along it (m,) [m]; NaN
        where the nearest place is an edge that the point lies beside.
        """
        place, normal, off = self._find_among(point, NEAR[0])
        beside = np.flatnonzero(np.isnan(off))
        if len(beside):
            place[beside], normal[beside], off[beside] = self._find_among(point[beside], NEAR[1])
        return place, normal, off

    def _find_among(self, point: Array, count: int) -> tuple[Array, Array, Array]:
        """Find the nearest places on the triangles of the nearest samples, as `find_nearest`."""
        tree, of = self._samples
        triangle = of[tree.query(point, k=count)[1]]
        best, found, distance = triangle[:, 0], np.zeros_like(point), np.full(len(point), np.inf)
        for column in triangle.T:
            foot = trimesh.triangles.closest_point(SCALE * self.corners[column], SCALE * point) / SCALE
            away = np.linalg.norm(point - foot, axis=1)
            nearer = away < distance - 1e-12
            best, distance = np.where(nearer, column, best), np.where(nearer, away, distance)
            found = np.where(nearer[:, None], foot, found)
        normal = self.normals[best]
        off = np.einsum("mi,mi->m", point - found, normal)
        aside = np.linalg.norm(point - found - off[:, None] * normal, axis=1)
        return found, normal, np.where(aside > SIDEWAYS * distance + 1e-9, np.nan, off)

    def move(self, pose: Array) -> Surface:
        """Bring the surface to another frame by its pose there, shape (4, 4) [m]."""
        return replace(self, corners=self.corners @ pose[:3, :3].T + pose[:3, 3])


def read_surface(file: Path, reach: float) -> Surface:
    """Read the mesh of a nominal part in millimetres, made within a reach of the path of the tip. [m]

    Raises:
        InputError: If it is no mesh with triangles.
    """
    if file.suffix.lower() not in MESHES:
        raise InputError(f"ends in {file.suffix!r}, expected a nominal mesh: .stl or .ply", file=file)
    found = open_mesh(file, process=False, force="mesh")
    corners = np.asarray(getattr(found, "triangles", np.zeros((0, 3, 3))), float) * UNITS["mm"]
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    corners = corners[np.isfinite(corners).all(axis=(1, 2)) & (flat > 1e-16)]
    if not len(corners):
        raise InputError("the nominal mesh has no triangles", file=file)
    return Surface(corners, reach)
