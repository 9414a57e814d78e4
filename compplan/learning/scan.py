"""Scans of a cut part: STL, PLY, XYZ and tables without a head, as points with normals where they have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from compplan.errors import InputError
from compplan.io.meshes import open_mesh
from compplan.io.scans import MESHES, read_numbers
from compplan.io.tables import Table, read_text
from compplan.robot import Array

#: Standard deviation of a scanned point where nothing states one (assumed: a laser line or a structured light). [m]
SCAN_SIGMA = 5e-5
#: Most points that are read; of more an even part is taken (assumed: a part is known long before).
MOST_POINTS = 300_000
#: Columns of a table without a head.
AXES = ("x", "y", "z", "nx", "ny", "nz")


def read_scan(file: Path) -> Table:
    """Read a scan in millimetres: columns x y z, and nx ny nz where it has normals. [m]

    Raises:
        InputError: With file and line, if it holds no points, or anything else than numbers.
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
    """Read vertices and their normals, those of a cloud where it has them. Shape (n, 3 or 6). [mm]"""
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
