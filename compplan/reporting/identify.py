"""Outputs of `compplan identify`: identify.json, report.html and the updated robot folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compplan.identification.campaign import Identification
from compplan.identification.estimate import Estimate
from compplan.io.palette import AFTER, BEFORE, NEUTRAL
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_mm_change, format_number, shorten
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.measurement.fit.rows import SIGMA_ENCODER
from compplan.measurement.registration import write_registration
from compplan.planning.tolerance_verdict import MEASURE
from compplan.reporting.charts import Bars, draw_bars
from compplan.reporting.page import Cell, Chart, DataTable, Fold, Provenance, Section, Summary, render_page
from compplan.reporting.writers.robot_folder import deliver_robot_folder

#: Displayed unit of a parameter, and factor from SI.
SHOWN = {
    "rad/(N m)": ("urad/(N m)", 1e6), "m/N": ("um/N", 1e6), "m": ("mm", 1e3),
    "rad": ("deg", 180 / np.pi), "1": ("1", 1.0),
}  # fmt: skip
#: Greatest number of compliances on the terminal.
LINES = 10
#: Kinds of geometric parameters.
FRAMES = ("geometry", "base", "tool", "contact")


def write_identification(result: Identification, out: Path, log_notes: Sequence[str] = ()) -> dict[str, Any]:
    """Write identify.json, report.html and the updated robot folder; `log_notes`: notes from reading the log."""
    summary = {**summarise_identification(result), "log_notes": list(log_notes), "made_by": describe_origin()}
    with replace_folder(out, "identify") as part:
        deliver_robot_folder(result.robot, part / "robot", result.nominal)
        if result.registration.parts:
            write_registration(result.registration, part / "robot" / "registration.toml")
        write_json(part / "identify.json", summary)
        write_text(part / "report.html", _render(summary))
    return summary


def summarise_identification(result: Identification) -> dict[str, Any]:
    """Return the content of identify.json."""
    written = set(result.kept.free_names)
    parameters = [_describe(result.kept, name, written=True) for name in _list_free(result.kept)]
    parameters += [
        _describe(result.estimate, n, written=False) for n in _list_free(result.estimate) if n not in written
    ]
    noise, rows, gap, frames = result.estimate.noise, result.rows, result.gap, result.registration
    scatter = {"position_mm": _round(noise[0] * np.median(rows.deviation[:, 0]) * 1e3)}
    if rows.turned:
        scatter["orientation_deg"] = _round(np.rad2deg(noise[1] * np.median(rows.deviation[:, 3])))
    if rows.encoder is not None:
        scatter["encoder_difference_deg"] = _round(np.rad2deg(noise[2] * SIGMA_ENCODER))
    gaps = ("before", "after", "held_out_before", "held_out_after", "under_load_before", "under_load_after")
    return {
        "schema": 1, "robot": result.nominal.name, "rows": len(rows), "poses": rows.poses, "reference": rows.reference,
        "geometry": result.geometry, "parameters": parameters,
        "unidentifiable": [
            {"parameter": h.held, "together_with": list(h.together_with), "reason": h.reason}
            for h in result.estimate.held
        ],
        "condition_number": _round(result.estimate.condition),
        "intervals_from": "groups of neighbouring poses" if result.estimate.clustered else "residuals",
        "residual_per_axis": scatter,
        "gap": {f"{key}_rms_mm": _round(getattr(gap, key), 1e3) for key in gaps},
        "registration": {
            "fitted": list(frames.parts),
            "base_position_mm": [_round(v, 1e3) for v in frames.base[:3, 3]],
            "tool_position_mm": [[_round(v, 1e3) for v in tool[:3, 3]] for tool in frames.tool],
        },
        "outlier_rows": list(result.outliers), "notes": list(result.notes),
    }  # fmt: skip


def _list_free(estimate: Estimate) -> list[str]:
    """List the free parameters of a fit, without frames, which are in the registration."""
    return [p.name for p in estimate.structure.parameters if p.name in estimate.free_names]


def _describe(estimate: Estimate, name: str, *, written: bool) -> dict[str, Any]:
    k = estimate.names.index(name)
    parameter = estimate.parameters[k]
    unit, factor = SHOWN.get(parameter.unit, (parameter.unit, 1.0))
    return {
        "name": name, "kind": parameter.kind, "unit": unit, "before": _round(parameter.nominal, factor),
        "value": _round(estimate.values[k], factor), "standard_error": _round(estimate.standard_errors[k], factor),
        "interval_95": [_round(v, factor) for v in estimate.intervals()[k]], "written": written,
    }  # fmt: skip


def _round(value: float | None, factor: float = 1.0) -> float | None:
    return None if value is None or not np.isfinite(value) else shorten(value * factor)


def _render(summary: Mapping[str, Any]) -> str:
    """Return the page: values with intervals, unidentifiable parameters, the gap."""
    robot, notes = summary["robot"], summary["notes"]
    compliances = _list_compliances(summary)
    geometry = [p for p in summary["parameters"] if p["kind"] in FRAMES]
    held = [
        [entry["parameter"], ", ".join(entry["together_with"]) or None, entry["reason"]]
        for entry in summary["unidentifiable"]
    ] or [["none", None, "every parameter can be determined"]]
    about = "Values with 95 % intervals. A spring that the folder lacked is written if its interval lies above zero."
    sections = [
        Section("Compliances", [_list_parameters(compliances)], about),
        Section("What cannot be determined", [DataTable(["parameter", "together with", "reason"], held, "", 24)],
                "Parameters held at their nominal values, with the reason."),
        Section("Gap", [_chart_gap(summary["gap"])],
                "Root mean square of the distance between measured and predicted positions."),
    ]  # fmt: skip
    if geometry:
        fold = Fold(f"{len(geometry)} changes of geometry", [_list_parameters(geometry)])
        sections.insert(1, Section("Geometry", [fold], "Fitted together with the compliances."))
    facts = [
        ("robot", str(robot)), ("positions", summary["reference"]), ("intervals from", summary["intervals_from"]),
        ("condition number", f"{summary['condition_number']:.3g}" if summary["condition_number"] else "none"),
        ("outliers left out", str(len(summary["outlier_rows"]))),
        *((f"residual {name}, per axis", f"{value:.3g}") for name, value in summary["residual_per_axis"].items()),
    ]  # fmt: skip
    assumed = [note for note in notes if "assumed" in note]
    return render_page(
        f"{robot}: identified", open_identification(summary), sections, kind="Identification",
        notes=[note for note in notes if note not in assumed], provenance=Provenance(facts, assumed),
    )  # fmt: skip


def open_identification(summary: Mapping[str, Any]) -> Summary:
    """Return the first screen: error of the fitted robot model on held-out poses."""
    before, after = (1e-3 * summary["gap"][f"held_out_{name}_rms_mm"] for name in ("before", "after"))
    better = after < before
    verdict = "The fit does not improve the robot model: do not plan with it."
    if better:
        verdict = f"The fitted robot model is {format_number(before / after, 2)} times closer to the measurements."
    tone, written = "good" if better else "bad", sum(1 for entry in summary["parameters"] if entry["written"])
    figures = [
        (format_mm_change(before, after), "rms error before and after, at poses left out of the fit", tone),
        (str(written), "fitted values in the robot folder"),
        (str(summary["poses"]), f"poses measured ({summary['rows']} rows)"),
    ]
    todo = "Plan with it: compplan plan JOB --robot OUT/robot" if better else MEASURE.replace("the robot", "more poses")
    picture = (*_chart_changes(_list_compliances(summary)), _chart_gap(summary["gap"]))[0]
    return Summary(verdict, tone, figures, picture, todo)


def list_compliances(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines of the terminal: each compliance before and after, with its 95 % interval, at most `LINES`."""
    entries, lines = _list_compliances(summary), list[str]()
    shown = entries if len(entries) <= LINES else entries[: LINES - 1]
    width = max((len(entry["name"]) for entry in shown), default=0)
    for entry in shown:
        before, value, low, high = (
            "?" if end is None else f"{end:.3g}" for end in (entry["before"], entry["value"], *entry["interval_95"])
        )
        apart = "" if entry["written"] else "; not written to the folder"
        lines.append(f"  {entry['name']:<{width}}  {before} -> {value} {entry['unit']} (95 %: {low} to {high}){apart}")
    lines = ["compliances before -> after:", *lines] if lines else []
    return lines if shown is entries else [*lines, f"  {len(entries) - len(shown)} more in the report"]


def _list_compliances(summary: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [entry for entry in summary["parameters"] if entry["kind"] not in FRAMES]


def _chart_changes(entries: Sequence[Mapping[str, Any]]) -> list[Chart]:
    """Draw the relative change of each value with its interval; no chart if no previous value is known."""
    known = [entry for entry in entries if entry["before"] and None not in entry["interval_95"]]
    if not known:
        return []
    change = [100 * (entry["value"] / entry["before"] - 1) for entry in known]
    ends = np.sort([[100 * (end / entry["before"] - 1) for end in entry["interval_95"]] for entry in known], axis=1)
    texts = [
        f"{value:+.0f} % ({low:+.0f} to {high:+.0f})".replace("-", "−")
        for value, (low, high) in zip(change, ends.tolist(), strict=True)
    ]
    colours = [AFTER if entry["written"] else NEUTRAL for entry in known]
    figure = draw_bars(
        [entry["name"] for entry in known], {"": Bars(change, colours, ends[:, 0], ends[:, 1], texts)},
        "change from the value before, %", level=0.0, dots=True, hover="%{y}: %{x:.1f} %",
    )  # fmt: skip
    low, high = min(0.0, float(ends.min())), max(0.0, float(ends.max()))
    room = 0.35 * max(high - low, 1e-6)  # for the labels of the outermost dots on narrow screens
    figure.axis("x", range=[low - room, high + room])
    caption = "Dot: change, with its 95 % interval; grey dots are not written to the robot folder."
    return [Chart(figure, caption, 100 + 44 * len(known))]


def _chart_gap(gap: Mapping[str, Any]) -> Chart:
    """Draw the gap before and after, on rows of the fit and on held-out ones."""
    rows = {"rows of the fit": "", "poses not in the fit": "held_out_"}
    if gap["under_load_before_rms_mm"] is not None:
        rows["under load, not in the fit"] = "under_load_"
    series = {}
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        values = [gap[f"{key}{name}_rms_mm"] for key in rows.values()]
        series[name] = Bars(values, colour, text=[f"{value:.3g} mm" for value in values])
    return Chart(draw_bars(list(rows), series, "gap, rms, mm"), "", 110 + 60 * len(rows))


def _list_parameters(entries: Sequence[Mapping[str, Any]]) -> DataTable:
    rows = [
        [entry["name"], entry["unit"].replace(" ", "\u00a0"), entry["before"], Cell(entry["value"], "strong"),
         *entry["interval_95"], Cell("written", "good") if entry["written"] else Cell("not written", "muted")]
        for entry in entries
    ]  # fmt: skip
    return DataTable(["parameter", "unit", "before", "value", "from", "to", "robot folder"], rows, scroll=24)
