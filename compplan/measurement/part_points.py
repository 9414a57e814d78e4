"""Measured points of a cut part (tables, readings along normals, scans), and its nominal surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.in_memory import open_table
from compplan.io.meshes import MESHES, UNITS, is_scan, open_mesh, read_numbers
from compplan.io.parsing import LEAST_SIGMA, LEAST_SIGMA_MM
from compplan.io.tables import Table, read_text
from compplan.measurement.instrument import read_directions
from compplan.measurement.reading import rename_title
from compplan.robot import Array

#: Greatest distance of a measured point from the path. [m]
FARTHEST = 0.02
#: Default standard deviation of a scanned point (assumed: a laser line or structured light). [m]
SCAN_SIGMA = 5e-5
#: Greatest number of points; a larger scan is thinned evenly (assumed: fewer points suffice).
MOST_POINTS = 300_000
#: Columns of a table without a header.
AXES = ("x", "y", "z", "nx", "ny", "nz")
#: Samples of the surface; numbers of nearest samples whose triangles are searched: first, and again if the nearest
#: place is an edge.
SAMPLES, NEAR = 200_000, (3, 24)
#: Lengths are scaled to micrometres for trimesh, which treats products below 1e-12 as zero.
SCALE = 1e6
#: Least tangential share of a point's distance from the surface if its nearest place is an edge of the mesh.
SIDEWAYS = 0.2


def read_measured_points(source: Any) -> Table:
    """Read measured points from a file or columns: x_mm y_mm z_mm, optional s_mm and sigma_mm; or a scan.

    Raises:
        InputError: If the file is not such a table.
    """
    if isinstance(source, str | Path) and is_scan(Path(source)):
        return read_scan(Path(source))
    columns = [FileColumn(axis, "length", group="position") for axis in "xyz"]
    columns += [FileColumn("s", "length"), FileColumn("sigma", "length", missing=True), FileColumn("reading", "length")]
    columns += [FileColumn(f"dir_{axis}", group="direction") for axis in "ijk"]
    columns.append(FileColumn("q1", ("angle", "length")))
    table = open_table(source, columns, what="measured points", rename=rename_title)
    if "q1" in table:
        raise table.error("has joints, expected measured points of a part; compplan diagnose takes a log of poses")
    if "column 'distance_mm' is not read" in table.notes:
        raise table.error("distance_mm of a ball bar shows no part; compplan diagnose takes a log of it")
    if "x" not in table:
        raise table.error("missing column x_mm or x_m, expected x_mm y_mm z_mm of every point")
    if not len(table):
        raise table.error("the table has no rows, expected one row a measured point")
    sigma = table.values.get("sigma", np.full(len(table), np.nan))
    wrong = (sigma < LEAST_SIGMA) | (sigma > FARTHEST)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        message = f"sigma_mm is {sigma[row] * 1e3:g}, expected {LEAST_SIGMA_MM:g} to {FARTHEST * 1e3:g} mm"
        raise table.error(f"{message}; leave it empty where it is unknown", row)
    return _probe_points(table)


def _probe_points(table: Table) -> Table:
    """Convert readings along a direction, from nominal points, to points with normals; other tables are unchanged.

    Raises:
        InputError: If a reading has no direction, or one that is not a unit vector.
    """
    if "reading" not in table:
        return table
    if "column 'contact' is not read" in table.notes:
        raise table.error("contact beside reading_mm: an unknown zero; leave it out and use --align best_fit")
    unit = read_directions(table, np.ones(len(table), bool))
    point = table.stack(["x", "y", "z"]) + table.values["reading"][:, None] * unit
    found = {**dict(zip("xyz", point.T, strict=True)), **dict(zip(("nx", "ny", "nz"), unit.T, strict=True))}
    headers = {**table.headers, "nx": "dir_i", "ny": "dir_j", "nz": "dir_k"}
    return replace(table, values={**table.values, **found}, headers=headers)


def is_scanned(table: Table) -> bool:
    """Return whether points are those of a scan: only tables of `read_scan` have no unit."""
    return table.units.get("x") == ""


def find_repeated_points(table: Table) -> NDArray[np.bool_]:
    """Mark points that repeat an earlier row exactly, but no probe readings, which rounding makes equal. Shape (m,)."""
    if "reading" in table:
        return np.zeros(len(table), bool)
    values = np.stack([np.nan_to_num(column, nan=np.inf) for column in table.values.values()], axis=1)
    again = np.ones(len(table), bool)
    again[np.unique(values, axis=0, return_index=True)[1]] = False
    return again


def read_scan(file: Path) -> Table:
    """Read a scan in millimetres: columns x y z, and nx ny nz if it has normals. [m]

    Raises:
        InputError: With file and line, if it has no points, or rows that are not numeric.
    """
    found = _read_mesh(file) if file.suffix.lower() in MESHES else _read_cloud(file)
    if not len(found):
        raise InputError("the scan has no points", file=file)
    if not np.isfinite(found).all():
        bad = int((~np.isfinite(found).all(axis=1)).sum())
        raise InputError(f"{bad} of {len(found)} points of the scan are not finite; remove them", file=file)
    notes = []
    if len(found) > MOST_POINTS:
        step = -(-len(found) // MOST_POINTS)
        notes.append(f"every {step}th of {len(found)} points of the scan is used")
        found = found[::step]
    values = {axis: found[:, k] * 1e-3 for k, axis in enumerate("xyz")}
    if found.shape[1] == 6:
        length = np.linalg.norm(found[:, 3:], axis=1)
        unit = found[:, 3:] / np.where(length > 0, length, 1.0)[:, None]
        values |= {axis: unit[:, k] for k, axis in enumerate(AXES[3:])}
    names = {key: key for key in values}
    return Table(file, values, {}, names, dict.fromkeys(values, ""), np.arange(1, len(found) + 1), tuple(notes))


def _read_mesh(file: Path) -> Array:
    """Read vertices, and normals of a mesh or those stored in a cloud. Shape (n, 3 or 6). [mm]"""
    found = open_mesh(file)
    if isinstance(found, trimesh.Trimesh) and len(found.faces):
        return np.hstack([np.asarray(found.vertices, float), np.asarray(found.vertex_normals, float)])
    points = np.asarray(getattr(found, "vertices", np.zeros((0, 3))), float).reshape(-1, 3)
    raw = found.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if raw is not None and getattr(raw, "dtype", None) is not None and {"nx", "ny", "nz"} <= set(raw.dtype.names or ()):
        normals = np.column_stack([np.asarray(raw[axis], float).reshape(-1) for axis in AXES[3:]])
        if len(normals) == len(points):
            return np.hstack([points, normals])
    return points


def _read_cloud(file: Path) -> Array:
    """Read rows of three or six numbers. Shape (n, 3 or 6). [mm]"""
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(file).splitlines(), 1):
        if not line.strip() or line.lstrip()[0] in "#/":
            continue
        row = read_numbers(line)
        if row is None or len(row) < 3:
            message = f"row {line.strip()[:40]!r}, expected x y z [nx ny nz] in mm, numbers alone"
            raise InputError(message, file=file, where=number)
        rows.append(row)
    width = min((len(row) for row in rows), default=3)
    return np.array([row[: 6 if width == 6 else 3] for row in rows]).reshape(-1, 6 if width == 6 else 3)


@dataclass(frozen=True, eq=False)
class Surface:
    """A nominal surface; f triangles."""

    corners: Array  #: Corners of the triangles. Shape (f, 3, 3). [m]
    reach: float  #: Greatest distance from the tip at which the tool cuts. [m]

    @cached_property
    def normals(self) -> Array:
        """Return the unit normals. Shape (f, 3)."""
        normal = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    @cached_property
    def _samples(self) -> tuple[cKDTree, Array]:
        """Return samples of the triangles, including their centroids, and the triangle of each sample."""
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

        Returns the places (m, 3) [m], their normals (m, 3), and the distance of each point along the normal (m,) [m];
        NaN if the nearest place is an edge and the point is not above the surface.
        """
        place, normal, off = self._find_among(point, NEAR[0])
        beside = np.flatnonzero(np.isnan(off))
        if len(beside):
            place[beside], normal[beside], off[beside] = self._find_among(point[beside], NEAR[1])
        return place, normal, off

    def _find_among(self, point: Array, count: int) -> tuple[Array, Array, Array]:
        """Find the nearest places on the triangles of the `count` nearest samples; see `find_nearest`."""
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
        """Transform the surface to another frame by its pose in that frame, shape (4, 4) [m]."""
        return replace(self, corners=self.corners @ pose[:3, :3].T + pose[:3, 3])


def read_surface(file: Path, reach: float) -> Surface:
    """Read the mesh of a nominal part in millimetres; reach: greatest distance of the cut from the tip [m].

    Raises:
        InputError: If the file is not a mesh with triangles.
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
