"""The section of the page of forces on chatter: where the cut is unstable, and limits of depth over spindle speed."""

from __future__ import annotations

from typing import Any

import numpy as np

from compplan.plan.stability import Stability, StabilityMap, mark_spans
from compplan.reporting import figure as go
from compplan.reporting.along_path import Stations, draw_lines
from compplan.reporting.page import Block, Chart, Column, PageTable, Row, Section, TableCell
from compplan.reporting.style import AFTER, BEFORE, CATEGORIES, NEUTRAL, format_number
from compplan.robot import Array

#: Labels of the axis of depths. [mm]
DEPTH_TICKS = [part * 10.0**power for power in range(-3, 3) for part in (1, 2, 5)]
#: Stretches that the table lists at most.
LISTED = 30


def show_stability(stability: Stability, stations: Stations) -> Section:
    """Return the section."""
    growth = np.where(stability.multiplier > 0.0, stability.multiplier, np.nan)
    lines = draw_lines(stations, {"growth": growth}, "", title="growth a tooth", colours=(BEFORE,), limit=(1.0, "1"))
    odds = np.where(stability.multiplier > 0.0, 100.0 * stability.odds, np.nan)
    chances = draw_lines(stations, {"probability": odds}, "%", title="probability of chatter", colours=(BEFORE,))
    blocks: list[Block] = [
        Chart(lines, "By how much a vibration grows from tooth to tooth, by semi-discretisation: above 1 the cut "
              "chatters.", height=260),
        Chart(chances, "Probability of chatter, from the spread of masses, damping and coefficients (assumed).",
              height=260),
    ]  # fmt: skip
    if stability.map is not None:
        drawn = stability.map
        blocks.append(Chart(_draw_map(drawn), f"Least unstable axial depth over the spindle speed, at waypoint "
                            f"{drawn.waypoint}, which comes nearest to chatter; the engaged arc is kept. Below "
                            "the lines the cut is stable.", height=340))  # fmt: skip
    blocks.append(_tabulate(stability, stations))
    rings = ", ".join(format_number(float(value)) for value in stability.frequencies.min(axis=0))
    text = (f"Lowest modes of the arm along the cut: {rings}\u00a0Hz (masses: {stability.masses}); damping "
            f"{100 * stability.damping:.3g}\u00a0% of critical, assumed. " if rings else "") + ("Modes from "
            f"{format_number(stability.band[0])} to {format_number(stability.band[1])}\u00a0Hz are looked at; "
            f"what is stiffer counts as rigid, and so does the work.{stability.proposal.sentence}")
    return Section("Stability", blocks, text)


def _tabulate(stability: Stability, stations: Stations) -> PageTable | str:
    spans = mark_spans(stability.unstable)
    if not spans:
        low, high = (format_number(value) for value in stability.band)
        return f"No waypoint is unstable, as far as modes from {low} to {high}\u00a0Hz go."
    rows: list[Row] = []
    for first, last in spans[:LISTED]:
        most = float(stability.multiplier[first : last + 1].max())
        places = [1e3 * float(stations.length[row]) for row in (first, last)]
        both = "both" if stability.zero_order[first : last + 1].any() else "semi-discretisation alone"
        rows.append([first, last, *places, TableCell(format_number(most), "bad"), both])
    columns = [Column("from waypoint"), Column("to"), Column("length", "mm", 4), Column("to", "mm", 4),
               Column("growth a tooth"), Column("called by")]  # fmt: skip
    more = f" The first {LISTED} of {len(spans)} stretches." if len(spans) > LISTED else ""
    return PageTable(columns, rows, f"Stretches whose cut chatters; forces.csv flags every waypoint.{more}", scroll=12)


def _draw_map(drawn: StabilityMap) -> Any:

    figure = go.Figure()
    for name, speed, limit, colour, mode in (
        ("zero-order", drawn.speed, drawn.zero_order, AFTER, "lines"),
        ("semi-discretisation", drawn.few_speed, drawn.semi_discretised, CATEGORIES[2], "lines+markers"),
    ):
        figure.add_trace(go.Scatter(x=(60.0 * speed).tolist(), y=_depths(limit), name=name, mode=mode,
                                    line={"color": colour, "width": 2}, connectgaps=False))  # fmt: skip
    ends = [60.0 * float(drawn.speed[0]), 60.0 * float(drawn.speed[-1])]
    if np.isfinite(drawn.mode_coupling):
        figure.add_trace(go.Scatter(x=ends, y=[1e3 * drawn.mode_coupling] * 2, name="mode coupling, no delay",
                                    mode="lines", line={"color": NEUTRAL, "width": 2, "dash": "dash"}))  # fmt: skip
    job = 60.0 * float(drawn.speed[len(drawn.speed) // 2])
    figure.add_trace(go.Scatter(x=[job], y=[1e3 * drawn.depth], name="the job", mode="markers",
                                marker={"color": BEFORE, "size": 11, "symbol": "x"}))  # fmt: skip
    figure.update_layout(
        xaxis={"title": {"text": "spindle speed, 1/min"}, "tickformat": ",d"},
        yaxis={"title": {"text": "axial depth, mm"}, "type": "log", "tickvals": DEPTH_TICKS,
               "ticktext": [f"{value:g}" for value in DEPTH_TICKS]},
        legend={"orientation": "h", "y": 1.12}, margin={"l": 60, "r": 20, "t": 30, "b": 50},
    )  # fmt: skip
    return figure


def _depths(limit: Array) -> list[float | None]:
    return [float(1e3 * value) if np.isfinite(value) else None for value in limit]
