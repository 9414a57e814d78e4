"""Joint positions as a table, in the controller's joint convention."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.program import Program
from compplan.controllers.writers.text import legal_name
from compplan.io.tables import write_table

name = "csv"


def write(program: Program, folder: Path, most: int | None = None) -> list[Path]:
    """Write NAME_joints.csv: one column for each joint (A1_deg ...), feed_mm_s, rapid, and time_s where it is known."""
    columns: dict[str, object] = {}
    if program.time is not None:
        columns["time_s"] = program.time
    for index, name in enumerate(program.joint_names):
        columns[f"{legal_name(name, 60)}_{'mm' if program.prismatic[index] else 'deg'}"] = program.joints[:, index]
    columns |= {"feed_mm_s": program.feed, "rapid": program.rapid.astype(np.int64)}
    path = folder / f"{legal_name(program.name, 60)}_joints.csv"
    write_table(path, columns)
    return [path]
