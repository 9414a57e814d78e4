"""Small charts side by side, all on the same axes: one a strategy, so that many of them stay apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from compplan.reporting import figure as go
from compplan.reporting.along_path import Stations, add_lines, shade_spans
from compplan.reporting.style import CATEGORIES, TOLERANCE, mark_decades, style_line
from compplan.robot import Array

#: Charts in a row, and the height of one of them. [px]
COLUMNS, HEIGHT = 3, 190
#: About how many rows of a small chart are drawn.
ROWS = 500


def draw_panels(
    stations: Stations, panels: Mapping[str, Mapping[str, Array]], *, tolerance: float, log: bool = False,
) -> Any:  # fmt: skip
    """Draw deviations along the path, one small chart a name, all with the same axes.

    Args:
        stations: Where the waypoints are.
        panels: By title of the chart: series by name, the same names in each. Shape (n,) each. [mm]
        tolerance: Level that is marked. [mm]
        log: Whether the vertical axes are logarithmic.
    """
    columns = min(COLUMNS, len(panels))
    figure = _lay_out(list(panels))
    for number, series in enumerate(panels.values()):
        row, col = number // columns + 1, number % columns + 1
        add_lines(figure, stations, series, "mm", row=row, col=col, colours=CATEGORIES, legend=number == 0, limit=ROWS)
        figure.add_hline(y=tolerance, line={"color": TOLERANCE, "width": 1.2, "dash": "dash"}, row=row, col=col)
        shade_spans(figure, stations, row=row, col=col)
    for trace in figure.data:
        trace.update(legendgroup=trace.name)
    _set_axes(figure, [values for series in panels.values() for values in series.values()], tolerance, log)
    figure.update_xaxes(nticks=5)
    _finish(figure, len(panels), "along the path, mm")
    return figure


def draw_small_multiples(
    x: Array, panels: Mapping[str, Mapping[str, Array]], titles: tuple[str, str], *, spread: bool = False,
    log: bool = False,
) -> Any:  # fmt: skip
    """Draw curves, one small chart a name, all with the same axes.

    Args:
        x: Shape (k,).
        panels: By title of the chart: curves by name, the same names in each. Shape (k,) each, or (3, k) with `spread`.
        titles: Titles of the axes.
        spread: Whether each curve is value, lower and upper end, which are drawn as bars.
        log: Whether the horizontal axis is logarithmic.
    """
    columns = min(COLUMNS, len(panels))
    figure = _lay_out(list(panels))
    for number, curves in enumerate(panels.values()):
        for k, (name, values) in enumerate(curves.items()):
            value, low, high = values if spread else (values, values, values)
            bars = {"array": high - value, "arrayminus": value - low, "thickness": 1} if spread else None
            figure.add_scatter(
                x=x, y=value, name=name, legendgroup=name, showlegend=number == 0 and len(curves) > 1, error_y=bars,
                mode="lines+markers", marker={"size": 4}, line={**style_line(k), "width": 1.6},
                hovertemplate="%{y:.3g} at %{x:.4g}", row=number // columns + 1, col=number % columns + 1,
            )  # fmt: skip
    most = max(float(np.nanmax(values)) for curves in panels.values() for values in curves.values())
    figure.update_yaxes(range=[0.0, 1.06 * most])
    figure.update_yaxes(title_text=titles[1], col=1)
    figure.update_xaxes(nticks=5, type="log" if log else "linear")
    _finish(figure, len(panels), titles[0])
    return figure


def measure_panels(count: int) -> int:
    """Return the height of so many small charts [px]."""
    return 80 + HEIGHT * -(-count // COLUMNS)


def _lay_out(titles: list[str]) -> Any:

    columns = min(COLUMNS, len(titles))
    lines = -(-len(titles) // columns)
    return go.make_subplots(
        rows=lines, cols=columns, subplot_titles=titles, shared_yaxes=True, horizontal_spacing=0.025,
        vertical_spacing=0.32 / lines if lines > 1 else 0.0,
    )  # fmt: skip


def _finish(figure: Any, count: int, title: str) -> None:
    """Name the horizontal axis under the last chart of each column."""
    columns = min(COLUMNS, count)
    for number in range(max(count - columns, 0), count):
        figure.update_xaxes(title_text=title, row=number // columns + 1, col=number % columns + 1)
    figure.update_annotations(font_size=12.5)
    legend = {"y": 1.0, "yref": "container", "yanchor": "top"}
    figure.update_layout(hovermode="x unified", margin={"t": 56}, legend=legend)


def _set_axes(figure: Any, values: list[Array], tolerance: float, log: bool) -> None:
    together = np.concatenate([array[np.isfinite(array)] for array in values])
    most = max(float(together.max(initial=0.0)), 1.3 * tolerance)
    if not log:
        figure.update_yaxes(range=[0.0, 1.06 * most])
        figure.update_yaxes(title_text="deviation, mm", col=1)
        return
    least = max(float(together[together > 0].min(initial=most)), 1e-5)
    ticks, names = mark_decades(1e-3 * least, 1e-3 * most)
    figure.update_yaxes(
        type="log", range=[float(np.log10(0.8 * least)), float(np.log10(1.25 * most))],
        tickvals=[1e3 * tick for tick in ticks], ticktext=names,
    )  # fmt: skip
    figure.update_yaxes(title_text="deviation", col=1)
