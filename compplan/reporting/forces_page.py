"""The page of `compplan forces`: the path coloured by force and engagement, and both along the path."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compplan.job.force_prediction import ForcePrediction
from compplan.process.engagement import Engagement
from compplan.process.fit import ForceFit
from compplan.process.force_models import name_force_model
from compplan.reporting import figure as go
from compplan.reporting.along_path import Stations, draw_lines, draw_wrench, find_spans
from compplan.reporting.page import (
    Block,
    Chart,
    Column,
    Columns,
    PageTable,
    Provenance,
    Row,
    Section,
    TableCell,
    write_page,
)
from compplan.reporting.robot_scene import frame_scene
from compplan.reporting.style import AFTER, BEFORE, CATEGORIES, NEUTRAL, SEQUENTIAL, format_number
from compplan.reporting.summaries import open_forces
from compplan.reporting.thinning import thin_path
from compplan.robot import Array
from compplan.toolpath.toolpath import Toolpath

#: About how many points of a path are drawn in a scene.
POINTS = 4000


def write_forces_page(found: ForcePrediction, summary: Mapping[str, Any], file: Path) -> None:
    """Write the page.

    Args:
        found: The prediction.
        summary: What forces.json holds of it.
        file: The page.

    """
    stations = _locate_stations(found.nominal)
    sections = [_overview(found), _along(found, stations)]
    if found.engagement is not None:
        sections.append(_engagement(found, found.engagement, stations))
    if found.fit is not None:
        sections.append(_comparison(found.fit))
    coefficients = summary.get("coefficients", {})
    facts = [("force model", name_force_model(found.job.process.model)), *_list_coefficients(coefficients)]
    notes = list(summary["notes"])
    assumed = [note for note in notes if "assumed" in note]
    size = _leave_out_air(found, np.linalg.norm(found.wrench[:, :3], axis=1))
    lines = draw_lines(stations, {"force": size}, "N", title="force", zero=True)
    opening = open_forces(found, summary, Chart(lines, "Size of the force along the path.", height=330))
    write_page(file, found.job.name or "Forces", _lede(summary), sections, kind="Forces", opening=opening, notes=notes,
               provenance=Provenance(facts, assumed))  # fmt: skip


def _leave_out_air(found: ForcePrediction, value: Array) -> Array:
    """Return values with NaN in rapid moves that carry nothing: no line goes from a cut into the air. As value."""
    idle = found.nominal.rapid & ~found.wrench.any(axis=1)
    return np.where(idle if value.ndim == 1 else idle[:, None], np.nan, value)


def _list_coefficients(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the coefficients of a cut as the page shows them; nothing where there are none."""
    if not found:
        return []
    names = (("cutting coefficients, N/mm²", "cutting_N_mm2"), ("edge coefficients, N/mm", "edge_N_mm"),
             ("Kienzle's exponent", "exponent"))  # fmt: skip
    parts = ("tangential", "radial", "axial")
    facts = [(words, ", ".join(f"{part} {value:g}" for part, value in zip(parts, found[name], strict=True)))
             for words, name in names]  # fmt: skip
    return [*facts, ("coefficients are", f"{'assumed' if found['assumed'] else 'taken over'}: {found['source']}")]


def _locate_stations(nominal: Toolpath) -> Stations:
    """Return where the waypoints are, for the charts."""
    rests = nominal.rapid[1:] | (nominal.feed[1:] <= 0.0)
    step = np.where(rests, 0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9))
    length = nominal.arc_length
    spans = find_spans(nominal.rapid)
    spans = np.column_stack([np.maximum(spans[:, 0] - 1, 0), spans[:, 1]]).astype(int)
    return Stations(length, np.r_[0.0, np.cumsum(step)], np.zeros(0, int), length[spans].reshape(-1, 2))


def _lede(summary: Mapping[str, Any]) -> str:
    force = summary["force_N"]
    share = summary["waypoints_in_contact"] / max(summary["waypoints"], 1)
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    text = (f"The tool carries up to {most}\u00a0N, {mean}\u00a0N on average where it is in contact, which is at "
            f"{100 * share:.0f}\u00a0% of the waypoints.")  # fmt: skip
    level = summary.get("uncertainty")
    if level is None:
        return text
    whence = "as the job says" if summary["uncertainty_stated"] else "assumed"
    return f"{text} The level is uncertain by {100 * level:.0f}\u00a0% (one standard deviation, {whence})."


def _overview(found: ForcePrediction) -> Section:
    force = np.linalg.norm(found.wrench[:, :3], axis=1)
    scenes = [Chart(_colour_path(found, force, "N"), "The path coloured by the size of the force.", height=430,
                    linked_scenes=True)]  # fmt: skip
    if found.engagement is not None:
        drawn = _colour_path(found, 1e6 * found.engagement.section, "mm²")
        scenes.append(Chart(drawn, "The path coloured by what the tool sweeps through material a length of path.",
                            height=430, linked_scenes=True))  # fmt: skip
    blocks: list[Block] = [Columns([[scene] for scene in scenes])] if len(scenes) > 1 else [*scenes]
    turns = "; turning one scene turns the other" if len(scenes) > 1 else ""
    return Section("Along the path", blocks, f"Moves without contact are grey{turns}.")


def _colour_path(found: ForcePrediction, value: Array, unit: str) -> Any:

    points, rapid = 1e3 * found.nominal.position, value <= 0.0
    rows = thin_path(found.nominal.position, value, POINTS)
    shown = points[rows].astype(np.float32)
    figure = go.Figure()
    travel = np.where(rapid[rows, None], shown, np.nan)
    for k in np.flatnonzero(rapid[rows][1:] & ~rapid[rows][:-1]):
        travel[k] = shown[k]
    x, y, z = (_listed(column) for column in travel.T)
    grey = {"color": NEUTRAL, "width": 2}
    figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="lines", line=grey, hoverinfo="skip"))
    cut = np.where(rapid[rows, None], np.nan, shown)
    line = {"color": value[rows].astype(np.float32), "width": 6, "colorscale": [list(stop) for stop in SEQUENTIAL],
            "cmin": 0.0, "cmax": float(max(value.max(), 1e-9)), "showscale": True,
            "colorbar": {"title": {"text": unit}, "thickness": 12, "len": 0.8}}  # fmt: skip
    figure.add_trace(go.Scatter3d(
        x=_listed(cut[:, 0]), y=_listed(cut[:, 1]), z=_listed(cut[:, 2]), mode="lines", line=line,
        customdata=np.column_stack([rows, value[rows]]).astype(np.float32),
        hovertemplate="waypoint %{customdata[0]:.0f}: %{customdata[1]:.4g} " + unit + "<extra></extra>",
    ))  # fmt: skip
    scene = frame_scene(points, size=1.75)
    figure.update_layout(scene=scene, margin={"l": 0, "r": 0, "t": 0, "b": 0}, showlegend=False)
    return figure


def _listed(values: Array) -> list[float | None]:
    """Return numbers for a trace whose gaps are None."""
    return [None if np.isnan(value) else round(float(value), 4) for value in values]


def _along(found: ForcePrediction, stations: Stations) -> Section:
    names = ("along the travel", "to the left", "along the tool axis")
    series = dict(zip(names, _leave_out_air(found, found.local[:, :3]).T, strict=True))
    blocks: list[Block] = [
        Chart(draw_lines(stations, series, "N", title="force", colours=CATEGORIES[:3]),
              "Mean force of the environment on the tool; left as seen down the tool axis, the axis from tip up.",
              height=340),
    ]  # fmt: skip
    if found.ripple is not None and found.ripple.any():
        ripple = dict(zip(names, _leave_out_air(found, found.ripple).T, strict=True))
        lines = draw_lines(stations, ripple, "N", title="ripple", colours=CATEGORIES[:3], zero=True)
        blocks.append(Chart(lines, "Half of the range of each component in a turn of the spindle.", height=280))
    tall = 440 if np.abs(found.wrench[:, 3:]).max() > 1e-9 else 300
    lines = draw_wrench(stations, _leave_out_air(found, found.wrench))
    blocks.append(Chart(lines, "The same wrench at the tip, base axes.", height=tall))
    return Section("Force", blocks)


def _engagement(found: ForcePrediction, cut: Engagement, stations: Stations) -> Section:
    depth = {"axial depth": 1e3 * _leave_out_air(found, cut.axial),
             "radial width": 1e3 * _leave_out_air(found, cut.radial)}  # fmt: skip
    arc = np.degrees(cut.arc)
    angles = {"first": arc[:, 0], "last": arc[:, 1]}
    return Section(
        "Engagement",
        [
            Chart(draw_lines(stations, depth, "mm", title="engaged", colours=(AFTER, BEFORE), zero=True),
                  "Axial depth and radial width of what the cutter meets.", height=300),
            Chart(draw_lines(stations, angles, "deg", title="angle", colours=(AFTER, BEFORE)),
                  "First and last engaged angle, from the travel to the left; none in the air.", height=280),
            _tabulate(found, cut),
        ],
    )  # fmt: skip


def _tabulate(found: ForcePrediction, cut: Engagement) -> PageTable:
    """Tabulate engagement and force at even lengths of the cut."""
    touches = np.flatnonzero(cut.touches)
    rows = touches[np.unique(np.linspace(0, len(touches) - 1, min(len(touches), 60)).astype(int))]
    force, arc = np.linalg.norm(found.wrench[:, :3], axis=1), np.degrees(cut.arc)
    length = 1e3 * found.nominal.arc_length
    table: list[Row]
    table = [[int(i), float(length[i]), float(1e3 * cut.axial[i]), float(1e3 * cut.radial[i]), float(arc[i, 0]),
              float(arc[i, 1]), TableCell(float(force[i]), "strong")] for i in rows]  # fmt: skip
    columns = [Column("waypoint"), Column("length", "mm", 4), Column("axial depth", "mm"), Column("radial width", "mm"),
               Column("first angle", "deg"), Column("last angle", "deg"), Column("force", "N")]  # fmt: skip
    return PageTable(columns, table, "At even steps of the cut; forces.csv has every waypoint.", scroll=14)


def _comparison(fit: ForceFit) -> Section:
    table: list[Row] = []
    for number in fit.numbers:
        inside = number.low <= number.in_job <= number.high
        verdict = TableCell("within" if inside else "differs", "good" if inside else "bad")
        fitted = TableCell(number.value, "strong")
        table.append([number.name, number.in_job, fitted, number.low, number.high, number.unit, verdict])
    columns = [Column("number"), Column("in the job", "", 4), Column("fitted", "", 4), Column("from"),
               Column("to (95 %)"), Column("unit"), Column("the job's value")]  # fmt: skip
    before, after, level = (format_number(v) for v in (fit.rms_before, fit.rms_after, fit.level))
    text = (f"{fit.rows} rows of the log lie in the cut. The prediction is off by {before} N (rms), of {level} N "
            f"measured; with the fitted numbers by {after} N.")  # fmt: skip
    notes = list(fit.notes)
    table_of_numbers = PageTable(columns, table, "Intervals from leaving out blocks of the path.")
    return Section("Measured log", [text, *notes, table_of_numbers])
