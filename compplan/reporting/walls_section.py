"""The section of a page on finished walls: how far each lies off, and by what."""

from __future__ import annotations

from collections.abc import Sequence

from compplan.job.job import Job
from compplan.plan.finished_walls import explain_walls, find_greatest
from compplan.process.walls import PARTS, WallError
from compplan.reporting.page import Column, PageTable, Row, Section, TableCell
from compplan.reporting.style import format_length


def show_walls(walls: Sequence[WallError], job: Job | None, *, corrected: bool) -> Section:
    """Return the section."""
    rows: list[Row] = []
    for number, wall in enumerate(walls, start=1):
        parts = [TableCell(format_length(float(part.mean()))) for part in wall.parts]
        whole = TableCell(format_length(wall.mean), "strong"), TableCell(format_length(wall.greatest))
        rows.append([number, wall.first, wall.last, wall.side, 1e3 * wall.length, *parts, *whole])
    columns = [Column("wall"), Column("from waypoint"), Column("to"), Column("side of the travel"),
               Column("length", "mm", 4), *(Column(f"by the {part}") for part in PARTS), Column("error, mean"),
               Column("error, greatest")]  # fmt: skip
    caption = "Above 0: into the wall, too much is taken; below 0: material is left. Parts are means over a wall."
    arm = "after its correction" if corrected else "uncorrected"
    if not walls:
        return Section("Finished walls", ["The path leaves no wall by the side of its cutter."], "")
    text = (f"{len(walls)} walls, up to {format_length(find_greatest(walls))} off; the arm {arm}. A wall stands where "
            "the edge is as it passes square to the travel.")  # fmt: skip
    return Section("Finished walls", [PageTable(columns, rows, caption, scroll=14), *explain_walls(job)], text)
