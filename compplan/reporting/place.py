"""What `compplan place` writes: place.json, and a page: where the part should stand and what that brings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_percent
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.job.job import Job
from compplan.planning.posture.place import PlaceResult, summarise_placement
from compplan.reporting import page
from compplan.reporting.charts import Figure
from compplan.reporting.posture_section import show_map
from compplan.reporting.style import INK, PAPER, SEQUENTIAL


def write_placement(result: PlaceResult, job: Job, folder: Path) -> dict[str, Any]:
    """Write place.json and its page; return what place.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    summary = {**summarise_placement(result, job), "made_by": describe_origin()}
    caption = (
        "Deviation that the best posture at each place would leave at least, in a horizontal and a vertical cut "
        "through the chosen place. Blank: the path cannot be followed there."
    )
    picture = page.Chart(draw_place_map(result), caption, 360)
    posture = show_map(result.posture_choice.map)
    sections = [
        page.Section(
            "There and here", [_table(summary)], "What is left of the deviation along the path, after correction."
        ),
        page.Section("Turns about the vertical", [_turns(summary["grids"])], "The best place of each turn."),
        page.Section("Posture", [posture], "The posture along the path at the chosen place."),
    ]
    unknown = ["the uncertainty of the robot (job: [posture.uncertainty])"]
    assumed = unknown if "uncertainty_assumed" in summary else []
    html = page.render_page(
        f"{summary['robot']}: where the part should stand", _describe(summary), sections, kind="Placement",
        opening=_open(summary, picture), provenance=page.Provenance([("robot", summary["robot"])], assumed),
    )  # fmt: skip
    with replace_folder(folder, "place") as part:
        write_text(part / "report.html", html)
        write_json(part / "place.json", summary)
    return summary


def _open(summary: Mapping[str, Any], picture: page.Chart) -> page.Summary:
    """Return the first screen."""
    x, y, z = summary["part"]["position_mm"]
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    turn = f", turned by {summary['part']['turn_deg']:g} deg" if summary["part"]["turn_deg"] else ""
    figures = [page.KeyFigure(f"{there:.3g}\u00a0mm", "95 % of the remaining deviations are smaller there", "good")]
    end = "; at the job's place the path cannot be followed."
    if here is not None:
        end, less = ".", format_percent(1.0 - summary["ratio"])
        figures.append(page.KeyFigure(f"{here['p95']:.3g}\u00a0mm", "the same at the job's place"))
        figures.append(page.KeyFigure(less, "less deviation than at the job's place", "good"))
    todo = f"Write position_mm = [{x:g}, {y:g}, {z:g}] into [part] of the job and plan again."
    return page.Summary(f"Put the part at X {x:g}, Y {y:g}, Z {z:g} mm{turn}{end}", "good", figures, picture, todo)


def _describe(summary: Mapping[str, Any]) -> str:
    """Say in two sentences where the part should stand and what that brings."""
    x, y, z = summary["part"]["position_mm"]
    text = f"The part should stand at x {x:g} mm, y {y:g} mm, z {z:g} mm in the robot's base frame"
    if summary["part"]["turn_deg"]:
        text += f", turned by {summary['part']['turn_deg']:g} deg about the vertical"
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    text += f". What is left of the deviation is then {there:.3g} mm (95 %)"
    if here is None:
        return f"{text}; from the job's own place the path cannot be followed."
    return f"{text}, against {here['p95']:.3g} mm at the job's own place: {format_percent(summary['ratio'])} of it."


def draw_place_map(result: PlaceResult) -> Figure:
    """Draw horizontal and vertical sections of the grid through the chosen place."""
    rating = next((r for r in result.ratings if r.turn == result.turn), result.ratings[0])
    known = 1e3 * rating.bound[np.isfinite(rating.bound)]
    low, high = np.percentile(known, (1, 97)) if len(known) else (0.0, 1.0)
    chosen, cuts = result.position, ((0, 1, 2), (0, 2, 1))
    titles = [f"{'xyz'[through]} = {1e3 * chosen[through]:.0f} mm" for *_, through in cuts]
    figure = Figure(titles, 2, gaps=(0.14, 0.0))
    for panel, (across, up, through) in enumerate(cuts):
        nearest = int(np.abs(rating.axes[through] - chosen[through]).argmin())
        values = 1e3 * np.take(rating.bound, nearest, axis=through)
        figure.add(
            "heatmap", panel, z=values.T, x=1e3 * rating.axes[across], y=1e3 * rating.axes[up],
            colorscale=[list(stop) for stop in SEQUENTIAL], zmin=float(low), zmax=float(max(high, low + 1e-9)),
            showscale=panel == 1, colorbar={"title": {"text": "mm", "side": "top"}, "thickness": 12, "outlinewidth": 0},
            hoverongaps=False, hovertemplate="%{x:.0f}, %{y:.0f} mm: %{z:.3g} mm<extra></extra>",
        )  # fmt: skip
        for name, place, symbol in (("job's place", result.here, "circle"), ("chosen", chosen, "star")):
            edge = {"width": 2, "color": INK["light"]}
            figure.line(
                [1e3 * float(place[across])], [1e3 * float(place[up])], name, panel, mode="markers",
                marker={"symbol": symbol, "size": 13, "color": PAPER["light"], "line": edge}, showlegend=panel == 0,
                hoverinfo="name",
            )  # fmt: skip
        for side, k in (("x", across), ("y", up)):
            figure.axis(side, panel, title=f"{'xyz'[k]} of the part, mm", showgrid=False)
    figure.layout |= {"legend": {"y": 1.1}, "margin": {"t": 60, "b": 46}}
    return figure


def _table(summary: Mapping[str, Any]) -> page.DataTable:
    here = summary["sensitivity_here_mm"] or {"expected_rms": None, "p95": None}
    rows: list[page.Row] = [
        [name, here[key], page.Cell(summary["sensitivity_mm"][key], "strong")]
        for name, key in (("expected, rms", "expected_rms"), ("95 %", "p95"))
    ]
    return page.DataTable(["remaining deviation", "job's place [mm]", "chosen place [mm]"], rows)


def _turns(grids: Sequence[Mapping[str, Any]]) -> page.DataTable:
    rows: list[page.Row] = []
    for grid in grids:
        bound = np.array(grid["bound_mm"], float)
        count = int(np.isfinite(bound).sum())
        best = np.unravel_index(np.nanargmin(bound), bound.shape) if count else ()
        place = [float(grid[f"{axis}_mm"][k]) for axis, k in zip("xyz", best, strict=True)] if count else [None] * 3
        rows.append([float(grid["turn_deg"]), *place, float(bound[best]) if count else None, count])
    columns = [
        "turn [deg]", *(f"{axis} [mm, 4]" for axis in "xyz"), "least remaining deviation (lower bound) [mm]",
        "places from which the path can be followed",
    ]  # fmt: skip
    return page.DataTable(columns, rows, scroll=12)
