"""The page of an identification: values with intervals, what cannot be determined, the gap, how the model grew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compplan.reporting import figure as go
from compplan.reporting.page import Chart, Column, Fold, PageTable, Provenance, Row, Section, TableCell, write_page
from compplan.reporting.style import AFTER, BEFORE, NEUTRAL, TOLERANCE
from compplan.reporting.summaries import open_identification

FRAMES = ("geometry", "base", "tool", "contact")


def write_identification_page(summary: dict[str, Any], file: Path) -> None:
    """Write the page of an identification.

    Args:
        summary: What identify.json holds.
        file: The HTML file.
    """
    gap, robot = summary["gap"], summary["robot"]
    lede = [
        f"{summary['rows']} rows at {summary['poses']} poses; the gap shrinks from {gap['before_rms_mm']:.3g} to"
        f" {gap['after_rms_mm']:.3g} mm rms, on poses not in the fit from {gap['held_out_before_rms_mm']:.3g} to"
        f" {gap['held_out_after_rms_mm']:.3g} mm.",
        *(note for note in summary["notes"] if "assumed" not in note),
    ]
    compliances = [p for p in summary["parameters"] if p["kind"] not in FRAMES]
    sections = [
        Section(
            "Compliances",
            [*_changes(compliances), _parameters(compliances)],
            "Identified values with 95 % intervals. What does not help on poses not in the fit is not written.",
        ),
        Section("What cannot be determined", [_held(summary)], "Held at their nominal values, and why."),
        Section(
            "Gap",
            [_gap_chart(gap), _gap(gap)],
            "Root mean square of the distance between measured and predicted positions.",
        ),
        Section("Which parameters were added", [_rounds(summary)], "Candidates and the gap if they were added."),
    ]
    geometry = [p for p in summary["parameters"] if p["kind"] in FRAMES]
    if geometry:
        fold = Fold(f"{len(geometry)} changes of geometry", [_parameters(geometry)])
        sections.insert(1, Section("Geometry", [fold], "Fitted along, since it is wrong on poses not in the fit too."))
    facts = [
        ("robot", str(robot)),
        ("positions", summary["reference"]),
        ("intervals from", summary["intervals_from"]),
        ("condition number", f"{summary['condition_number']:.3g}" if summary["condition_number"] else "none"),
        ("outliers left out", str(len(summary["outlier_rows"]))),
        *((f"residual {name}, per axis", f"{value:.3g}") for name, value in summary["residual_per_axis"].items()),
    ]
    provenance = Provenance(facts, [note for note in summary["notes"] if "assumed" in note])
    pictures = _changes(compliances)
    opening = open_identification(summary, pictures[0] if pictures else _gap_chart(gap))
    write_page(file, f"{robot}: identified", lede, sections, kind="Identification", opening=opening,
               provenance=provenance)  # fmt: skip


def _changes(entries: list[dict[str, Any]]) -> list[Chart]:
    """Draw by how much each value differs from the one before, with its interval."""
    known = [entry for entry in entries if entry["before"] and None not in entry["interval_95"]]
    if not known:
        return []
    change = [100 * (entry["value"] / entry["before"] - 1) for entry in known]
    ends = [sorted(100 * (end / entry["before"] - 1) for end in entry["interval_95"]) for entry in known]
    said = [
        f"{value:+.0f} % ({low:+.0f} to {high:+.0f})".replace("-", "−")
        for value, (low, high) in zip(change, ends, strict=True)
    ]
    figure = go.Figure(
        go.Scatter(
            x=change, y=[entry["name"] for entry in known], mode="markers+text", text=said, textposition="top center",
            cliponaxis=False,
            marker={"size": 9, "color": [AFTER if entry["written"] else NEUTRAL for entry in known]},
            error_x={
                "type": "data", "color": NEUTRAL, "thickness": 1.6,
                "array": [high - value for value, (_, high) in zip(change, ends, strict=True)],
                "arrayminus": [value - low for value, (low, _) in zip(change, ends, strict=True)],
            },
            hovertemplate="%{y}: %{x:.1f} %<extra></extra>",
        )
    )  # fmt: skip
    figure.add_vline(x=0.0, line={"color": TOLERANCE, "width": 1.2, "dash": "dash"})
    low, high = min(0.0, *(end[0] for end in ends)), max(0.0, *(end[1] for end in ends))
    room = 0.35 * max(high - low, 1e-6)  # for the words over the outermost dots, on a phone too
    figure.update_xaxes(title_text="change from the value before, %", range=[low - room, high + room])
    figure.update_yaxes(autorange="reversed")
    caption = "Dot: change, with its 95 % interval; grey dots are not written to the robot folder."
    return [Chart(figure, caption, height=100 + 44 * len(known))]


def _gap_chart(gap: dict[str, Any]) -> Chart:
    """Draw the gap before and after, on rows of the fit and on held-out ones."""
    rows = {"rows of the fit": "", "poses not in the fit": "held_out_"}
    if gap["under_load_before_rms_mm"] is not None:
        rows["under load, not in the fit"] = "under_load_"
    figure = go.Figure()
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        values = [gap[f"{key}{name}_rms_mm"] for key in rows.values()]
        figure.add_bar(
            y=list(rows), x=values, name=name, orientation="h", marker_color=colour,
            text=[f"{value:.3g} mm" for value in values], hovertemplate="%{x:.3g} mm",
        )  # fmt: skip
    figure.update_xaxes(title_text="gap, rms, mm", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    figure.update_layout(barmode="group", bargap=0.3, legend={"traceorder": "normal"})
    return Chart(figure, "", height=110 + 60 * len(rows))


def _parameters(entries: list[dict[str, Any]]) -> PageTable:
    columns = [Column(title) for title in ("parameter", "unit", "before", "value", "from", "to", "robot folder")]
    rows = [
        [
            entry["name"],
            entry["unit"].replace(" ", "\u00a0"),
            entry["before"],
            TableCell(entry["value"], "strong"),
            *entry["interval_95"],
            TableCell("written", "good") if entry["written"] else TableCell("not written", "muted"),
        ]
        for entry in entries
    ]
    return PageTable(columns, rows, scroll=24)


def _held(summary: dict[str, Any]) -> PageTable:
    columns = [Column("parameter"), Column("together with"), Column("reason")]
    rows = [
        [entry["parameter"], ", ".join(entry["together_with"]) or None, entry["reason"]]
        for entry in summary["unidentifiable"]
    ]
    return PageTable(columns, rows or [["none", None, "every parameter can be determined"]], scroll=24)


def _gap(gap: dict[str, Any]) -> PageTable:
    columns = [Column(""), Column("before", "mm"), Column("after", "mm")]
    rows = [
        ["rows of the fit", gap["before_rms_mm"], gap["after_rms_mm"]],
        ["poses not in the fit", gap["held_out_before_rms_mm"], gap["held_out_after_rms_mm"]],
    ]
    if gap["under_load_before_rms_mm"] is not None:
        rows.append(["under load, not in the fit", gap["under_load_before_rms_mm"], gap["under_load_after_rms_mm"]])
    return PageTable(columns, rows)


def _rounds(summary: dict[str, Any]) -> PageTable:
    columns = [
        Column("round"), Column("candidate"), Column("value"), Column("unit"),
        Column("gap on poses not in the fit", "mm"), Column("gain", "standard errors"), Column(""),
    ]  # fmt: skip
    rows: list[Row] = []
    for number, entry in enumerate(summary["structure"], 1):
        standing = TableCell("model as it stands", "muted")
        rows.append([number, standing, None, None, entry["held_out_rms_mm"], None, None])
        for candidate in entry["candidates"][:8]:
            verdict = "" if candidate["told"] else "cannot be determined"
            verdict = "added" if candidate["name"] == entry["added"] else verdict
            rows.append(
                [None, candidate["name"], candidate["value"], candidate["unit"], candidate["held_out_rms_mm"],
                 candidate["gain_in_standard_errors"], verdict]
            )  # fmt: skip
    return PageTable(columns, rows, scroll=24)
