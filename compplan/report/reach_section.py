"""What a plan reaches: the band of the true tip along the path against the tolerance, the figures, the cell."""

from __future__ import annotations

from typing import Any

import numpy as np

from compplan.report.along_path import draw_lines, find_spans
from compplan.report.page import Chart, Column, Columns, PageTable, Section, TableCell
from compplan.report.path_scene import draw_cell
from compplan.report.plan_view import PlanView
from compplan.report.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    NEUTRAL,
    format_angle,
    format_length,
    format_number,
    format_percent,
    format_set_length,
)

#: The band flattens the other lines where it reaches this many times as far.
FLATTENED = 2.0


def show_reach(view: PlanView) -> Section:
    """Show the band along the path, the figures and the robot in its cell."""
    kinds = np.where(view.pushed, 0, np.where(view.cut, 1, 2))
    named = ", ".join(shape.link for shape in view.around)
    with_them = f", with the meshes that the job names ({named})" if named else ""
    cell = Chart(
        draw_cell(view.robot, view.q, view.nominal, start=view.start, around=view.around, kinds=kinds),
        f"The robot at the first waypoint of the cut, drawn from its URDF shapes{with_them}, and the path of the tool "
        "tip: which moves carry force, which are in the cut without, and which are rapid.",
        height=400,
        along=True,
    )
    return Section("What it reaches", [_band(view), Columns([[_key_figures(view)], [cell]], (0.5, 0.5))])


def _band(view: PlanView) -> Chart:
    """Show what matters first: how far the true tip may be from the path, against the tolerance."""
    judged = np.where(view.cut, 1.0, np.nan)
    before, after = (np.linalg.norm(side, axis=1) for side in (view.before, view.after))
    series = {"as modelled": 1e3 * after * judged}
    said = "Distance of the loaded tool tip from the path. As modelled: what the plan leaves if the model is the truth."
    if view.mismatch is not None:
        series[view.mismatch.cell] = 1e3 * view.mismatch.along(len(after)) * judged
        said += f" {view.mismatch.cell.capitalize()}: what it leaves if all of them are wrong by that much (assumed)."
    if view.promise is not None:
        series = {"true tip, 95 %": 1e3 * view.promise.along * judged, **series}
        said = f"Shaded: where the true tip is with 95 %, by what is known of robot and force. {said}"
    shown = max(1.25 * 1e3 * view.tolerance, *(1.08 * float(np.nanmax(values)) for values in series.values()))
    uncorrected = 1e3 * before * judged
    if np.nanmax(uncorrected) < 3 * shown:
        series["uncorrected"], shown = uncorrected, max(shown, 1.08 * float(np.nanmax(uncorrected)))
    else:
        said += f" Uncorrected lies off the chart, up to {format_length(1e-3 * float(np.nanmax(uncorrected)))}."
    limit = (1e3 * view.tolerance, f"tolerance {format_set_length(view.tolerance)}")
    colours = {"true tip, 95 %": NEUTRAL, "as modelled": AFTER, "uncorrected": BEFORE}
    figure = draw_lines(
        view.stations, series, "mm", title="deviation", limit=limit, zero=True,
        colours=[colours.get(name, CATEGORIES[3]) for name in series],
    )  # fmt: skip
    figure.update_traces(line_dash="dot", selector={"name": "uncorrected"})
    figure.update_yaxes(range=[0.0, shown])
    if view.promise is not None:
        _fill_band(figure)
        others = [values for name, values in series.items() if name != "true tip, 95 %"]
        _offer_without(figure, shown, max(1.25 * 1e3 * view.tolerance, *(1.08 * float(np.nanmax(v)) for v in others)))
    return Chart(figure, said, height=340, along=True)


def _fill_band(figure: Any) -> None:
    """Fill the band where it is known: a fill goes on over the gaps of its line, so it has a trace of its own."""
    line = figure.data[0]
    x, y = (np.asarray(values, float) for values in (line.x, line.y))
    spans = find_spans(np.isfinite(y))
    edges = spans.ravel()  # down to zero where it begins and where it ends
    order = np.argsort(np.r_[np.arange(len(x)), spans[:, 0] - 0.5, spans[:, 1] + 0.5], kind="stable")
    figure.add_scatter(
        x=np.r_[x, x[spans[:, 0]], x[spans[:, 1]]][order].astype(np.float32), name=line.name,
        y=np.r_[np.nan_to_num(y), np.zeros(len(edges))][order].astype(np.float32), fill="tozeroy", mode="lines",
        fillcolor="rgba(127, 127, 127, 0.35)", line={"width": 0}, hoverinfo="skip", legendgroup="band",
    )  # fmt: skip
    line.legendgroup, line.showlegend = "band", False
    figure.data = (figure.data[-1], *figure.data[:-1])


def _offer_without(figure: Any, whole: float, others: float) -> None:
    """Let the reader leave the band out where it flattens the other lines."""
    if whole < FLATTENED * others:
        return
    shown = [trace.legendgroup != "band" for trace in figure.data]
    buttons = [
        {"label": "band", "method": "update", "args": [{"visible": True}, {"yaxis.range": [0.0, whole]}]},
        {"label": "without", "method": "update", "args": [{"visible": shown}, {"yaxis.range": [0.0, others]}]},
    ]
    figure.update_layout(
        updatemenus=[
            {
                "type": "buttons", "direction": "right", "buttons": buttons, "x": 1.0, "xanchor": "right", "y": 1.0,
                "yanchor": "top", "bgcolor": "rgba(127, 127, 127, 0.12)", "borderwidth": 0, "pad": {"t": 0, "b": 0},
                "font": {"size": 11.5}, "showactive": False,
            }
        ]
    )  # fmt: skip


def _key_figures(view: PlanView) -> PageTable:
    rows: list[list[TableCell | str | float | int | None]] = []
    cut = view.cut
    before, after = (np.linalg.norm(side, axis=1)[cut] for side in (view.before, view.after))
    for name, reduce in (("rms", lambda size: np.sqrt(np.mean(size**2))), ("mean", np.mean), ("largest", np.max)):
        rows.append([f"deviation, {name}", *(_length_cell(float(reduce(size))) for size in (before, after))])
    for name, value in zip(("rms", "largest"), view.uncoupled or (), strict=False):
        rows.append([f"{name}, by the force on the path", _length_cell(value), None])
    for way, distance in view.between.items():
        rows.append([f"between waypoints, {way}", None, _length_cell(distance)])
    if view.mismatch is not None:
        wrong = format_length(view.mismatch.max_deviation)
        rows.append([f"largest, {view.mismatch.cell}", None, TableCell(wrong, "strong")])
    shares = [TableCell(format_percent(float((size <= view.tolerance).mean()))) for size in (before, after)]
    rows.append([f"within {format_set_length(view.tolerance)}", *shares])
    if view.tilt_before is not None and view.tilt_after is not None:
        tilts = [float(tilt[cut].max()) for tilt in (view.tilt_before, view.tilt_after)]
        rows.append(["tool axis off by up to", *(TableCell(format_angle(tilt)) for tilt in tilts)])
    correction = float(np.linalg.norm(view.correction, axis=1)[cut].max())
    allowed = f"{format_length(correction)} of {format_set_length(view.max_correction)}"
    rows.append(["largest correction", None, TableCell(allowed)])
    rows.append(["smallest joint margin", None, TableCell(_tightest(view))])
    for name, rates, limits in view.rates:
        share = np.abs(rates) / limits
        joint = view.robot.joint_names[int(np.argmax(share.max(axis=0)))]
        rows.append([f"{name} used", None, TableCell(f"{format_percent(float(share.max()))} ({joint})")])
    rows += [[name, None, TableCell(value)] for name, value in view.bending.items()]
    length = format_number(1e3 * float(view.length[-1]), 4)
    rows.append(["path", None, TableCell(f"{length} mm in {format_number(len(cut))} waypoints")])
    rows.append(["time", None, TableCell(f"{format_number(float(view.time[-1]), 4)} s")])
    return PageTable([Column(""), Column("uncorrected"), Column("planned")], rows)


def _length_cell(value: float) -> TableCell:
    return TableCell(format_length(value), "strong")


def _tightest(view: PlanView) -> str:
    margin = np.minimum(view.q - view.robot.lower, view.robot.upper - view.q).min(axis=0)
    scale = np.where(view.robot.prismatic, 1e3, 180 / np.pi)
    share = margin / np.where(view.robot.prismatic, 1.0, np.pi)
    if not np.isfinite(share).any():
        return "no limits"
    k = int(np.argmin(share))
    unit = "mm" if view.robot.prismatic[k] else "deg"
    return f"{format_number(float(margin[k] * scale[k]))} {unit} ({view.robot.joint_names[k]})"
