"""The page of a job of several tools: the whole in a sentence, one line a tool, and the way to each tool's own page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from compplan.files.quantities import format_length
from compplan.report.page import Column, PageTable, Provenance, Section, TableCell, write_page


def write_operations_page(summary: Mapping[str, Any], file: Path) -> None:
    """Write the page.

    Args:
        summary: What plan.json of the whole holds.
        file: The HTML file.

    """
    tools = summary["tools"]
    sections = [
        Section("Tools", [_table(tools), f"Each tool's own page: {_list(tools)}."], "One plan a tool.", open=True),
        Section("Programs", [_programs(tools)], "Run them in this order; each begins with its tool change.", open=True),
    ]
    if summary["notes"]:
        sections.append(Section("What to know", list(summary["notes"])))
    write_page(
        file, summary["name"], say_operations(summary), sections, kind="Plan",
        provenance=Provenance([("robot", summary["robot"])], []),
    )  # fmt: skip


def say_operations(summary: Mapping[str, Any]) -> str:
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


def _list(tools: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{tool['folder']}/report.html" for tool in tools)


def _table(tools: Sequence[Mapping[str, Any]]) -> PageTable:
    rows: list[Sequence[TableCell | str | float | int | None]] = []
    for tool in tools:
        status = TableCell(tool["status"], "good" if tool["status"] == "solved" else "bad")
        rows.append([
            tool["label"], tool["length_mm"], status, tool["verdict"]["word"].replace("_", " "),
            tool["error_before_mm"]["max"], tool["error_after_mm"]["max"],
            tool.get("promise_mm", {}).get("p95_max"), tool["waypoints"], tool["duration_s"],
        ])  # fmt: skip
    columns = [
        Column("tool"), Column("flange to tip", "mm", 5), Column("status"), Column("verdict"),
        Column("uncorrected, max", "mm"), Column("planned, max", "mm"), Column("true tip within, 95 %", "mm"),
        Column("waypoints"), Column("time", "s"),
    ]  # fmt: skip
    return PageTable(columns, rows)


def _programs(tools: Sequence[Mapping[str, Any]]) -> PageTable:
    rows: list[Sequence[TableCell | str | float | int | None]] = [
        [tool["label"], ", ".join(tool["programs"]) or "none asked for"] for tool in tools
    ]
    return PageTable([Column("tool"), Column("files")], rows)
