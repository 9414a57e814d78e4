"""What a plan reaches: the band of the true tip along the path against the tolerance, the figures, the cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.planning.tolerance_verdict import describe_tolerance
from compplan.reporting.along_path import Stations, below, draw_lines, outline_below
from compplan.reporting.force_moves import list_rates, mark_force
from compplan.reporting.page import Chart, Column, Columns, PageTable, Row, Section, TableCell
from compplan.reporting.path_scene import draw_cell
from compplan.reporting.robot_scene import place_meshes
from compplan.reporting.style import (
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

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: The band flattens the other lines where it reaches this many times as far.
FLATTENED = 2.0


def show_reach(plan: Plan, stations: Stations) -> Section:
    """Show the band along the path, the figures and the robot in its cell."""
    cut = plan.after.cut
    kinds = np.where(mark_force(plan.task.wrench, cut), 0, np.where(cut, 1, 2))
    start = int(np.flatnonzero(cut)[0])
    request = None if plan.task.start is None else plan.task.start.request
    scene = None if request is None else request.scene
    around = [] if scene is None else place_meshes(plan.robot, plan.q[start], scene.meshes)
    named = ", ".join(shape.link for shape in around)
    with_them = f", with the meshes that the job names ({named})" if named else ""
    cell = Chart(
        draw_cell(plan.robot, plan.q, plan.task.position, start=start, around=around, kinds=kinds),
        f"The robot at the first waypoint of the cut, drawn from its URDF shapes{with_them}, and the path of the tool "
        "tip: which moves carry force, which are in the cut without, and which are rapid.",
        height=400,
        along=True,
    )
    return Section("What it reaches", [_band(plan, stations), Columns([[_key_figures(plan)], [cell]], (0.5, 0.5))])


def _band(plan: Plan, stations: Stations) -> Chart:
    """Show what matters first: how far the true tip may be from the path, against the tolerance."""
    evaluated = np.where(plan.after.cut, 1.0, np.nan)
    before, after = (side.distance for side in (plan.before, plan.after))
    series = {"as modelled": 1e3 * after * evaluated}
    said = "Distance of the loaded tool tip from the path. As modelled: what the plan leaves if the model is the truth."
    series[plan.mismatch.cell] = 1e3 * plan.mismatch.along(len(after)) * evaluated
    said += f" {plan.mismatch.cell.capitalize()}: what it leaves if all of them are wrong by that much (assumed)."
    if plan.promise is not None:
        series = {"true tip, 95 %": 1e3 * plan.promise.along * evaluated, **series}
        said = f"Shaded: where the true tip is with 95 %, by what is known of robot and force. {said}"
    shown = max(1.25 * 1e3 * plan.task.tolerance, *(1.08 * float(np.nanmax(values)) for values in series.values()))
    uncorrected = 1e3 * before * evaluated
    if np.nanmax(uncorrected) < 3 * shown:
        series["uncorrected"], shown = uncorrected, max(shown, 1.08 * float(np.nanmax(uncorrected)))
    else:
        said += f" Uncorrected lies off the chart, up to {format_length(1e-3 * float(np.nanmax(uncorrected)))}."
    limit: tuple[float, str] | None = (1e3 * plan.task.tolerance, f"tolerance {format_set_length(plan.task.tolerance)}")
    if plan.task.allowed is not None:
        limit, series["tolerance here"] = None, 1e3 * plan.task.allowed.normal * evaluated
        shown = max(shown, 1.08 * float(np.nanmax(series["tolerance here"])))
        said += " The tolerance is that of each part, across the travel where it counts apart."
    colours = {"true tip, 95 %": NEUTRAL, "as modelled": AFTER, "uncorrected": BEFORE}
    figure = draw_lines(
        stations, series, "mm", title="deviation", limit=limit, zero=True,
        colours=[colours.get(name, CATEGORIES[3]) for name in series],
    )  # fmt: skip
    figure.update_traces(line_dash="dot", selector={"name": "uncorrected"})
    figure.update_yaxes(range=[0.0, shown])
    if plan.promise is not None:
        _fill_band(figure)
        others = [values for name, values in series.items() if name != "true tip, 95 %"]
        highest = max(float(np.nanmax(values)) for values in others)
        _offer_without(figure, shown, max(1.25 * 1e3 * plan.task.tolerance, 1.08 * highest))
    return Chart(figure, said, height=340, along=True)


def _fill_band(figure: Any) -> None:
    """Fill the band under its line."""
    line = figure.data[0]
    x, y = outline_below(np.asarray(line.x, float), np.asarray(line.y, float))
    figure.add_scatter(x=x, y=y, name=line.name, legendgroup="band", **below("rgba(127, 127, 127, 0.35)"))
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


def _key_figures(plan: Plan) -> PageTable:
    rows: list[Row] = []
    task, sides, between = plan.task, (plan.before, plan.after), plan.between
    for name in ("rms", "mean", "max"):
        sizes = [_length_cell(1e-3 * side.figures[name]) for side in sides]
        rows.append([f"deviation, {'largest' if name == 'max' else name}", *sizes])
    ways = {"joints linear": between.joint, "tip linear": between.cartesian, "spline": between.spline}
    for way, moves in ways.items():
        rows.append([f"between waypoints, {way}", None, _length_cell(float(moves.max(initial=0.0)))])
    if plan.executed is not None:
        drives = "drives as identified" if plan.executed.known else "drives not known"
        way = "programs" if plan.executed.zone else "waypoints"
        rows.append([f"as the controller executes the {way}, {drives}", None, _length_cell(plan.executed.most)])
    rows.append([f"largest, {plan.mismatch.cell}", None, _length_cell(plan.mismatch.max_deviation)])
    uses = [task.use_tolerance(side.deviation)[side.cut] for side in sides]
    shares = [TableCell(format_percent(float((use <= 1.0).mean()))) for use in uses]
    within = format_set_length(task.tolerance) if task.allowed is None else describe_tolerance(task)
    rows.append([f"within {within}", *shares])
    if task.allowed is not None:
        worst = [TableCell(format_percent(float(use.max()))) for use in uses]
        rows.append(["worst, in shares of its tolerance", *worst])
    rows.append(["tool axis off by up to", *(TableCell(format_angle(side.max_tilt)) for side in sides)])
    allowed = f"{format_length(plan.margins.max_correction)} of {format_set_length(task.max_correction)}"
    rows.append(["largest correction", None, TableCell(allowed)])
    rows.append(["smallest joint margin", None, TableCell(_tightest(plan))])
    for name, rates, limits in list_rates(task, plan.timing):
        share = np.abs(rates) / limits
        joint = plan.robot.joint_names[int(np.argmax(share.max(axis=0)))]
        rows.append([f"{name} used", None, TableCell(f"{format_percent(float(share.max()))} ({joint})")])
    rows += [[name, None, TableCell(value)] for name, value in _list_bending(plan).items()]
    length = format_number(1e3 * float(task.nominal.arc_length[-1]), 4)
    rows.append(["path", None, TableCell(f"{length} mm in {format_number(len(task))} waypoints")])
    rows.append(["time", None, TableCell(f"{format_number(float(plan.timing.time[-1]), 4)} s")])
    return PageTable([Column(""), Column("uncorrected"), Column("planned")], rows)


def _length_cell(value: float) -> TableCell:
    return TableCell(format_length(value), "strong")


def _tightest(plan: Plan) -> str:
    margin = np.minimum(plan.q - plan.robot.lower, plan.robot.upper - plan.q).min(axis=0)
    margin[plan.robot.lower == plan.robot.upper] = np.inf  # stands where the job holds it
    scale = np.where(plan.robot.prismatic, 1e3, 180 / np.pi)
    share = margin / np.where(plan.robot.prismatic, 1.0, np.pi)
    if not np.isfinite(share).any():
        return "no limits"
    k = int(np.argmin(share))
    unit = "mm" if plan.robot.prismatic[k] else "deg"
    return f"{format_number(float(margin[k] * scale[k]))} {unit} ({plan.robot.joint_names[k]})"


def _list_bending(plan: Plan) -> dict[str, str]:
    """Return what bends the arm, cause by cause, and how it rings."""
    bending, assumed = plan.bending, " (assumed masses)" if "assumed" in plan.bending.masses else ""
    rows = {}
    if plan.promise is not None:
        rows["true tip within, with 95\u00a0%"] = format_length(plan.promise.whole)
    rows |= {"bent by the process": format_length(bending.process), "bent by weight": format_length(bending.weight)}
    if np.isfinite(bending.inertia):
        word = "compensated" if bending.compensated else "not compensated"
        rows[f"bent by inertia, {word}{assumed}"] = format_length(bending.inertia)
    if np.isfinite(bending.frequencies).all():
        rows[f"lowest natural frequencies{assumed}"] = f"{', '.join(f'{f:.3g}' for f in bending.frequencies)}\u00a0Hz"
    if plan.clearance is not None:
        near = min(plan.clearance.least[1], plan.clearance.own, key=lambda contact: contact.distance)
        if np.isfinite(near.distance) and near.first:
            rows["least clearance"] = f"{format_length(near.distance)} ({near.first} to {near.second})"
    return rows
