"""A picture of how a teach pendant counts tools: the arm with every axis at 0, and the maker's flange frame on it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.cli.doctor.pendant import look_at_pendant, stand_at_zero
from compplan.controllers.writers.counting import load_controller, locate_link
from compplan.controllers.writers.pendant import locate_pendant
from compplan.errors import InputError
from compplan.io.transaction import replace_file
from compplan.reporting.robot_picture import draw_robot_flat, project_points
from compplan.robot import Array, Robot

#: Axes of a frame: their names and colours.
AXES = (("x", "#c0392b"), ("y", "#27803b"), ("z", "#2456a6"))
#: Kinds of pictures, by ending.
KINDS = {".svg": "svg", ".png": "png", ".pdf": "pdf"}
#: Length of a drawn axis and half the width of the close-up, as shares of the arm's size.
AXIS, CLOSE = 0.16, 0.3


def save_pendant_picture(robot: Robot, file: str | Path) -> None:
    """Save a picture of the maker's flange frame on a robot: the whole arm, and the flange close to.

    Args:
        robot: The robot.
        file: The picture; its ending says its kind: .svg, .png or .pdf.

    Raises:
        InputError: If the ending is another one, or nothing says how the pendant counts.

    """
    from matplotlib.figure import Figure

    path = Path(file)
    if path.suffix.lower() not in KINDS:
        raise InputError(f"is no picture, expected a file that ends in {', '.join(KINDS)}", file=path)
    found = locate_pendant(robot)
    if found is None:
        message = f"nothing says how the pendant of {robot.name!r} counts tools"
        raise InputError(f"{message}; write [pendant] in its controller.toml")
    q = stand_at_zero(robot)
    flange = locate_link(robot, q[None], robot.flange)[0]
    world = load_controller(robot).world
    figure = Figure(figsize=(12.0, 6.6), dpi=100)
    whole, close = figure.add_axes((0.01, 0.12, 0.48, 0.78)), figure.add_axes((0.51, 0.12, 0.48, 0.78))
    for axes in (whole, close):
        draw_robot_flat(axes, robot, q)
        axes.set_aspect("equal")
        axes.set_axis_off()
    size = float(np.ptp(whole.dataLim.get_points(), axis=0).max())
    _draw_frame(whole, world, AXIS * size, "base")
    for axes, length, names in ((whole, 0.6 * AXIS * size, False), (close, AXIS * size, True)):
        _draw_frame(axes, flange @ found.pose, length, "tool 0" if names else "")
    if not np.allclose(found.pose, np.eye(4)):
        _draw_under(close, flange, found.pose, 0.6 * AXIS * size, robot.flange)
    _frame_views(whole, close, flange, size)
    _write_words(figure, robot)
    with replace_file(path) as part:
        figure.savefig(part, format=KINDS[path.suffix.lower()], facecolor="white")


def _draw_frame(axes: Any, pose: Array, length: float, name: str) -> None:
    """Draw a frame as three arrows with their names."""
    points = project_points(np.vstack([pose[:3, 3], pose[:3, 3] + length * pose[:3, :3].T]))
    origin, ends = points[0], points[1:]
    for (letter, colour), end in zip(AXES, ends, strict=True):
        axes.annotate("", xy=end, xytext=origin, zorder=5,
                      arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.4,
                                  "shrinkA": 0, "shrinkB": 0})  # fmt: skip
        place = origin + 1.13 * (end - origin)
        if np.linalg.norm(end - origin) < 0.15 * length:  # seen end on
            place = end + 0.1 * length
        axes.text(*place, letter, color=colour, ha="center", va="center", fontsize=13, zorder=6,
                  fontweight="bold")  # fmt: skip
    axes.update_datalim(points)
    if name:
        low = points[points[:, 1].argmin()]
        axes.text(low[0], low[1] - 0.22 * length, name, ha="center", va="top", fontsize=11, zorder=6,
                  bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1.5})  # fmt: skip


def _draw_under(axes: Any, flange: Array, pendant: Array, length: float, name: str) -> None:
    """Draw the URDF's flange frame in grey, where its axes do not lie under those of the pendant."""
    points = project_points(np.vstack([flange[:3, 3], flange[:3, 3] + length * flange[:3, :3].T]))
    for k, (letter, _) in enumerate(AXES):
        if np.max(pendant[k, :3]) > 0.99:
            continue
        axes.plot(*points[[0, k + 1]].T, color="#777777", linewidth=1.6, linestyle="--", zorder=4)
        place = points[0] + 1.18 * (points[k + 1] - points[0])
        axes.text(*place, f"{letter} of {name}", color="#555555", ha="center", va="center", fontsize=10, zorder=6)


def _frame_views(whole: Any, close: Any, flange: Array, size: float) -> None:
    """Set what each view shows: everything, and the surroundings of the flange."""
    whole.autoscale_view()
    whole.margins(0.08)
    centre = project_points(flange[None, :3, 3])[0]
    half = CLOSE * size
    close.set_xlim(centre[0] - half, centre[0] + half)
    close.set_ylim(centre[1] - half, centre[1] + half)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    whole.plot(*(centre + half * np.array(corners)).T, color="#888888", linewidth=0.8, linestyle=":")


def _write_words(figure: Any, robot: Robot) -> None:
    remarks = {remark.about: remark.sentence for remark in look_at_pendant(robot)}
    maker = load_controller(robot).name
    figure.text(0.5, 0.955, f"{robot.name} ({maker}): the frame that tool data of the teach pendant count from",
                ha="center", fontsize=14)  # fmt: skip
    figure.text(0.25, 0.06, remarks.get("jog check", ""), ha="center", fontsize=10, wrap=True)
    figure.text(0.75, 0.06, remarks.get("pendant", ""), ha="center", fontsize=10, wrap=True)
