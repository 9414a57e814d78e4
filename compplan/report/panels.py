"""Small charts side by side, all on the same axes: one a strategy, so that many of them stay apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from compplan.report.along_path import Stations, add_lines, shade_spans
from compplan.report.style import CATEGORIES, TOLERANCE, mark_decades
from compplan.robot import Array

#: Charts in a row, and the height of one of them. [px]
COLUMNS, HEIGHT = 3, 190
#: About how many rows of a small chart are drawn.
ROWS = 500


def draw_panels(
    stations: Stations, panels: Mapping[str, Mapping[str, Array]], *, tolerance: float, log: bool = False,
    top: float | None = None,
) -> Any:  # fmt: skip
    """Draw deviations along the path, one small chart a name, all with the same axes.

    Args:
        stations: Where the waypoints are.
        panels: By title of the chart: series by name, the same names in each. Shape (n,) each. [mm]
        tolerance: Level that is marked. [mm]
        log: Whether the vertical axes are logarithmic.
        top: Where the vertical axes end; the largest value if left out. [mm]
    """
    from plotly.subplots import make_subplots

    columns = min(COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    figure = make_subplots(
        rows=lines, cols=columns, subplot_titles=list(panels), shared_yaxes=True, horizontal_spacing=0.025,
        vertical_spacing=0.32 / lines if lines > 1 else 0.0,
    )  # fmt: skip
    for number, series in enumerate(panels.values()):
        row, col = number // columns + 1, number % columns + 1
        add_lines(
            figure, stations, series, "mm", row=row, col=col, colours=CATEGORIES, legend=number == 0, limit=ROWS
        )
        figure.add_hline(y=tolerance, line={"color": TOLERANCE, "width": 1.2, "dash": "dash"}, row=row, col=col)
        shade_spans(figure, stations, row=row, col=col)
    for trace in figure.data:
        trace.update(legendgroup=trace.name)
    _set_axes(figure, [values for series in panels.values() for values in series.values()], tolerance, log, top)
    figure.update_xaxes(nticks=5)
    for number in range(max(len(panels) - columns, 0), len(panels)):
        figure.update_xaxes(title_text="path length, mm", row=number // columns + 1, col=number % columns + 1)
    figure.update_annotations(font_size=12.5)
    legend = {"y": 1.0, "yref": "container", "yanchor": "top"}
    figure.update_layout(hovermode="x unified", margin={"t": 56}, legend=legend)
    return figure


def measure_panels(count: int) -> int:
    """Return the height of so many small charts [px]."""
    return 80 + HEIGHT * -(-count // COLUMNS)


def _set_axes(figure: Any, values: list[Array], tolerance: float, log: bool, top: float | None) -> None:
    together = np.concatenate([array[np.isfinite(array)] for array in values])
    most = max(float(together.max(initial=0.0)) if top is None else top, 1.3 * tolerance)
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
