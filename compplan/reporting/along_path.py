"""Charts of quantities along a path: deviation, joints against limits, rates, corrections, wrench, feed.

The horizontal axis of every chart is the path length in mm; hovering shows waypoint and time. Long paths are thinned
for drawing; peaks are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.palette import CATEGORIES, DASHES, LIMIT, NEUTRAL
from compplan.io.quantities import format_number
from compplan.reporting.charts import Figure, find_spans, thin_rows, use_decades
from compplan.reporting.page import Chart
from compplan.robot import Array

#: Approximate number of drawn rows of a chart, and number of intervals of a path for marking waypoints.
ROWS, FIELDS = 1600, 240
#: Least deviation on a logarithmic axis; smaller ones are drawn at this value. [m]
FLOOR = 1e-8
#: Share of its limit below which a rate is drawn enlarged, without the limit. [%]
NEAR_LIMIT = 40.0
#: Number of charts in a row of a grid, and height of one chart [px].
COLUMNS, HEIGHT = 3, 190


@dataclass(frozen=True)
class Stations:
    """Path length and time of the waypoints of a path, for horizontal axes and hovering."""

    length: Array  #: Path length up to each waypoint. Shape (n,). [m]
    time: Array  #: Time of each waypoint. Shape (n,). [s]
    marked: NDArray[np.int_]  #: Waypoints to mark, such as infeasible ones.
    shaded: Array  #: Intervals of path length to shade, such as rapid moves. Shape (k, 2). [m]

    @property
    def marked_spans(self) -> Array:
        """Intervals of path length around the marked waypoints, adjacent ones merged. Shape (k, 2). [m]"""
        total = max(float(self.length[-1]), 1e-12)
        flags = np.zeros(FIELDS, bool)
        flags[np.minimum((self.length[self.marked] / total * FIELDS).astype(int), FIELDS - 1)] = True
        return (find_spans(flags) + np.array([0, 1])) * total / FIELDS


def place_stations(position: Array, time: Array, cut: NDArray[np.bool_], failures: Iterable[int] = ()) -> Stations:
    """Compute path length and time of waypoints; stretches outside the cut are shaded, failures are marked.

    position: nominal tip, shape (n, 3) [m]; time: shape (n,) [s]; cut: waypoints of the cut, shape (n,).
    """
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))]
    spans = find_spans(~cut)
    last = np.minimum(spans[:, 1] + 1, len(cut) - 1)  # include the point of contact that ends a rapid move
    shaded = length[np.column_stack([np.maximum(spans[:, 0] - 1, 0), last]).astype(int)].reshape(-1, 2)
    return Stations(length, time, np.array(sorted(failures), int), shaded)


class PathPanel(NamedTuple):
    """One small chart of quantities along a path: values by name in the displayed unit, shape (n,) each.

    `label`: title of the vertical axis, first column only; `span`: its range; `beyond`: intervals beyond a limit.
    """

    series: Mapping[str, Array]
    label: str = ""
    unit: str = ""
    title: str = ""
    span: tuple[float, float] | None = None
    beyond: Sequence[tuple[float, float]] = ()


def draw_panels(
    stations: Stations, panels: Sequence[PathPanel], *, columns: int = 1, shared: str = "x",
    colours: Sequence[str] = CATEGORIES, shaded: bool = True, gaps: tuple[float, float] | None = None,
) -> Figure:  # fmt: skip
    """Draw small charts of quantities along a path, row by row.

    `shared`: axis shared by the charts, "" for none; `colours`: one per series; `gaps`: gap between charts as a share
    of width and height; `shaded`: whether the shaded intervals of the stations are drawn.
    """
    gaps = gaps or (0.025, 0.08 if columns == 1 else 0.32 / -(-len(panels) // columns))
    figure = Figure([panel.title for panel in panels], columns, gaps=gaps, shared=shared)
    for number, panel in enumerate(panels):
        _add_lines(figure, stations, panel, number, colours, ROWS if columns == 1 else ROWS // 2)
        spans = [(stations.shaded, NEUTRAL, 0.14)] if shaded else []
        spans += [(stations.marked_spans, LIMIT, 0.28)] if len(stations.marked) else []
        for rows, colour, opacity in spans:
            for start, end in (1e3 * rows).tolist():
                figure.band(start, end, "x", number, fillcolor=colour, opacity=opacity, layer="below")
        for start, end in panel.beyond:
            figure.band(start, end, "y", number, fillcolor=LIMIT, opacity=0.16)
        if panel.label and number % columns == 0:
            figure.axis("y", number, title=panel.label)
        if panel.span is not None:
            figure.axis("y", number, range=list(panel.span))
        if number >= len(panels) - columns:
            figure.axis("x", number, title="along the path, mm")
    end = 1e3 * float(stations.length[-1])
    figure.axis("x", range=[-0.005 * end, 1.005 * end], nticks=0 if columns == 1 else 5)
    figure.layout["hovermode"] = "x unified" if any(len(panel.series) > 1 for panel in panels) else "x"
    if columns > 1:
        figure.layout |= {"margin": {"t": 56}, "legend": {"y": 1.0, "yref": "container", "yanchor": "top"}}
    return figure


def _add_lines(
    figure: Figure, stations: Stations, panel: PathPanel, number: int, colours: Sequence[str], limit: int
) -> None:
    """Add the series of a panel, thinned, with waypoint and time on hovering."""
    rows = thin_rows(list(panel.series.values()), limit)
    far = np.flatnonzero(np.diff(stations.length) > 4.0 * np.ptp(stations.length) / limit)  # keep both ends of gaps
    rows = np.union1d(rows, [far, far + 1])
    custom = np.column_stack([rows, stations.time[rows]]).astype(np.float32)
    for k, (name, values) in enumerate(panel.series.items()):
        dash = DASHES[k // len(colours) % len(DASHES)]  # further lines take the colours again, dashed, then dotted
        figure.line(
            1e3 * stations.length[rows], values[rows], name, number, customdata=custom, legendgroup=name,
            line={"color": colours[k % len(colours)], "dash": dash, "width": 1.6},
            showlegend=number == 0 and len(panel.series) > 1,
            hovertemplate=f"%{{y:.4g}} {panel.unit} (waypoint %{{customdata[0]:.0f}}, %{{customdata[1]:.2f}} s)",
        )  # fmt: skip


def chart_lines(
    stations: Stations, series: Mapping[str, Array], unit: str, title: str, caption: str, height: int = 340, *,
    colours: Sequence[str] = CATEGORIES, limit: tuple[float, str] | None = None, zero: bool = False,
) -> Chart:  # fmt: skip
    """Draw series along the path on one axis, in the displayed unit, shape (n,) each.

    `limit`: a level to mark, and its label; `zero`: the axis starts at zero.
    """
    label = f"{title}, {unit}" if unit else title
    figure = draw_panels(stations, [PathPanel(series, label, unit)], colours=colours)
    if zero:
        figure.axis("y", rangemode="tozero")
    if limit is not None:
        figure.level(limit[0], width=1.4)
        figure.note(limit[1], x=1, xref="paper", xanchor="right", y=limit[0])
    return Chart(figure, caption, height, along=True)


def chart_strategies(
    stations: Stations, deviations: Mapping[str, Mapping[str, Array]], tolerance: float, *, log: bool = False
) -> Chart:
    """Draw deviations along the path, one small chart per strategy, all with the same axes.

    deviations: by title of the chart, series by name, shape (n,) each [mm]; tolerance: marked level [mm].
    """
    together = [values for series in deviations.values() for values in series.values()]
    known = np.concatenate([values[np.isfinite(values) & (values > 0)] for values in together])
    least, greatest = (float(known.min()), float(known.max())) if len(known) else (1e-6, 1.0)
    most = max(greatest, 1.3 * tolerance)
    label = "deviation" if log else "deviation, mm"
    panels = [PathPanel(series, label, "mm", name, (0.0, 1.06 * most)) for name, series in deviations.items()]
    figure = draw_panels(stations, panels, columns=min(COLUMNS, len(panels)), shared="y")
    figure.level(tolerance, width=1.2)
    if log:
        ends = [float(np.log10(0.8 * max(least, 1e-5))), float(np.log10(1.25 * most))]
        use_decades(figure, "y", max(least, 1e-5), most, range=ends)
    caption = (
        f"One chart a strategy, all with the same axes{', logarithmic' * log}; dashed: tolerance {tolerance:g} mm."
    )
    return Chart(figure, caption, 80 + HEIGHT * -(-len(deviations) // COLUMNS), along=True)


def draw_joints(
    stations: Stations, q: Array, lower: Array, upper: Array, names: Sequence[str], slides: NDArray[np.bool_]
) -> Figure:
    """Draw the position of each joint between its limits, one small chart per joint.

    q: commanded positions, shape (n, nq); lower, upper: limits, shape (nq,) [rad or m]; slides: prismatic joints.
    """
    panels = []
    for k, name in enumerate(names):
        scale, unit = (1e3, "mm") if slides[k] else (180 / np.pi, "deg")
        values, low, high = q[:, k] * scale, float(lower[k] * scale), float(upper[k] * scale)
        least, most = float(values.min()), float(values.max())
        text = f"{format_number(least)} to {format_number(most)} {unit}"
        margin = min(least - low, high - most)
        text += f", {format_number(margin)} left" if np.isfinite(margin) else ", no limits"
        bottom = min(low, least) if np.isfinite(low) else least
        top = max(high, most) if np.isfinite(high) else most
        room = 0.07 * max(top - bottom, 1e-6)
        sides = ((bottom - room, low), (high, top + room))
        beyond = [(start, end) for start, end in sides if np.isfinite([start, end]).all() and end > start]
        title = f'<b>{name}</b><br><span style="font-size: 11px">{text}</span>'
        panels.append(PathPanel({name: values}, unit, unit, title, (bottom - room, top + room), beyond))
    gaps = (0.075, 0.26 / -(-len(names) // COLUMNS) + 0.04)
    figure = draw_panels(stations, panels, columns=COLUMNS, shared="", shaded=False, gaps=gaps)
    figure.axis("y", nticks=6)
    return figure


def draw_shares(stations: Stations, shares: Mapping[str, Array], names: Sequence[str]) -> Figure:
    """Draw joint rates as shares of their limits, shape (n, nq), by name ("velocity"); one chart per rate."""
    panels = []
    for title, share in shares.items():
        used = 100 * float(np.nanmax(share, initial=0))
        top = max(1.2 * used, 1e-6) if used < NEAR_LIMIT else max(110.0, 1.05 * used)
        series = {name: 100 * share[:, k] for k, name in enumerate(names)}
        beyond = [(100.0, top)] if top > 100 else []
        panels.append(PathPanel(series, f"{title}, % of limit", "%", "", (0.0, top), beyond))
    return draw_panels(stations, panels, shaded=False)


def chart_wrench(stations: Stations, wrench: Array, caption: str) -> Chart:
    """Draw the wrench on the tool at its tip, base axes, shape (n, 6) [N, N m]; the moment only if not zero."""
    force = {f"f{axis}": wrench[:, k] for k, axis in enumerate("xyz")}
    if not (np.abs(wrench[:, 3:]) > 1e-9).any():
        return chart_lines(stations, force, "N", "force on the tool, base axes", caption, 300)
    moment = {f"m{axis}": wrench[:, 3 + k] for k, axis in enumerate("xyz")}
    panels = [PathPanel(force, "force, N", "N"), PathPanel(moment, "moment, N m", "N m")]
    return Chart(draw_panels(stations, panels, shaded=False), caption, 440, along=True)
