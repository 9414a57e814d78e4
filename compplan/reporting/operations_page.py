"""The page of a job of several tools: the whole in a sentence, one line a tool, and the way to each tool's own page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compplan.io.notes import list_remarks, list_stops
from compplan.io.palette import BAND
from compplan.io.quantities import format_length, format_mm, format_mm_change
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
from compplan.reporting.plan_summary import TONES
from compplan.reporting.style import BEFORE, TOLERANCE


def write_operations_page(summary: Mapping[str, Any], file: Path) -> None:
    """Write the page.

    Args:
        summary: What plan.json of the whole holds.
        file: The HTML file.

    """
    tools, mains = summary["tools"], summary.get("main_programs", [])
    sections = [
        Section("Tools", [_table(tools)], "One plan a tool; its name opens its page.", open=True),
        Section("Programs", [_programs(tools, mains)], "In this order; each begins with its tool change.", open=True),
    ]
    write_page(
        file, summary["name"], describe_operations(summary), sections, kind="Plan", opening=_open(summary),
        notes=list_remarks(summary["notes"]), provenance=Provenance([("robot", summary["robot"])], []),
    )  # fmt: skip


def _open(summary: Mapping[str, Any]) -> Summary:
    """Return the first screen: the verdict of the whole, and what stops the machine."""
    tools, verdict = summary["tools"], summary["verdict"]
    bands = [tool["verdict"]["band_mm"] for tool in tools]
    band = "not known" if None in bands else format_mm(1e-3 * max(bands))
    change = format_mm_change(*(1e-3 * summary[key]["max"] for key in ("error_before_mm", "error_after_mm")))
    words = {"keeps": "All operations keep", "may_not_keep": "Not all operations keep",
             "not_known": "It is not known whether all operations keep"}[verdict["word"]]  # fmt: skip
    figures = [
        KeyFigure(band, "95 % band, the widest of all operations", TONES[verdict["word"]]),
        KeyFigure(change, "greatest deviation without and with correction, if the robot is as modelled"),
        KeyFigure(f"{summary['duration_s']:.0f}\u00a0s", f"for {len(tools)} operations, without the tool changes"),
    ]
    caption = "Each operation; dashed: the tolerance. The 95 % band has to stay below it."
    picture = Chart(_draw(tools, verdict["tolerance_mm"]), caption, 120 + 70 * len(tools))
    return Summary(
        f"{words} {verdict['tolerance_mm']:g} mm.", TONES[verdict["word"]], figures, picture,
        "Open the page of each operation below; run the programs in the order below.", list_stops(summary["notes"]),
    )  # fmt: skip


def describe_operations(summary: Mapping[str, Any]) -> str:
    """Say in two sentences what the tools together come to."""
    tools = summary["tools"]
    before, after = (format_length(1e-3 * summary[key]["max"]) for key in ("error_before_mm", "error_after_mm"))
    verdict = summary["verdict"]["word"].replace("_", " ")
    names = ", ".join(tool["label"] for tool in tools)
    return (
        f"{len(tools)} operations ({names}), {summary['status'].replace('_', ' ')}: greatest deviation {before} "
        f"uncorrected, {after} planned, {summary['duration_s']:.0f} s without the tool changes. Verdict: {verdict} "
        f"{summary['verdict']['tolerance_mm']:g} mm."
    )


def _draw(tools: Sequence[Mapping[str, Any]], tolerance: float) -> Any:
    """Draw deviation without correction and 95 % band of every operation beside the tolerance [mm]."""
    figure, names = go.Figure(), [tool["label"] for tool in tools]
    series = {"without correction": ([tool["error_before_mm"]["max"] for tool in tools], BEFORE),
              "95 % band": ([tool["verdict"]["band_mm"] for tool in tools], BAND)}  # fmt: skip
    for name, (values, colour) in series.items():
        figure.add_bar(y=names, x=values, name=name, orientation="h", marker_color=colour, hovertemplate="%{x:.3g} mm")
    figure.update_xaxes(title_text="greatest deviation of the tip, mm", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    figure.add_vline(x=tolerance, line={"color": TOLERANCE, "width": 1.6, "dash": "dash"})
    figure.update_layout(barmode="group", bargap=0.35, legend={"traceorder": "normal"})
    return figure


def _table(tools: Sequence[Mapping[str, Any]]) -> PageTable:
    rows: list[Row] = []
    for tool in tools:
        status = TableCell(tool["status"], "good" if tool["status"] == "solved" else "bad")
        rows.append([
            TableCell(tool["label"], "strong", f"./{quote(tool['folder'])}/report.html"), tool["length_mm"], status,
            tool["verdict"]["word"].replace("_", " "),
            format_mm(1e-3 * tool["error_before_mm"]["max"]), format_mm(1e-3 * tool["error_after_mm"]["max"]),
            tool["verdict"]["band_mm"], tool["waypoints"], tool["duration_s"],
        ])  # fmt: skip
    columns = [
        Column("tool"), Column("flange to tip", "mm", 5), Column("status"), Column("verdict"),
        Column("uncorrected, max"), Column("planned, max"), Column("95 % band", "mm"),
        Column("waypoints"), Column("time", "s"),
    ]  # fmt: skip
    return PageTable(columns, rows)


def _programs(tools: Sequence[Mapping[str, Any]], mains: Sequence[str]) -> PageTable:
    rows: list[Row] = [[tool["label"], ", ".join(tool["programs"]) or "none asked for"] for tool in tools]
    if mains:
        rows.append(["all, in order", ", ".join(mains)])
    return PageTable([Column("tool"), Column("files")], rows)
