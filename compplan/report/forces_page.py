"""The page of `compplan forces`: the path coloured by force and engagement, and both along the path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from compplan.path.forces.engagement import Engagement
from compplan.path.forces.fit import ForceFit
from compplan.path.toolpath import Toolpath
from compplan.report.along_path import Stations, draw_lines, draw_wrench, find_spans
from compplan.report.page import Block, Chart, Column, Columns, PageTable, Provenance, Section, TableCell, write_page
from compplan.report.robot_scene import frame_scene
from compplan.report.style import AFTER, BEFORE, CATEGORIES, NEUTRAL, SEQUENTIAL, format_number
from compplan.report.thinning import thin_path
from compplan.robot import Array

#: About how many points of a path are drawn in a scene.
POINTS = 4000


@dataclass(frozen=True)
class ForcesView:
    """What the page shows; n waypoints.

    Attributes:
        title: Name of the job.
        model: Name of the force model.
        nominal: The path, base frame.
        wrench: On the tool at its tip, base axes. Shape (n, 6). [N, N m]
        local: The force in path axes. Shape (n, 3). [N]
        ripple: Half of its range through a turn, path axes, or None. Shape (n, 3). [N]
        engagement: What a cutter touches, or None.
        fit: The comparison with a log, or None.
        notes: What to know.
        summary: What forces.json holds.

    """

    title: str
    model: str
    nominal: Toolpath
    wrench: Array
    local: Array
    ripple: Array | None = None
    engagement: Engagement | None = None
    fit: ForceFit | None = None
    notes: tuple[str, ...] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stations(self) -> Stations:
        """Where the waypoints are, for the charts."""
        step = np.where(self.nominal.rapid[1:] | (self.nominal.feed[1:] <= 0.0), 0.0,
                        self.nominal.steps / np.maximum(self.nominal.feed[1:], 1e-9))  # fmt: skip
        length = self.nominal.arc_length
        spans = find_spans(self.nominal.rapid)
        spans = np.column_stack([np.maximum(spans[:, 0] - 1, 0), spans[:, 1]]).astype(int)
        return Stations(length, np.r_[0.0, np.cumsum(step)], np.zeros(0, int), length[spans].reshape(-1, 2))


def write_forces_page(view: ForcesView, file: Path) -> None:
    """Write the page."""
    sections = [_overview(view), _along(view)]
    if view.engagement is not None:
        sections.append(_engagement(view))
    if view.fit is not None:
        sections.append(_comparison(view, view.fit))
    coefficients = view.summary.get("coefficients", {})
    facts = [("force model", view.model)] + [(name, str(value)) for name, value in coefficients.items()]
    assumed = [note for note in view.notes if "assumed" in note]
    write_page(file, view.title, _lede(view), sections, kind="Forces", notes=view.notes,
               provenance=Provenance(facts, assumed))  # fmt: skip


def _lede(view: ForcesView) -> str:
    force = view.summary["force_N"]
    share = view.summary["waypoints_in_contact"] / max(view.summary["waypoints"], 1)
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    text = (f"The tool carries up to {most}\u00a0N, {mean}\u00a0N on average where it is in contact, which is at "
            f"{100 * share:.0f}\u00a0% of the waypoints.")  # fmt: skip
    level = view.summary.get("uncertainty")
    if level is None:
        return text
    return f"{text} The level is uncertain by {100 * level:.0f}\u00a0% (one standard deviation)."


def _overview(view: ForcesView) -> Section:
    force = np.linalg.norm(view.wrench[:, :3], axis=1)
    scenes = [Chart(_colour_path(view, force, "N"), "The path coloured by the size of the force.", height=430,
                    linked_scenes=True)]  # fmt: skip
    if view.engagement is not None:
        drawn = _colour_path(view, 1e6 * view.engagement.section, "mm²")
        scenes.append(Chart(drawn, "The path coloured by what the tool sweeps through material a length of path.",
                            height=430, linked_scenes=True))  # fmt: skip
    blocks: list[Block] = [Columns([[scene] for scene in scenes])] if len(scenes) > 1 else [*scenes]
    return Section("Along the path", blocks, "Moves without contact are grey; turning one scene turns the other.")


def _colour_path(view: ForcesView, value: Array, unit: str) -> Any:
    import plotly.graph_objects as go

    points, rapid = 1e3 * view.nominal.position, value <= 0.0
    rows = thin_path(view.nominal.position, value, POINTS)
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
    figure.update_layout(scene=frame_scene(points), margin={"l": 0, "r": 0, "t": 0, "b": 0}, showlegend=False)
    return figure


def _listed(values: Array) -> list[float | None]:
    """Return numbers for a trace whose gaps are None."""
    return [None if np.isnan(value) else round(float(value), 4) for value in values]


def _along(view: ForcesView) -> Section:
    names = ("along the travel", "to the left", "along the tool axis")
    series = {name: view.local[:, k] for k, name in enumerate(names)}
    blocks: list[Block] = [
        Chart(draw_lines(view.stations, series, "N", title="force", colours=CATEGORIES[:3]),
              "Mean force of the environment on the tool; left as seen down the tool axis, the axis from tip up.",
              height=340),
    ]  # fmt: skip
    if view.ripple is not None:
        ripple = {name: view.ripple[:, k] for k, name in enumerate(names)}
        lines = draw_lines(view.stations, ripple, "N", title="ripple", colours=CATEGORIES[:3], zero=True)
        blocks.append(Chart(lines, "Half of the range of each component in a turn of the spindle.", height=280))
    tall = 440 if np.abs(view.wrench[:, 3:]).max() > 1e-9 else 300
    blocks.append(Chart(draw_wrench(view.stations, view.wrench), "The same wrench at the tip, base axes.", height=tall))
    return Section("Force", blocks)


def _engagement(view: ForcesView) -> Section:
    cut = view.engagement
    assert cut is not None
    depth = {"axial depth": 1e3 * cut.axial, "radial width": 1e3 * cut.radial}
    arc = np.degrees(cut.arc)
    angles = {"first": arc[:, 0], "last": arc[:, 1]}
    return Section(
        "Engagement",
        [
            Chart(draw_lines(view.stations, depth, "mm", title="engaged", colours=(AFTER, BEFORE), zero=True),
                  "Axial depth and radial width of what the cutter meets.", height=300),
            Chart(draw_lines(view.stations, angles, "deg", title="angle", colours=(AFTER, BEFORE)),
                  "First and last engaged angle, from the travel to the left; none in the air.", height=280),
            _tabulate(view, cut),
        ],
    )  # fmt: skip


def _tabulate(view: ForcesView, cut: Engagement) -> PageTable:
    """Tabulate engagement and force at even lengths of the cut."""
    touches = np.flatnonzero(cut.touches)
    rows = touches[np.unique(np.linspace(0, len(touches) - 1, min(len(touches), 60)).astype(int))]
    force, arc = np.linalg.norm(view.wrench[:, :3], axis=1), np.degrees(cut.arc)
    length = 1e3 * view.nominal.arc_length
    table: list[list[TableCell | str | float | int | None]]
    table = [[int(i), float(length[i]), float(1e3 * cut.axial[i]), float(1e3 * cut.radial[i]), float(arc[i, 0]),
              float(arc[i, 1]), TableCell(float(force[i]), "strong")] for i in rows]  # fmt: skip
    columns = [Column("waypoint"), Column("length", "mm", 4), Column("axial depth", "mm"), Column("radial width", "mm"),
               Column("first angle", "deg"), Column("last angle", "deg"), Column("force", "N")]  # fmt: skip
    return PageTable(columns, table, "At even steps of the cut; forces.csv holds every waypoint.", scroll=14)


def _comparison(view: ForcesView, fit: ForceFit) -> Section:
    table: list[list[TableCell | str | float | int | None]] = []
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
    return Section("Measured log", [text, PageTable(columns, table, "Intervals from leaving out blocks of the path.")])
