"""Charts of a gap: residual vectors, shares, traces of joint errors, histograms against the noise, factors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.reporting import figure as go
from compplan.reporting.path_scene import choose_magnification
from compplan.reporting.robot_scene import draw_robot, frame_scene, place_shapes
from compplan.reporting.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    NEUTRAL,
    SEQUENTIAL,
    format_length,
    format_percent,
    mark_decades,
)
from compplan.robot import Array, Robot

if TYPE_CHECKING:
    from compplan.diagnosis.results.shares import Share
    from compplan.diagnosis.results.traces import Trace

#: Residual vectors and dots that a chart draws at most.
VECTORS = 900
DOTS = 1500
BINS = 45


def thin_dots(size: Array, limit: int) -> NDArray[np.int_]:
    """Choose rows for a cloud of dots: evenly, and the largest ones. Shape (at most limit,)."""
    n = len(size)
    if n <= limit:
        return np.arange(n)
    largest = np.argsort(np.nan_to_num(size))[-limit // 10 :]
    return np.unique(np.concatenate([np.linspace(0, n - 1, limit - len(largest)).astype(int), largest]))


def draw_residuals(robot: Robot, q: Array, point: Array, before: Array, after: Array) -> Any:
    """Draw residual vectors in space, before and after, with the robot in a middle pose.

    Args:
        robot: The robot.
        q: Joint positions of the rows. Shape (n, nq). [rad or m]
        point: Measured points, base frame. Shape (n, 3). [m]
        before: Measured minus predicted by the nominal model. Shape (n, 3). [m]
        after: Measured minus predicted by the updated model. Shape (n, 3). [m]
    """
    sizes = [np.linalg.norm(side, axis=1) for side in (before, after)]
    rows = thin_dots(sizes[0], VECTORS)
    factor = choose_magnification(point, before)
    titles = [
        f"{name}: rms {format_length(float(np.sqrt(np.mean(size**2))))}"
        for name, size in zip(("nominal model", "updated model"), sizes, strict=True)
    ]
    specs = [[{"type": "scene"}, {"type": "scene"}]]
    figure = go.make_subplots(rows=1, cols=2, specs=specs, horizontal_spacing=0.01, subplot_titles=titles)
    middle = int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(1)))
    top = float(np.percentile(sizes[0], 99)) * 1e3
    for col, (side, size) in enumerate(zip((before, after), sizes, strict=True), start=1):
        for trace in draw_robot(robot, q[middle], opacity=0.35):
            figure.add_trace(trace, row=1, col=col)
        figure.add_trace(_vectors(1e3 * point[rows], 1e3 * side[rows], factor, 1e3 * size[rows], rows), row=1, col=col)
    ends = 1e3 * (point + factor * before)
    shapes = [1e3 * shape.vertices for shape in place_shapes(robot, q[middle])]
    scene = frame_scene(np.vstack([1e3 * point, ends, *shapes]))
    figure.update_layout(
        scene=scene,
        scene2=scene,
        showlegend=False,
        margin={"l": 0, "r": 0, "t": 30, "b": 0},
        coloraxis={
            "colorscale": [list(stop) for stop in SEQUENTIAL],
            "cmin": 0.0,
            "cmax": top,
            "colorbar": {
                "title": {"text": "deviation, mm", "side": "top"},
                "len": 0.8,
                "thickness": 12,
                "outlinewidth": 0,
            },
        },
    )
    return figure


def _vectors(point: Array, side: Array, factor: float, size: Array, rows: NDArray[np.int_]) -> Any:

    n = len(point)
    ends = np.full((n, 3, 3), np.nan)
    ends[:, 0], ends[:, 1] = point, point + factor * side
    x, y, z = ends.reshape(-1, 3).astype(np.float32).T
    colour = np.repeat(size, 3).astype(np.float32)
    custom = np.column_stack([np.repeat(rows, 3), colour]).astype(np.float32)
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines", customdata=custom,
        hovertemplate="row %{customdata[0]:.0f}: %{customdata[1]:.3g} mm",
        line={"color": colour, "coloraxis": "coloraxis", "width": 4}, name="residual",
    )  # fmt: skip


def draw_shares(shares: Mapping[str, Share], title: str) -> Any:
    """Draw shares of the gap as bars with their intervals.

    Args:
        shares: By name.
        title: What the bars divide by.
    """
    names = list(shares)
    values = [100 * shares[name].share for name in names]
    figure = go.Figure(
        go.Bar(
            y=names, x=values, orientation="h", marker_color=CATEGORIES[0],
            error_x={
                "type": "data", "thickness": 1.2, "width": 4, "color": NEUTRAL,
                "array": [100 * (shares[name].high - shares[name].share) for name in names],
                "arrayminus": [100 * (shares[name].share - shares[name].low) for name in names],
            },
            hovertemplate="%{x:.1f} %<extra></extra>",
        )
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(range=[0, 104], title_text=f"share of the gap by {title}, %")
    return figure


def draw_together(together: Mapping[str, Mapping[str, float]]) -> Any:
    """Draw how much each place carries by each effect, as a heat map.

    Args:
        together: By place and effect, from 0 to 1.
    """
    places = list(together)
    effects = list(dict.fromkeys(name for own in together.values() for name in own))
    effects = [name for name in effects if any(together[place].get(name, 0.0) >= 0.005 for place in places)]
    values = np.array([[100 * together[place].get(name, np.nan) for name in effects] for place in places])
    text = [["" if np.isnan(value) else f"{value:.0f}" for value in row] for row in values]
    figure = go.Figure(
        go.Heatmap(
            z=values, x=[name.replace("_", " ") for name in effects], y=places, text=text, texttemplate="%{text}",
            zmin=0, zmax=100, xgap=2, ygap=2, hoverongaps=False, showscale=False,
            colorscale=[[0, "rgba(140,150,160,0.10)"], [0.5, "#7fb0cf"], [1, "#2b6ca8"]],
            hovertemplate="%{y}, %{x}: %{z:.1f} %<extra></extra>",
        )
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed", showgrid=False)
    figure.update_xaxes(side="top", showgrid=False)
    return figure


def draw_traces(traces: Sequence[Trace]) -> Any:
    """Draw the error that each carrying joint would have to make, over what it depends on.

    Args:
        traces: One a small chart.
    """
    columns = min(len(traces), 3)
    lines = -(-len(traces) // columns)
    titles = [f"<b>{trace.place}</b>, {trace.effect.replace('_', ' ')}" for trace in traces]
    figure = go.make_subplots(
        rows=lines, cols=columns, subplot_titles=titles, horizontal_spacing=0.08, vertical_spacing=0.3 / lines
    )
    for number, trace in enumerate(traces):
        row, col = number // columns + 1, number % columns + 1
        rows = thin_dots(np.abs(trace.error), DOTS)
        driver, error = trace.driver[rows], trace.error[rows]
        if trace.two_sided:
            driver = driver + 0.25 * np.sin(997.0 * np.arange(len(driver)))
        figure.add_scatter(
            x=driver.astype(np.float32), y=error.astype(np.float32), mode="markers", showlegend=False,
            marker={"size": 3.5, "color": CATEGORIES[0], "opacity": 0.55},
            hovertemplate=f"%{{x:.4g}} {trace.driver_unit}: %{{y:.4g}} {trace.error_unit}<extra></extra>",
            row=row, col=col,
        )  # fmt: skip
        unit = f", {trace.driver_unit}" if trace.driver_unit else ""
        figure.update_xaxes(title_text=f"{trace.driver_name}{unit}", row=row, col=col)
        if trace.two_sided:
            figure.update_xaxes(tickvals=[-1, 0, 1], ticktext=["minus", "unknown", "plus"], row=row, col=col)
        low, high = np.percentile(trace.error, (0.5, 99.5))
        if trace.effect == "joint_offset":
            low, high = min(low, 0.0), max(high, 0.0)
        room = 0.25 * max(float(high - low), 1e-9)
        figure.update_yaxes(
            range=[float(low) - room, float(high) + room], title_text=trace.error_unit, row=row, col=col
        )
    figure.update_annotations(font_size=12.5)
    return figure


def draw_histogram(before: Array, after: Array, noise: float) -> Any:
    """Draw how often deviations of each size occur, before and after, and what noise alone would give.

    Args:
        before: Distances before. Shape (n,). [m]
        after: Distances after. Shape (n,). [m]
        noise: Noise floor, rms of the 3D distance. [m]
    """
    both = np.concatenate([before, after])
    positive = both[both > 0]
    low, high = (float(positive.min()), float(positive.max())) if len(positive) else (1e-6, 1e-3)
    low = max(low, 1e-3 * high)
    edges = np.geomspace(low, 1.05 * high, BINS + 1)
    middle = np.sqrt(edges[1:] * edges[:-1])
    figure = go.Figure()
    for name, values, colour in (("nominal model", before, BEFORE), ("updated model", after, AFTER)):
        share = 100 * np.histogram(np.maximum(values, low), edges)[0] / max(len(values), 1)
        figure.add_scatter(
            x=1e3 * middle, y=share, name=name, mode="lines", line={"color": colour, "width": 1.4, "shape": "hvh"},
            fill="tozeroy", hovertemplate="%{x:.3g} mm: %{y:.1f} %",
        )  # fmt: skip
    if noise > 0:
        share = 100 * np.diff(_noise_share(edges, noise))
        figure.add_scatter(
            x=1e3 * middle, y=share, name="noise alone", mode="lines",
            line={"color": NEUTRAL, "width": 1.6, "dash": "dash"}, hovertemplate="%{x:.3g} mm: %{y:.1f} %",
        )  # fmt: skip
    marks, names = mark_decades(low, high)
    figure.update_xaxes(type="log", title_text="deviation", tickvals=[1e3 * mark for mark in marks], ticktext=names)
    figure.update_yaxes(title_text="share of rows, %", rangemode="tozero")
    return figure


def _noise_share(distance: Array, rms: float) -> Array:
    """Share of distances below each distance where three axes scatter alike (Maxwell). Shape (n,)."""
    from scipy.special import erf

    scaled = distance * np.sqrt(3) / rms
    return np.asarray(erf(scaled / np.sqrt(2)) - np.sqrt(2 / np.pi) * scaled * np.exp(-(scaled**2) / 2))


def draw_factors(factors: Mapping[str, tuple[Array, str]], before: Array, after: Array) -> Any:
    """Draw the deviation along each factor, before and after, one small chart a factor.

    Args:
        factors: Values and unit by name of the factor. Shape (n,) each.
        before: Distances before. Shape (n,). [m]
        after: Distances after. Shape (n,). [m]
    """
    columns = 3
    lines = -(-len(factors) // columns)
    figure = go.make_subplots(rows=lines, cols=columns, horizontal_spacing=0.07, vertical_spacing=0.26 / lines)
    rows = thin_dots(before, DOTS)
    for number, (name, (values, unit)) in enumerate(factors.items()):
        row, col = number // columns + 1, number % columns + 1
        for label, side, colour in (("nominal model", before, BEFORE), ("updated model", after, AFTER)):
            figure.add_scatter(
                x=values[rows].astype(np.float32), y=(1e3 * side[rows]).astype(np.float32), mode="markers", name=label,
                marker={"size": 3, "color": colour, "opacity": 0.5}, showlegend=number == 0, legendgroup=label,
                hovertemplate=f"%{{x:.4g}} {unit}: %{{y:.3g}} mm<extra></extra>", row=row, col=col,
            )  # fmt: skip
        figure.update_xaxes(title_text=f"{name}, {unit}" if unit else name, row=row, col=col)
        figure.update_yaxes(rangemode="tozero", title_text="deviation, mm" if col == 1 else None, row=row, col=col)
    figure.update_layout(legend={"itemsizing": "constant"})
    return figure


def chart_candidates(candidates: Sequence[tuple[str, float]]) -> Any:
    """Draw candidates with their probability as bars, the most probable on top.

    Args:
        candidates: Name and probability.
    """
    names = [name for name, _ in candidates]
    values = [probability for _, probability in candidates]
    figure = go.Figure(
        go.Bar(
            y=names, x=values, orientation="h", text=[format_percent(value) for value in values], textposition="auto",
            marker_color=[AFTER if value >= 0.5 else NEUTRAL for value in values],
            hovertemplate="%{x:.3f}<extra></extra>",
        )
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(range=[0, 1.02], title_text="probability that it is present")
    return figure
