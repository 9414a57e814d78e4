"""The page of `compplan trace`: what the executed path leaves of the programmed one, why, and what a model explains."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compplan.controllers.motion.identify import Identified
from compplan.reporting import figure as go
from compplan.reporting.page import (
    Chart,
    Column,
    KeyFigure,
    PageTable,
    Provenance,
    Row,
    Section,
    Summary,
    TableCell,
    write_page,
)
from compplan.reporting.style import AFTER, BEFORE, format_number, format_percent

CAUSES = {"lag": "lag of the drives", "blend": "blends at corners", "jitter": "torn rows of the log",
          "lost_motion": "lost motion"}  # fmt: skip


def write_trace_page(robot: str, summary: Mapping[str, Any], found: Identified, file: Path) -> None:
    """Write the page.

    Args:
        robot: Name of the robot.
        summary: What trace.json holds.
        found: What was identified.
        file: The page.

    """
    facts = [
        (key.replace("_", " "), ", ".join(f"{v:g}" for v in value) if isinstance(value, list) else str(value))
        for key, value in summary["motion"].items()
    ]
    assumed = ["Blends are parabolas within the zone, of every make.", "Torn rows are one cycle old."]
    if not summary["written"]:
        assumed.append("The folder's own controller values, which were not identified here.")
    sections = [_show_causes(summary), _show_models(summary), _show_logs(summary)]
    write_page(file, f"Executed path of {robot}", _lede(summary), sections, kind="Trace",
               opening=_open_trace(summary, found), notes=summary["notes"],
               provenance=Provenance(facts, assumed))  # fmt: skip


def _lede(summary: Mapping[str, Any]) -> str:
    without, left = summary["left_without_model_mm"], summary["left_mm"]
    return (f"The tip leaves the programmed path by {format_number(without['median'])}\u00a0mm (median) and "
            f"{format_number(without['p95'])}\u00a0mm (95 of 100 rows are nearer). It leaves the path that the model "
            f"executes by {format_number(left['median'])} and {format_number(left['p95'])}\u00a0mm, on rows that the "
            f"model was not fitted to.")  # fmt: skip


def _open_trace(summary: Mapping[str, Any], found: Identified) -> Summary:
    without, left = summary["left_without_model_mm"], summary["left_mm"]
    cause = max(summary["parts"], key=lambda name: summary["parts"][name])
    share = summary["parts"][cause]
    if summary["written"]:
        ratio = format_number(without["p95"] / max(left["p95"], 1e-9), 2)
        verdict = f"The identified controller is {ratio} times closer to the executed path than the program."
        todo = "Use it: compplan execute PROGRAM.csv --robot OUT/robot --out EXECUTED.csv."
    else:
        verdict = "No identified controller helps; the folder keeps its values."
        todo = "Log programs of two paths or speeds, and trace them together."
    figures = [
        KeyFigure(f"{format_number(without['p95'])}\u00a0mm", "95 % of the rows are nearer to the programmed path"),
        KeyFigure(f"{format_number(left['p95'])}\u00a0mm", "the same, to the path that the model executes",
                  "good" if summary["written"] else "bad"),
        KeyFigure(format_percent(share), f"of what is left is {CAUSES[cause]}, the largest cause"),
    ]  # fmt: skip
    picture = Chart(_draw_distances(found), "Share of the rows that are nearer than a distance.", height=330)
    return Summary(verdict, "good" if summary["written"] else "unsure", figures, picture, todo)


def _draw_distances(found: Identified) -> Any:
    figure = go.Figure()
    share = np.linspace(0.0, 100.0, 101)
    kept = found.left if found.helps else found.left_before
    for name, values, colour in (("to the program", found.without, BEFORE), ("to the model's path", kept, AFTER)):
        distance = np.round(1e3 * np.percentile(values, share), 5)
        figure.add_scatter(x=distance, y=share, mode="lines", name=name, line={"color": colour, "width": 2})
    figure.update_xaxes(title_text="distance, mm")
    figure.update_yaxes(title_text="rows nearer, %")
    return figure


def _show_causes(summary: Mapping[str, Any]) -> Section:
    parts, size = summary["parts"], summary["parts_rms_mm"]
    rows: list[Row]
    rows = [[words, 100.0 * parts[name], size[name]] for name, words in CAUSES.items()]
    rows.append(["not explained", 100.0 * max(0.0, 1.0 - sum(parts.values())), None])
    columns = [Column("cause"), Column("share", "%"), Column("rms", "mm")]
    text = "Shares of the mean square distance across the programmed path; they add up along its direction."
    return Section("Causes", [PageTable(columns, rows, text)])


def _show_models(summary: Mapping[str, Any]) -> Section:
    rows: list[Row]
    first = {"programmed path": summary["left_without_model_mm"], "folder's values": summary["left_with_folder_mm"]}
    rows = [[name, TableCell(entry["median"], "strong" if name == summary["model"] else ""),
             TableCell(entry["p95"], "strong" if name == summary["model"] else "")]
            for name, entry in {**first, **summary["models_mm"]}.items()]  # fmt: skip
    columns = [Column("model"), Column("median", "mm"), Column("95 %", "mm")]
    held = "logs" if summary["held_out"] == "log" else "stretches of time"
    return Section("Models", [PageTable(columns, rows, f"Distances of rows left out: {held} were left out in turn.")])


def _show_logs(summary: Mapping[str, Any]) -> Section:
    rows: list[Row]
    rows = [[entry["log"], entry["rows"], entry["cycle_ms"], entry["torn_readings"], 100.0 * entry["late_share"],
             100.0 * entry["missing_share"], entry["begins_at_length_mm"]] for entry in summary["logs"]]  # fmt: skip
    columns = [Column("log"), Column("rows"), Column("cycle", "ms"), Column("torn readings"), Column("late", "%"),
               Column("missing", "%"), Column("begins at", "mm", 4)]  # fmt: skip
    return Section("Logs", [PageTable(columns, rows, "Clocks of the logs, and where along the program they begin.")])
