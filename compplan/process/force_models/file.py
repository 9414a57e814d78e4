"""Force model with a wrench along the path from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.toolpath.contact import ForceTable, Frame, cutting_progress
from compplan.toolpath.toolpath import WRENCH, Toolpath, interpolate

words = "wrench of a CSV file along the path"
FILE_COLUMNS = (
    FileColumn("s", "length"),
    *(FileColumn(name, "force", required=True) for name in WRENCH[:3]),
    *(FileColumn(name, "moment", group="moment") for name in WRENCH[3:]),
)


class FileProcess(ForceTable):
    """A CSV file with fx_N .. mz_Nm: one row a waypoint, or any number of rows with s_mm, the length cut so far."""

    model: Literal["file"]
    file: str
    frame: Frame = "part"


def read_wrench(process: FileProcess, nominal: Toolpath, folder: Path, rows_at: Array | None) -> Array:
    """Return the wrench of a file at every waypoint, in the frame of the file. Shape (n, 6)."""
    table = read_table(folder / process.file, FILE_COLUMNS)
    rows = np.column_stack([table.values[key] if key in table else np.zeros(len(table)) for key in WRENCH])
    if "s" not in table:
        at = nominal.arc_length if rows_at is None else rows_at
        if len(rows) != len(at):
            raise table.error(f"{len(rows)} rows, expected {len(at)}, one per waypoint; or add a column s_mm")
        return interpolate(nominal.arc_length, at, rows)
    s = table.values["s"]
    if len(s) < 2:
        raise table.error(f"{len(s)} rows, expected at least 2")
    back = np.flatnonzero(np.diff(s) <= 0.0)
    if len(back):
        raise table.error("s_mm does not grow here; rows must be in the order of the path", int(back[0]) + 1)
    progress = cutting_progress(nominal)
    if s[0] > 1e-9 or s[-1] < progress[-1] - 1e-6:
        span = f"{s[0] * 1e3:g} to {s[-1] * 1e3:g} mm"
        raise table.error(f"s_mm covers {span}, the toolpath needs 0 to {progress[-1] * 1e3:g} mm")
    return np.column_stack([np.interp(progress, s, rows[:, column]) for column in range(6)])


table = FileProcess
