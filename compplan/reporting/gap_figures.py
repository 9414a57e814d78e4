"""Charts of a gap: residual vectors, shares, traces of joint errors, histograms against the noise, factors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    from compplan.diagnosis.results.where import Trace

#: Residual vectors and dots that a chart draws at most.
VECTORS, DOTS = 900, 1500
BINS = 45
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
    """Draw shares of the gap, by what they are divided by, as bars with their intervals."""
    value, low, high = 100 * np.array([(s.share, s.low, s.high) for s in shares.values()]).reshape(-1, 3).T
    bars = Bars(value, CATEGORIES[0], low, high)
    figure = draw_bars(list(shares), {"": bars}, f"share of the gap by {title}, %", hover="%{x:.1f} %")
    figure.axis("x", range=[0, 104])
    return figure


def draw_traces(traces: Sequence[Trace]) -> Figure:
    """Draw the error that each carrying joint would have to make, over what it depends on, one small chart a trace."""
    titles = [f"<b>{trace.place}</b>, {trace.effect.replace('_', ' ')}" for trace in traces]
    figure = Figure(titles, 3, gaps=(0.08, 0.3 / -(-len(traces) // 3)))
    for panel, trace in enumerate(traces):
        rows = thin_rows([np.abs(trace.error)], DOTS)
        driver = trace.driver[rows]
        if trace.two_sided:
            driver = driver + 0.25 * np.sin(997.0 * np.arange(len(driver)))
            figure.axis("x", panel, tickvals=[-1, 0, 1], ticktext=["minus", "unknown", "plus"])
        figure.line(
            driver, trace.error[rows], "", panel, mode="markers", showlegend=False,
            marker={"size": 3.5, "color": CATEGORIES[0], "opacity": 0.55},
            hovertemplate=f"%{{x:.4g}} {trace.driver_unit}: %{{y:.4g}} {trace.error_unit}<extra></extra>",
        )  # fmt: skip
        unit = f", {trace.driver_unit}" if trace.driver_unit else ""
        low, high = (float(value) for value in np.percentile(trace.error, (0.5, 99.5)))
        if trace.effect == "joint_offset":
            low, high = min(low, 0.0), max(high, 0.0)
        room = 0.25 * max(high - low, 1e-9)
        figure.axis("x", panel, title=f"{trace.driver_name}{unit}")
        figure.axis("y", panel, title=trace.error_unit, range=[low - room, high + room])
    return figure
