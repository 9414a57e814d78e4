"""Meshes and point clouds read by trimesh (STL, PLY, OBJ), and their units."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.io.parsing import GREATEST, guard_parser
from compplan.io.tables import MOST_BYTES, read_text

#: Length of a unit. [m]
UNITS = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}


def open_mesh(file: Path, **how: Any) -> Any:
    """Read a file by trimesh with options `how`, in the unit of the file.

    Raises:
        InputError: If the file is missing, too large or cannot be read.
    """
    import trimesh

    logging.getLogger("trimesh").setLevel(
        logging.ERROR
    )  # normals that it cannot read are computed, without a traceback
    if not file.is_file():
        raise InputError("no mesh file", file=file)
    if file.stat().st_size > MOST_BYTES:
        raise InputError(f"holds more than {MOST_BYTES >> 20} MB, at most that is read", file=file)
    with guard_parser(file, f"cannot be read as {file.suffix[1:].upper() or 'a mesh'}"):
        return trimesh.load(file, **how)


def load_mesh(file: Path, unit: str = "mm") -> Any:
    """Read the triangles of a file, in metres.

    Raises:
        InputError: If the file is missing, cannot be read, holds no triangles, or one that is not finite or too large.
    """
    mesh = open_mesh(file, force="mesh")
    if not len(getattr(mesh, "faces", ())):
        raise InputError("holds no triangles", file=file)
    if not np.isfinite(mesh.vertices).all():
        raise InputError("has vertices that are not finite", file=file)
    if np.abs(mesh.vertices).max() > GREATEST:
        raise InputError(f"has vertices beyond {GREATEST:g} {unit}", file=file)
    return mesh.apply_scale(UNITS[unit])


#: Endings of files that hold a mesh or a cloud of points.
MESHES, CLOUDS = (".stl", ".ply"), (".xyz", ".asc", ".pts")


def is_scan(file: Path) -> bool:
    """Return whether a file is a scan: by its ending, or because its first row holds only numbers."""
    if file.suffix.lower() in (*MESHES, *CLOUDS):
        return True
    if not file.is_file():
        return False
    first = next((line for line in read_text(file).splitlines() if line.strip() and line.lstrip()[0] not in "#/"), "")
    return bool(first) and read_numbers(first) is not None


def read_numbers(line: str) -> list[float] | None:
    """Return the numbers of a line separated by spaces, commas or semicolons; None for other text."""
    try:
        return [float(word) for word in line.replace(",", " ").replace(";", " ").split()]
    except ValueError:
        return None
