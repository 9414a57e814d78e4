"""The path in 3D: where it lies in the cell, and how far the tool strays from it before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ShapeError
from compplan.reporting import figure as go
from compplan.reporting.along_path import FLOOR
from compplan.reporting.robot_scene import Shape, draw_robot, draw_shapes, frame_scene, locate_links, place_shapes
from compplan.reporting.style import AFTER, BEFORE, NEUTRAL, SEQUENTIAL, format_length, mark_decades
from compplan.reporting.thinning import thin_path
from compplan.robot import Array, Robot

#: About how many points of a path are drawn in a scene.
POINTS = 3500
#: The largest deviation is drawn about this long, as a share of the extent of the path.
DRAWN_SHARE = 0.09
#: What a move can be, with its colour and the width it is drawn in.
KINDS = (("cut with force", AFTER, 7), ("cut without force", BEFORE, 5), ("rapid", NEUTRAL, 2))
#: Decades of deviation that the colours span at most.
DECADES = 5.0


def draw_cell(
    robot: Robot, q: Array, path: Array, *, start: int = 0, around: Sequence[Shape] = (),
    kinds: NDArray[np.int_] | None = None,
) -> Any:  # fmt: skip
    """Draw the robot at one waypoint, and its path.

    Args:
        robot: The robot.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        path: Nominal path of the tool tip, base frame. Shape (n, 3). [m]
        start: The waypoint that the robot is drawn at.
        around: What else stands there: part, fixture, tool.
        kinds: What the tool does in the move to each waypoint, as numbers of `KINDS`; not told if left out. Shape (n,).
    """
    told = np.zeros(len(path), int) if kinds is None else kinds
    rows = thin_path(path, np.column_stack([path, 1e-3 * told]), POINTS)
    carried = locate_links(robot, q[start])[robot.base]
    points = 1e3 * (path[rows] @ carried[:3, :3].T + carried[:3, 3] if robot.ground else path[rows])
    own = place_shapes(robot, q[start])
    figure = go.Figure([*draw_robot(robot, q[start]), *draw_shapes(around)])
    for number, (name, colour, width) in enumerate(KINDS):
        if (told == number).any():
            mine = told[rows] == number
            mine |= np.r_[mine[1:], False]  # the move begins at the waypoint before
            broken = np.where(mine[:, None], points, np.nan)
            waypoint, line = rows[:, None].astype(float), {"color": colour, "width": width}
            figure.add_trace(_line(broken, line, name, hover=False, custom=waypoint))
    shapes = [*own, *around]
    figure.update_layout(
        scene=frame_scene(np.vstack([points, *(1e3 * shape.vertices for shape in shapes)])),
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        showlegend=kinds is not None,
        legend={"x": 0.01, "y": 0.01, "xanchor": "left", "yanchor": "bottom"},
    )
    return figure


def draw_deviation_paths(
    path: Array, before: Array, after: Array, *, names: tuple[str, str] = ("before", "after")
) -> Any:
    """Draw the path twice, with the deviation before and after as colour and, magnified, as shape.

    Args:
        path: Nominal path of the tool tip, base frame. Shape (n, 3). [m]
        before: Deviation (attained - nominal) without correction. Shape (n, 3). [m]
        after: Deviation with correction. Shape (n, 3). [m]
        names: What the two are called.

    Raises:
        ShapeError: If the three do not have one shape.
    """
    if not path.shape == before.shape == after.shape:
        shapes = [array.shape for array in (path, before, after)]
        raise ShapeError(f"path, before and after have shapes {shapes}, expected one and the same")
    sizes = [np.linalg.norm(deviation, axis=1) for deviation in (before, after)]
    rows = thin_path(path, np.column_stack([before, *sizes]), POINTS)
    factor = choose_magnification(path, before)
    titles = [f"{name}: largest {format_length(float(size.max()))}" for name, size in zip(names, sizes, strict=True)]
    specs = [[{"type": "scene"}, {"type": "scene"}]]
    figure = go.make_subplots(rows=1, cols=2, specs=specs, horizontal_spacing=0.01, subplot_titles=titles)
    nominal = 1e3 * path[rows]
    shown = [nominal]
    for number, (deviation, size) in enumerate(zip((before, after), sizes, strict=True), start=1):
        attained = nominal + 1e3 * factor * deviation[rows]
        shown.append(attained)
        grey = _line(nominal, {"color": NEUTRAL, "width": 2}, "nominal", hover=False)
        figure.add_trace(grey, row=1, col=number)
        level = np.log10(np.maximum(size[rows], FLOOR))
        line = {"color": level.astype(np.float32), "coloraxis": "coloraxis", "width": 6}
        custom = np.column_stack([rows, 1e3 * size[rows]])
        trace = _line(attained, line, names[number - 1], custom=custom)
        figure.add_trace(trace, row=1, col=number)
    scene = frame_scene(np.vstack(shown), margin=0.02, size=1.75)  # room for the label of z beside each
    top = float(np.log10(max(float(sizes[0].max()), float(sizes[1].max()), FLOOR)))
    bottom = max(float(np.log10(max(min(float(size.min()) for size in sizes), FLOOR))), top - DECADES)
    figure.update_layout(
        scene=scene,
        scene2=scene,
        coloraxis=_log_colours(min(bottom, top - 1.0), top),
        margin={"l": 0, "r": 0, "t": 30, "b": 0},
        showlegend=False,
    )
    return figure


def choose_magnification(path: Array, deviation: Array) -> float:
    """Choose 1, 2 or 5 times a power of ten so that the largest deviation is seen beside the path.

    Args:
        path: Shape (n, 3). [m]
        deviation: Shape (n, 3). [m]
    """
    largest = float(np.linalg.norm(deviation, axis=1).max(initial=0))
    extent = float(np.ptp(path, axis=0).max())
    if largest < 1e-12 or extent == 0:
        return 1.0
    wanted = max(DRAWN_SHARE * extent / largest, 1.0)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)) * power)


def describe_magnification(path: Array, deviation: Array) -> str:
    """Say by how much the drawn deviation is magnified."""
    factor = choose_magnification(path, deviation)
    return "to scale" if factor == 1 else f"magnified {factor:g} times"


def _line(points: Array, line: dict[str, Any], name: str, *, hover: bool = True, custom: Array | None = None) -> Any:

    x, y, z = points.astype(np.float32).T
    text = "waypoint %{customdata[0]:.0f}: %{customdata[1]:.4g} mm"
    if custom is None:
        text = "%{x:.1f}, %{y:.1f}, %{z:.1f} mm"
    else:
        custom = custom.astype(np.float32)
    trace = go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, name=name, customdata=custom)
    return trace.update(hovertemplate=text) if hover else trace.update(hoverinfo="skip")


def _log_colours(bottom: float, top: float) -> dict[str, Any]:
    """Colour by the logarithm of a length in m, with ticks at whole decades."""
    ticks, names = mark_decades(10**bottom, 10**top)
    return {
        "colorscale": [list(stop) for stop in SEQUENTIAL],
        "cmin": bottom,
        "cmax": top,
        "colorbar": {
            "title": {"text": "deviation", "side": "top"},
            "tickvals": [float(np.log10(tick)) for tick in ticks],
            "ticktext": names,
            "len": 0.8,
            "thickness": 12,
            "outlinewidth": 0,
        },
    }
