"""Pictures of deflection maps, for reports: one panel per quantity, the arm as a line drawing, limits of reach."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.io.palette import NEUTRAL
from compplan.reporting.charts import INK, SEQUENTIAL
from compplan.reporting.maps.survey import DeflectionMap
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

DPI = 150
#: Units of the components of a wrench.
WRENCH = {"fx": "N", "fy": "N", "fz": "N", "mx": "Nm", "my": "Nm", "mz": "Nm"}


@dataclass(frozen=True)
class Panel:
    """One map of a figure."""

    title: str  #: Title of the quantity.
    values: Array  #: Shape (b, a); NaN is left blank.
    unit: str  #: Unit of the values.
    high_is_good: bool = False  #: Whether high values are good, as of dexterity.


def deflection_panels(deflection: DeflectionMap, quality: Array | None = None) -> list[Panel]:
    """List the panels of a deflection map."""
    wrench = deflection.wrench
    panels = [Panel("Worst unit force", deflection.worst * 1e6, "µm/N")]
    if wrench.any():
        parts = [f"{n} = {w:g} {unit}" for (n, unit), w in zip(WRENCH.items(), wrench, strict=True) if w]
        panels.append(Panel(f"Given wrench ({', '.join(parts)})", deflection.under_wrench * 1e3, "mm"))
    if quality is not None and np.nanmax(quality, initial=0.0) > 1e-6:
        panels.append(Panel("Dexterity 1/κ (1 is best)", quality, "", high_is_good=True))
    return panels


def draw_deflection(robot: Robot, deflection: DeflectionMap, panels: list[Panel], title: str) -> bytes:
    """Draw panels of a deflection map under a title, as a PNG picture."""
    columns = {1: 1, 3: 3}.get(len(panels), 2)
    plane = deflection.plane
    aspect = min(max(float(np.ptp(plane.v) / np.ptp(plane.u)), 0.6), 1.8)
    width = 4.7 if aspect < 1.2 else 4.1
    figure, axes = _make_figure(-(-len(panels) // columns), columns, width=width, height=(width - 1.4) * aspect + 1.25)
    if title:
        figure.suptitle(title, fontsize=13, fontweight="bold", x=0.02, ha="left")
    flat = plane.name == "horizontal"
    for axis, panel in zip(axes.flat, panels, strict=False):
        _draw_field(axis, plane.u, plane.v, panel)
        _draw_arm(axis, robot, deflection)
        axis.set_aspect("equal")
        _crop(axis, deflection)
        axis.set_xlabel("x [m]" if flat else "distance from axis 1 [m]")
        axis.set_ylabel("y [m]" if flat else "z [m]")
    for axis in axes.flat[len(panels) :]:
        axis.axis("off")
    return _to_png(figure)


def draw_joint_map(
    joints: Mapping[str, Array], values: Array, zones: Mapping[str, Array], title: str, *, high_is_good: bool = True
) -> bytes:
    """Draw a quantity over two joints, with zones outlined, as a PNG picture.

    joints: positions of both by name, (a,) and (b,) [rad]; values: (b, a); zones: ranges of both joints, (2, 2) [rad].
    """
    from matplotlib.patches import Rectangle

    figure, axes = _make_figure(1, 1, width=5.6, height=4.6)
    axis = axes.flat[0]
    first, second = (np.degrees(positions) for positions in joints.values())
    _draw_field(axis, first, second, Panel(title, values, "", high_is_good))
    for name, zone in zones.items():
        low, high = np.degrees(zone.T)
        corner, size = (low[0], low[1]), (high[0] - low[0], high[1] - low[1])
        axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor=INK["light"], linewidth=1.6))
        place = (low[0] + 0.05 * size[0], high[1] - 0.08 * size[1])
        axis.text(*place, name, fontsize=10, fontweight="bold", va="top")
    axis.set(**{f"{side}label": f"{name} [deg]" for side, name in zip("xy", joints, strict=True)})
    return _to_png(figure)


def _make_figure(rows: int, columns: int, *, width: float, height: float) -> tuple[Any, NDArray[Any]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.tick_params(labelsize=9)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _draw_field(axis: Any, u: Array, v: Array, panel: Panel) -> None:
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.ticker import MaxNLocator

    shades = list(SEQUENTIAL)
    if panel.high_is_good:
        shades = [(1 - place, colour) for place, colour in reversed(shades)]
    colours = LinearSegmentedColormap.from_list("deflection", shades)
    known = panel.values[np.isfinite(panel.values)]
    axis.set_title(panel.title, loc="left", fontsize=10.5)
    if not known.size:
        axis.text(0.5, 0.5, "not reached", transform=axis.transAxes, ha="center", color=NEUTRAL)
        return
    low, high = float(known.min()), float(known.max())
    shown = axis.pcolormesh(u, v, panel.values, cmap=colours, vmin=low, vmax=max(high, low + 1e-12), shading="nearest")
    if high - low > 1e-9 * max(abs(high), 1e-30):
        levels = MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(low, high)
        contour = axis.contour(u, v, panel.values, levels=levels, colors="white", linewidths=0.7, alpha=0.85)
        axis.clabel(contour, fontsize=7, fmt="%g")
    reached = np.isfinite(panel.values).astype(float)
    if reached.min() == 0:
        axis.contour(u, v, reached, levels=[0.5], colors=INK["light"], linewidths=1.0)
    bar = axis.figure.colorbar(shown, ax=axis, shrink=0.8, pad=0.02)
    bar.outline.set_visible(False)
    bar.set_label(panel.unit, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    if not panel.high_is_good:
        row, column = np.unravel_index(np.nanargmax(panel.values), panel.values.shape)
        axis.plot(u[column], v[row], "x", color=INK["light"], markersize=6, markeredgewidth=1.4)
        axis.set_title(f"{panel.title}\nmax {high:.3g} {panel.unit}".rstrip(), loc="left", fontsize=10.5)


def _crop(axis: Any, deflection: DeflectionMap) -> None:
    """Limit the axes to the reached points and the base."""
    plane, reached = deflection.plane, deflection.reached
    sides = (plane.u, reached.any(axis=0), axis.set_xlim), (plane.v, reached.any(axis=1), axis.set_ylim)
    for values, hit, limit in sides if reached.any() else ():
        low, high = min(float(values[hit].min()), 0.0), max(float(values[hit].max()), 0.0)
        margin = 0.04 * (high - low)
        limit(low - margin, high + margin)


def _draw_arm(axis: Any, robot: Robot, deflection: DeflectionMap) -> None:
    """Draw the arm in the posture of the greatest deflection, in projection along the normal of the plane."""
    flat = np.where(deflection.reached, deflection.worst, -np.inf)
    q = deflection.q[np.unravel_index(int(flat.argmax()), flat.shape)]
    if not np.isfinite(q).all():
        return
    chain, plane = build_chain(robot), deflection.plane
    frames = locate_frames(chain, q[None])
    points = np.vstack([np.zeros((1, 3)), frames.origin[0, chain.joint_elements], frames.tcp_position])
    if plane.name == "horizontal":
        x, y = points[:, 0], points[:, 1]
    else:
        direction = np.array([np.cos(plane.level), np.sin(plane.level), 0.0])
        x, y = (points - plane.position[0, 0]) @ direction + plane.u[0], points[:, 2]
    axis.plot(x, y, "-", color=INK["light"], linewidth=2.4, alpha=0.55, solid_capstyle="round")
    axis.plot(x[:-1], y[:-1], "o", color="white", markeredgecolor=INK["light"], markersize=4, alpha=0.8)


def _to_png(figure: Any) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, facecolor="white")
    return stream.getvalue()
