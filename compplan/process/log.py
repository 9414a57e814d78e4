"""A measured force log: force, moments and spindle power along a cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.toolpath.toolpath import WRENCH

#: No tool bears more: beyond, a unit is wrong (assumed). [N]
MOST_FORCE = 1e6

COLUMNS = (
    FileColumn("s", "length"),
    FileColumn("t", "time"),
    *(FileColumn(name, "force", required=True) for name in WRENCH[:3]),
    *(FileColumn(name, "moment", group="moment") for name in WRENCH[3:]),
    FileColumn("power", "power"),
)


@dataclass(frozen=True)
class ForceLog:
    """A measured log; m rows."""

    place: Array  #: Length cut so far [m], or time cut so far [s]. Shape (m,).
    timed: bool  #: Whether `place` is a time.
    wrench: Array  #: On the tool at its tip, part axes; 3 columns without moments. Shape (m, 3 or 6). [N, N m]
    power: Array | None = None  #: Of the spindle, or None. Shape (m,). [W]


def read_force_log(path: Path) -> ForceLog:
    """Read a log: CSV with s_mm or t_s (length or time cut so far), fx_N fy_N fz_N, moments and power_W, part axes.

    Raises:
        InputError: If it is not what it has to be.
    """
    table = read_table(path, COLUMNS)
    timed = "t" in table.values
    if timed == ("s" in table.values):
        raise table.error("needs one of the columns s_mm and t_s, the length or the time cut so far")
    place = table.values["t" if timed else "s"]
    if len(place) < 2:
        raise table.error(f"{len(place)} rows, expected at least 2")
    back = np.flatnonzero(np.diff(place) < 0.0)
    if len(back):
        name = "t_s" if timed else "s_mm"
        raise table.error(f"{name} falls here; rows must be in the order of the path", int(back[0]) + 1)
    wrench = np.column_stack([table.values[name] for name in WRENCH if name in table.values])
    wrong = np.abs(wrench[:, :3]).max(axis=1) > MOST_FORCE
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise table.error(f"a force of {np.abs(wrench[row, :3]).max():.3g} N, at most {MOST_FORCE:g} N is allowed", row)
    return ForceLog(place, timed, wrench, table.values.get("power"))
