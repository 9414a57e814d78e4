"""The picture of `compplan place`: how much of the deviation would remain, by the place of the part."""

from __future__ import annotations

from typing import Any

import numpy as np

from compplan.planning.posture.place import PlaceResult, Ratings
from compplan.reporting import figure as go
from compplan.reporting.style import INK, PAPER, SEQUENTIAL


def draw_place_map(result: PlaceResult) -> Any:
    """Draw horizontal and vertical sections of the grid through the chosen place."""
    rating = next((r for r in result.ratings if r.turn == result.turn), result.ratings[0])
    known = 1e3 * rating.bound[np.isfinite(rating.bound)]
    low, high = np.percentile(known, (1, 97)) if len(known) else (0.0, 1.0)
    chosen = result.position
    cuts = ((0, 1, 2), (0, 2, 1))
    titles = [f"{'xyz'[through]} = {1e3 * chosen[through]:.0f} mm" for *_, through in cuts]
    figure = go.make_subplots(rows=1, cols=2, horizontal_spacing=0.14, subplot_titles=titles)
    bar = {"title": {"text": "mm", "side": "top"}, "thickness": 12, "outlinewidth": 0}
    for col, (across, up, through) in enumerate(cuts, start=1):
        values = 1e3 * _section(rating, through, float(chosen[through]))
        field = go.Heatmap(
            z=values.T.astype(np.float32), x=1e3 * rating.axes[across], y=1e3 * rating.axes[up],
            colorscale=[list(stop) for stop in SEQUENTIAL], zmin=float(low), zmax=float(max(high, low + 1e-9)),
            showscale=col == 2, colorbar=bar, hoverongaps=False,
            hovertemplate="%{x:.0f}, %{y:.0f} mm: %{z:.3g} mm<extra></extra>",
        )  # fmt: skip
        figure.add_trace(field, row=1, col=col)
        for name, place, symbol in (("job's place", result.here, "circle"), ("chosen", chosen, "star")):
            mark = {"symbol": symbol, "size": 13, "color": PAPER["light"],
                    "line": {"width": 2, "color": INK["light"]}}  # fmt: skip
            dot = go.Scatter(
                x=[1e3 * float(place[across])], y=[1e3 * float(place[up])], mode="markers", marker=mark, name=name,
                showlegend=col == 1, hoverinfo="name",
            )  # fmt: skip
            figure.add_trace(dot, row=1, col=col)
        figure.update_xaxes(title_text=f"{'xyz'[across]} of the part, mm", showgrid=False, row=1, col=col)
        figure.update_yaxes(title_text=f"{'xyz'[up]} of the part, mm", showgrid=False, row=1, col=col)
    figure.update_annotations(font_size=12.5)
    return figure.update_layout(legend={"y": 1.1}, margin={"t": 60, "b": 46})


def _section(rating: Ratings, axis: int, value: float) -> np.ndarray:
    """Cut the grid at the value nearest to the given one."""
    nearest = int(np.abs(rating.axes[axis] - value).argmin())
    return np.take(rating.bound, nearest, axis=axis)
