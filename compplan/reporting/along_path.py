"""Charts of quantities along a path: deviation, joints against limits, rates, corrections, wrench, feed.

Every chart has the path length in mm as its horizontal axis and shows waypoint and time when hovered. Long paths are
thinned for drawing; peaks stay.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.reporting import figure as go
from compplan.reporting.style import CATEGORIES, LIMIT, NEUTRAL, TOLERANCE, format_number, mark_decades, style_line
from compplan.reporting.thinning import thin_rows
from compplan.robot import Array

#: About how many rows of a chart are drawn.
ROWS = 1600
#: Fields that a path is divided into for marking waypoints.
BANDS = 240
#: Deviations below this are drawn at it, where the axis is logarithmic. [m]
FLOOR = 1e-8
#: A rate that uses less of its limit is drawn large, without the limit. [%]
NEAR_LIMIT = 40.0


@dataclass(frozen=True)
class Stations:
    """Where the waypoints of a path are, for horizontal axes and for hovering.

    Attributes:
        length: Path length up to each waypoint. Shape (n,). [m]
        time: Time of each waypoint. Shape (n,). [s]
        marked: Waypoints to mark, such as infeasible ones.
        shaded: Intervals of path length to shade, such as rapid moves. Shape (k, 2). [m]
    """

    length: Array
    time: Array
    marked: NDArray[np.int_]
    shaded: Array

    def hover(self, rows: NDArray[np.int_]) -> Array:
        """Waypoint and time of rows, as plotly's custom data. Shape (k, 2)."""
        return np.column_stack([rows, self.time[rows]]).astype(np.float32)


def place_stations(position: Array, time: Array, cut: NDArray[np.bool_], failures: Iterable[int] = ()) -> Stations:
    """Return where the waypoints of a path are; what is not in the cut is shaded.

    Args:
        position: Wanted tip. Shape (n, 3). [m]
        time: Time of each waypoint. Shape (n,). [s]
        cut: Waypoints that are judged. Shape (n,).
        failures: Waypoints to mark.
    """
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))]
    spans = find_spans(~cut)
    last = np.minimum(spans[:, 1] + 1, len(cut) - 1)  # the point of contact ends a rapid move, and counts
    shaded = length[np.column_stack([np.maximum(spans[:, 0] - 1, 0), last]).astype(int)].reshape(-1, 2)
    return Stations(length, time, np.array(sorted(failures), int), shaded)


def find_spans(flags: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Find the runs of true values: first and last row of each. Shape (k, 2)."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1])


def outline_below(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the outline of the area under a line with gaps: down to zero where it begins and where it ends."""
    spans = find_spans(np.isfinite(y))
    order = np.argsort(np.r_[np.arange(len(x)), spans[:, 0] - 0.5, spans[:, 1] + 0.5], kind="stable")
    along, high = np.r_[x, x[spans[:, 0]], x[spans[:, 1]]], np.r_[np.nan_to_num(y), np.zeros(spans.size)]
    return along[order].astype(np.float32), high[order].astype(np.float32)


def below(colour: str) -> dict[str, Any]:
    """Return how such an area is drawn: a fill goes on over the gaps of its line, so it has a trace of its own."""
    return {"fill": "tozeroy", "mode": "lines", "fillcolor": colour, "line": {"width": 0}, "hoverinfo": "skip"}


def draw_lines(
    stations: Stations,
    series: Mapping[str, Array],
    unit: str,
    *,
    title: str,
    colours: Sequence[str] = CATEGORIES,
    log: bool = False,
    limit: tuple[float, str] | None = None,
    zero: bool = False,
) -> Any:
    """Draw series along the path on one axis.

    Args:
        stations: Where the waypoints are.
        series: Values by name, already in the unit shown. Shape (n,) each.
        unit: The unit shown.
        title: Title of the vertical axis, without unit.
        colours: One a series.
        log: Whether the axis is logarithmic; the unit is then mm.
        limit: A level to mark by a dashed line, and what it is called.
        zero: Whether the axis starts at zero.
    """
    figure = go.Figure()
    add_lines(figure, stations, series, unit, colours=colours)
    figure.update_xaxes(title_text="along the path, mm", range=_length_range(stations))
    figure.update_yaxes(title_text=f"{title}, {unit}" if unit else title)
    if log:
        _use_decades(figure, list(series.values()), title)
    if zero:
        figure.update_yaxes(rangemode="tozero")
    if limit is not None:
        figure.add_hline(y=limit[0], line={"color": TOLERANCE, "width": 1.4, "dash": "dash"})
        figure.add_annotation(
            x=1, xref="paper", xanchor="right", y=np.log10(limit[0]) if log else limit[0], yanchor="bottom",
            text=limit[1], showarrow=False, font={"size": 11.5},
        )  # fmt: skip
    shade_spans(figure, stations)
    mark_waypoints(figure, stations)
    figure.update_layout(hovermode="x unified" if len(series) > 1 else "x")
    return figure


def add_lines(
    figure: Any,
    stations: Stations,
    series: Mapping[str, Array],
    unit: str,
    *,
    colours: Sequence[str] = CATEGORIES,
    row: int | None = None,
    col: int | None = None,
    legend: bool = True,
    limit: int = ROWS,
) -> None:
    """Add series along the path to a figure, thinned, with waypoint and time on hovering."""
    rows = thin_rows(list(series.values()), limit)
    far = np.flatnonzero(np.diff(stations.length) > 4.0 * np.ptp(stations.length) / limit)  # no line leans over these
    rows = np.union1d(rows, [far, far + 1])
    for number, (name, values) in enumerate(series.items()):
        figure.add_scatter(
            x=(1e3 * stations.length[rows]).astype(np.float32),
            y=values[rows].astype(np.float32),
            customdata=stations.hover(rows),
            name=name,
            mode="lines",
            line={**style_line(number, colours), "width": 1.6},
            hovertemplate=f"%{{y:.4g}} {unit} (waypoint %{{customdata[0]:.0f}}, %{{customdata[1]:.2f}} s)",
            showlegend=legend and len(series) > 1, row=row, col=col,
        )  # fmt: skip


def shade_spans(figure: Any, stations: Stations, *, row: int | None = None, col: int | None = None) -> None:
    """Shade the intervals that the stations name."""
    _add_bands(figure, 1e3 * stations.shaded, NEUTRAL, 0.14, row, col)


def mark_waypoints(figure: Any, stations: Stations, *, row: int | None = None, col: int | None = None) -> None:
    """Mark the waypoints that the stations name by red bands; what lies closer than a band is wide is one band."""
    if not len(stations.marked):
        return
    total = max(float(stations.length[-1]), 1e-12)
    flags = np.zeros(BANDS, bool)
    flags[np.minimum((stations.length[stations.marked] / total * BANDS).astype(int), BANDS - 1)] = True
    spans = (find_spans(flags) + np.array([0, 1])) * 1e3 * total / BANDS
    _add_bands(figure, spans, LIMIT, 0.28, row, col)


def _add_bands(figure: Any, spans: Array, colour: str, opacity: float, row: int | None, col: int | None) -> None:
    """Add vertical bands over the height of a chart, all at once; one by one takes plotly minutes."""
    x, y = "x", "y"
    if row is not None:
        number = figure.grid[row, col]
        x, y = f"x{number}", f"y{number}"
    style = {"type": "rect", "xref": x, "yref": f"{y} domain", "y0": 0, "y1": 1, "layer": "below"}
    paint = {"fillcolor": colour, "opacity": opacity, "line": {"width": 0}}
    bands = [{**style, **paint, "x0": float(start), "x1": float(end)} for start, end in spans]
    figure.update_layout(shapes=[*figure.layout.shapes, *bands])


def _limit_band(number: str, start: float, end: float) -> dict[str, Any]:
    """Return a horizontal band over the width of a small chart, from its number."""
    wide = {"type": "rect", "xref": f"x{number} domain", "x0": 0, "x1": 1, "fillcolor": LIMIT, "opacity": 0.16}
    return {**wide, "yref": f"y{number}", "y0": start, "y1": end, "line": {"width": 0}}


def draw_joints(
    stations: Stations, q: Array, lower: Array, upper: Array, names: Sequence[str], slides: NDArray[np.bool_]
) -> Any:
    """Draw each joint's position between its limits, one small chart a joint.

    Args:
        stations: Where the waypoints are.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        lower: Lower limits. Shape (nq,). [rad or m]
        upper: Upper limits. Shape (nq,). [rad or m]
        names: Names of the joints.
        slides: Which joints are prismatic. Shape (nq,).
    """
    scale = np.where(slides, 1e3, 180 / np.pi)
    units = ["mm" if slide else "deg" for slide in slides]
    low, high = lower * scale, upper * scale
    titles = [_joint_title(*item) for item in zip(names, (q * scale).T, low, high, units, strict=True)]
    columns = 3
    lines = -(-len(names) // columns)
    figure = go.make_subplots(
        rows=lines, cols=columns, subplot_titles=titles, horizontal_spacing=0.075, vertical_spacing=0.26 / lines + 0.04
    )
    layout: dict[str, Any] = {}
    bands: list[dict[str, Any]] = []
    for k, unit in enumerate(units):
        row, col = k // columns + 1, k % columns + 1
        add_lines(
            figure,
            stations,
            {names[k]: q[:, k] * scale[k]},
            unit,
            row=row,
            col=col,
            colours=CATEGORIES[:1],
            limit=ROWS // 2,
        )
        bottom, top = _joint_range(q[:, k] * scale[k], float(low[k]), float(high[k]))
        number, last = str(k + 1) if k else "", k >= len(names) - columns
        layout[f"yaxis{number}"] = {"range": [bottom, top], "title": {"text": unit if col == 1 else None}, "nticks": 6}
        under = {"title": {"text": "along the path, mm"}} if last else {}
        layout[f"xaxis{number}"] = {"range": _length_range(stations), "nticks": 5, **under}
        bands += [
            _limit_band(number, start, end)
            for start, end in ((bottom, float(low[k])), (float(high[k]), top))
            if np.isfinite(start) and np.isfinite(end) and end > start
        ]
    # all at once: piece by piece takes plotly a third of a second
    figure.update_layout(shapes=bands, showlegend=False, margin={"t": 52}, hovermode="x", **layout)
    if len(stations.marked):
        for k in range(len(names)):
            mark_waypoints(figure, stations, row=k // columns + 1, col=k % columns + 1)
    figure.update_annotations(font_size=12.5)
    return figure


def draw_shares(stations: Stations, shares: Mapping[str, tuple[Array, Sequence[str]]]) -> Any:
    """Draw rates as shares of their limits, one chart a rate, one line a joint.

    Args:
        stations: Where the waypoints are.
        shares: By rate ("velocity"): share of each joint's limit, shape (n, nq), 1 at the limit; and the joints' names.
    """
    figure = go.make_subplots(rows=len(shares), cols=1, shared_xaxes=True, vertical_spacing=0.08)
    for row, (title, (share, names)) in enumerate(shares.items(), start=1):
        series = {name: 100 * share[:, k] for k, name in enumerate(names)}
        add_lines(figure, stations, series, "%", row=row, col=1, legend=row == 1)
        used = 100 * float(np.nanmax(share, initial=0))
        top = max(1.2 * used, 1e-6) if used < NEAR_LIMIT else max(110.0, 1.05 * used)
        figure.update_yaxes(title_text=f"{title}, % of limit", range=[0, top], row=row, col=1)
        if top > 100:
            band = _limit_band(str(row) if row > 1 else "", 100.0, top)
            figure.update_layout(shapes=[*figure.layout.shapes, band])
        mark_waypoints(figure, stations, row=row, col=1)
    figure.update_xaxes(range=_length_range(stations))
    figure.update_xaxes(title_text="along the path, mm", row=len(shares), col=1)
    figure.update_layout(hovermode="x unified")
    return figure


def draw_wrench(stations: Stations, wrench: Array) -> Any:
    """Draw the force on the tool, and its moment where there is one.

    Args:
        stations: Where the waypoints are.
        wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
    """
    force = {f"f{axis}": wrench[:, k] for k, axis in enumerate("xyz")}
    if not (np.abs(wrench[:, 3:]) > 1e-9).any():
        return draw_lines(stations, force, "N", title="force on the tool, base axes")
    figure = go.make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    add_lines(figure, stations, force, "N", row=1, col=1)
    moment = {f"m{axis}": wrench[:, 3 + k] for k, axis in enumerate("xyz")}
    add_lines(figure, stations, moment, "N m", row=2, col=1, colours=CATEGORIES[:3])
    figure.update_yaxes(title_text="force, N", row=1, col=1)
    figure.update_yaxes(title_text="moment, N m", row=2, col=1)
    figure.update_xaxes(range=_length_range(stations))
    figure.update_xaxes(title_text="along the path, mm", row=2, col=1)
    figure.update_layout(hovermode="x unified")
    return figure


def _use_decades(figure: Any, lengths: Sequence[Array], title: str) -> None:
    """Make the vertical axis logarithmic over lengths in mm, its ticks named nm, um, mm."""
    known = np.concatenate([values[np.isfinite(values) & (values > 0)] for values in lengths])
    low, high = (float(known.min()), float(known.max())) if len(known) else (1e-6, 1.0)
    ticks, names = mark_decades(1e-3 * low, 1e-3 * high)
    figure.update_yaxes(type="log", title_text=title, tickvals=[1e3 * tick for tick in ticks], ticktext=names)


def _length_range(stations: Stations) -> list[float]:
    end = 1e3 * float(stations.length[-1])
    return [-0.005 * end, 1.005 * end]


def _joint_title(name: str, values: Array, low: float, high: float, unit: str) -> str:
    text = f"{format_number(float(values.min()))} to {format_number(float(values.max()))} {unit}"
    margin = float(min(values.min() - low, high - values.max()))
    text += f", {format_number(margin)} left" if np.isfinite(margin) else ", no limits"
    return f'<b>{name}</b><br><span style="font-size: 11px">{text}</span>'


def _joint_range(values: Array, low: float, high: float) -> tuple[float, float]:
    """Show the whole range of a joint with both limit bands, or the values where there are no limits."""
    bottom = min(low if np.isfinite(low) else np.inf, float(values.min()))
    top = max(high if np.isfinite(high) else -np.inf, float(values.max()))
    room = 0.07 * max(top - bottom, 1e-6)
    return bottom - room, top + room
