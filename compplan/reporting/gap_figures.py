"""Charts of a gap: residual vectors and shares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from compplan.io.palette import AFTER, BEFORE, CATEGORIES
from compplan.io.quantities import format_length
from compplan.reporting.charts import Bars, Figure, draw_bars, thin_rows
from compplan.reporting.scenes import (
    add_path,
    add_shapes,
    choose_magnification,
    colour_axis,
    frame_scenes,
    place_shapes,
)
from compplan.robot import Array, Robot

if TYPE_CHECKING:
    from compplan.diagnosis.results.shares import Share

#: Greatest number of residual vectors in a chart.
VECTORS = 900
#: The two models, with their colours.
MODELS = (("nominal model", BEFORE), ("updated model", AFTER))


def draw_residuals(robot: Robot, q: Array, point: Array, before: Array, after: Array) -> Figure:
    """Draw residual vectors in space, before and after, with the robot in a middle pose.

    q: joints of the rows, shape (n, nq) [rad or m]; point: measured points, base frame; before, after: measured minus
    predicted by the nominal and the updated model, shape (n, 3) [m].
    """
    sizes = [np.linalg.norm(side, axis=1) for side in (before, after)]
    rows = thin_rows([sizes[0]], VECTORS)
    factor = choose_magnification(point, before)
    titles = [
        f"{name}: rms {format_length(float(np.sqrt(np.mean(size**2))))}"
        for (name, _), size in zip(MODELS, sizes, strict=True)
    ]
    figure = Figure(titles, 2, gaps=(0.01, 0.0), scenes=True)
    shapes = place_shapes(robot, q[int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(1)))])
    for panel, (side, size) in enumerate(zip((before, after), sizes, strict=True)):
        add_shapes(figure, shapes, robot.name, 0.35, panel)
        ends = np.full((len(rows), 3, 3), np.nan)
        ends[:, 0], ends[:, 1] = 1e3 * point[rows], 1e3 * (point[rows] + factor * side[rows])
        colour = np.repeat(1e3 * size[rows], 3)
        add_path(
            figure, ends.reshape(-1, 3), "residual", colour, 4, panel=panel, coloraxis="coloraxis",
            custom=np.column_stack([np.repeat(rows, 3), colour]),
            hover="row %{customdata[0]:.0f}: %{customdata[1]:.3g} mm",
        )  # fmt: skip
    corners = [1e3 * shape.vertices for shape in shapes]
    frame_scenes(figure, np.vstack([1e3 * point, 1e3 * (point + factor * before), *corners]), top=30)
    top = float(np.percentile(sizes[0], 99)) * 1e3
    figure.layout |= {"showlegend": False, "coloraxis": colour_axis("deviation, mm", 0.0, top)}
    return figure


def draw_gap_shares(shares: Mapping[str, Share], title: str) -> Figure:
    """Draw shares of the gap as bars with their intervals; `title`: criterion of the division."""
    value, low, high = 100 * np.array([(s.share, s.low, s.high) for s in shares.values()]).reshape(-1, 3).T
    bars = Bars(value, CATEGORIES[0], low, high)
    figure = draw_bars(list(shares), {"": bars}, f"share of the gap by {title}, %", hover="%{x:.1f} %")
    figure.axis("x", range=[0, 104])
    return figure
