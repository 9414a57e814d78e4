"""The picture of a result on its page: the same curves that `plot()` draws, as an interactive chart."""

from __future__ import annotations

from typing import Any

import numpy as np

from compplan.io.display import Curves, pick_style
from compplan.reporting import figure as go
from compplan.reporting.along_path import below, outline_below
from compplan.reporting.thinning import thin_rows

#: Points of a line that are drawn at most.
POINTS = 1500
#: Share of the greatest value that a linear axis shows below zero.
BELOW = 0.03


def _label(text: str) -> str:
    """Write a label as every chart of a page does: "deviation, mm"."""
    return text.replace(" [", ", ").rstrip("]")


def draw_curves(curves: Curves) -> Any:
    """Draw curves with plotly."""
    figure = go.Figure()
    for line in curves.lines:
        colour, dash = pick_style(line.role)
        rows = thin_rows([np.asarray(line.y, float)], POINTS)
        if line.role == "band":
            x, y = outline_below(np.asarray(line.x, float)[rows], np.asarray(line.y, float)[rows])
            figure.add_scatter(x=x, y=y, name=line.label, showlegend=False, **below("rgba(108, 96, 192, 0.13)"))
        figure.add_scatter(
            x=np.asarray(line.x)[rows], y=np.asarray(line.y)[rows], mode="lines", name=line.label, connectgaps=False,
            line={"color": colour, "dash": dash, "width": 1.8}, hovertemplate=f"%{{y:.3g}}<extra>{line.label}</extra>",
        )  # fmt: skip
    if curves.level is not None:
        colour, dash = pick_style("tolerance")
        x = np.concatenate([np.asarray(line.x, float) for line in curves.lines])
        ends = [float(np.nanmin(x)), float(np.nanmax(x))]
        figure.add_scatter(
            x=ends, y=[curves.level[0]] * 2, mode="lines", name=curves.level[1],
            line={"color": colour, "dash": dash, "width": 2.2},
            hovertemplate=f"%{{y:.3g}}<extra>{curves.level[1]}</extra>",
        )  # fmt: skip
    figure.update_xaxes(title_text=_label(curves.x))
    figure.update_yaxes(title_text=_label(curves.y), type="log" if curves.logarithmic else "linear")
    if not curves.logarithmic:  # a corrected curve at zero stays apart from the axis
        levels = [] if curves.level is None else [curves.level[0]]
        top = np.nanmax(np.concatenate([levels, *(np.asarray(line.y, float).ravel() for line in curves.lines)]))
        figure.update_yaxes(range=[-BELOW * top, 1.05 * top], zeroline=False)
    figure.update_layout(margin={"t": 46, "r": 12, "l": 60, "b": 46})
    return figure
