"""Outputs of `compplan place`: place.json, and a page with the best position of the part and its benefit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_percent
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.job.job import Job
from compplan.planning.posture.place import PlaceResult, summarise_placement
from compplan.reporting.charts import INK, PAPER, Figure
from compplan.reporting.page import Chart, Provenance, Summary, render_page


def write_placement(result: PlaceResult, job: Job, folder: Path) -> dict[str, Any]:
    """Write place.json and its page; return the content of place.json."""
    summary = {**summarise_placement(result, job), "made_by": describe_origin()}
    unknown = ["the uncertainty of the robot (job: [posture.uncertainty])"]
    origin = Provenance([("robot", summary["robot"])], unknown if "uncertainty_assumed" in summary else [])
    html = render_page(
        f"{summary['robot']}: where to place the part", open_placement(summary, result, job.file.name), [],
        kind="Placement", provenance=origin,
    )  # fmt: skip
    with replace_folder(folder, "place") as part:
        write_text(part / "report.html", html)
        write_json(part / "place.json", summary)
    return summary


def open_placement(summary: Mapping[str, Any], result: PlaceResult, job: str) -> Summary:
    """Return the first screen: best position of the part, expected deviation there, and whether a plan can succeed."""
    caption = (
        "Deviation that the best posture at each place would leave at least, in a horizontal and a vertical cut "
        "through the chosen place. Blank: the path cannot be followed there."
    )
    x, y, z = summary["part"]["position_mm"]
    there, here = summary["sensitivity_mm"]["expected_rms"], summary["sensitivity_here_mm"]
    need, allowed = summary["correction_mm"].values()
    turn = f", turned by {summary['part']['turn_deg']:g} deg about z" if summary["part"]["turn_deg"] else ""
    figures: list[tuple[str, ...]] = [
        (f"{there:.3g}\u00a0mm", "rms deviation expected there after correction (robot and force as uncertain as now)"),
        ("no solution", "at the place of the job: it is out of reach, or joints would have to jump"),
        (f"{need:.3g}\u00a0mm", f"largest correction there; plan.max_correction_mm allows {allowed:g} mm"),
    ]
    if here is not None:
        less = format_percent(1.0 - summary["ratio"])
        figures[1] = (
            f"{here['expected_rms']:.3g}\u00a0mm",
            f"the same at the place of the job: {less} less at the best place",
        )
    todo = f"In {job}, write position_mm = [{x:g}, {y:g}, {z:g}]"
    if turn:
        todo += f" and rotation_deg = {summary['part']['rotation_deg']} (in place of another rotation)"
    todo += f" into [part], then run: compplan plan {job}"
    verdict, tone = f"Best place of the part: X {x:g}, Y {y:g}, Z {z:g} mm in the robot base{turn}.", "good"
    if need > allowed:
        verdict, tone = f"{verdict} A plan has no solution there: the correction limit is too small.", "bad"
        todo = f"Raise plan.max_correction_mm above {need:.3g}, or reduce the force. {todo}"
    return Summary(verdict, tone, figures, Chart(draw_place_map(result), caption, 360), todo)


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
        figure.heat(
            1e3 * rating.axes[across], 1e3 * rating.axes[up], values.T, "mm", panel, zmin=float(low),
            zmax=float(max(high, low + 1e-9)), showscale=panel == 1,
            hovertemplate="%{x:.0f}, %{y:.0f} mm: %{z:.3g} mm<extra></extra>",
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
