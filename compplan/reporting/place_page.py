"""The page of a placement: where the part should stand, what that brings, and how it looks elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compplan.planning.posture.summary import PostureMap
from compplan.reporting.page import Chart, Column, PageTable, Provenance, Row, Section, TableCell, write_page
from compplan.reporting.posture_section import show_map
from compplan.reporting.style import format_percent
from compplan.reporting.summaries import open_place


def write_place_page(summary: Mapping[str, Any], place_map: Any, posture: PostureMap, file: Path) -> None:
    """Write the page of a placement.

    Args:
        summary: What place.json holds.
        place_map: Chart of the remaining deviation by place.
        posture: The map of postures along the path there.
        file: The HTML file.
    """
    maps = [
        Chart(
            place_map,
            "Deviation that the best posture at each place would leave at least, in a horizontal and a vertical cut "
            "through the chosen place. Blank: the path cannot be followed there.",
            360,
        )
    ]
    sections = [
        Section("There and here", [_table(summary)], "What is left of the deviation along the path, after correction."),
        Section("Turns about the vertical", [_turns(summary["grids"])], "The best place of each turn."),
        Section("Posture", [show_map(posture)], "The posture along the path at the chosen place."),
    ]
    assumed = []
    if "uncertainty_assumed" in summary:
        assumed = ["the uncertainty of the robot (job: [posture.uncertainty])"]
    write_page(
        file,
        f"{summary['robot']}: where the part should stand",
        describe_placement(summary),
        sections,
        kind="Placement",
        opening=open_place(summary, maps[0]),
        provenance=Provenance([("robot", summary["robot"])], assumed),
    )


def describe_placement(summary: Mapping[str, Any]) -> str:
    """Say in two sentences where the part should stand and what that brings."""
    x, y, z = summary["part"]["position_mm"]
    text = f"The part should stand at x {x:g} mm, y {y:g} mm, z {z:g} mm in the robot's base frame"
    if summary["part"]["turn_deg"]:
        text += f", turned by {summary['part']['turn_deg']:g} deg about the vertical"
    if summary["base_height_mm"]:
        text += f", the base raised by {summary['base_height_mm']:g} mm"
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    text += f". What is left of the deviation is then {there:.3g} mm (95 %)"
    if here is None:
        text += "; from the job's own place the path cannot be followed."
    else:
        text += f", against {here['p95']:.3g} mm at the job's own place: {format_percent(summary['ratio'])} of it."
    return text


def _table(summary: Mapping[str, Any]) -> PageTable:
    here = summary["sensitivity_here_mm"] or {"expected_rms": None, "p95": None}
    rows: list[Row] = [
        ["expected, rms", here["expected_rms"], TableCell(summary["sensitivity_mm"]["expected_rms"], "strong")],
        ["95 %", here["p95"], TableCell(summary["sensitivity_mm"]["p95"], "strong")],
    ]
    columns = [Column("remaining deviation"), Column("job's place", "mm"), Column("chosen place", "mm")]
    return PageTable(columns, rows)


def _turns(grids: Sequence[Mapping[str, Any]]) -> PageTable:
    rows: list[Row] = []
    for grid in grids:
        bound = np.array(grid["bound_mm"], float)
        if not np.isfinite(bound).any():
            rows.append([float(grid["turn_deg"]), None, None, None, None, 0])
            continue
        best = np.unravel_index(np.nanargmin(bound), bound.shape)
        place = [float(grid[f"{axis}_mm"][k]) for axis, k in zip("xyz", best, strict=True)]
        rows.append([float(grid["turn_deg"]), *place, float(bound[best]), int(np.isfinite(bound).sum())])
    columns = [
        Column("turn", "deg"), Column("x", "mm", 4), Column("y", "mm", 4), Column("z", "mm", 4),
        Column("least remaining deviation (lower bound)", "mm"), Column("places from which the path can be followed"),
    ]  # fmt: skip
    return PageTable(columns, rows, scroll=12)
