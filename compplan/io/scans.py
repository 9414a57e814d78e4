"""Detection of scan files: meshes, and point clouds without a header."""

from __future__ import annotations

from pathlib import Path

from compplan.io.tables import read_text

#: Endings of files that hold a mesh or a cloud of points.
MESHES, CLOUDS = (".stl", ".ply"), (".xyz", ".asc", ".pts")


def is_scan(file: Path) -> bool:
    """Return whether a file is a scan: by its ending, or a table whose first row has numbers alone."""
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
