"""The map of postures as a picture, and the map over an extra axis.

Path length against rotation about the tool axis, coloured by the deviation that would remain; the interactive map is in
`compplan.report.posture_section`.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.posture.lattice import COLLISION, JOINT_LIMIT, NOT_WANTED, OUT_OF_REACH, REASONS, SINGULAR
from compplan.posture.summary import PostureMap
from compplan.report import figure as go
from compplan.report.page import Block, Chart, Section
from compplan.report.style import BEFORE, SEQUENTIAL, format_set_value
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.plan.plan import Plan

#: Colours of what cannot be used, or only at a cost (singular).
TONES = {
    OUT_OF_REACH: "#e3e5e8",
    JOINT_LIMIT: "#b9bec5",
    SINGULAR: "#b69bd0",
    COLLISION: "#6b3f3f",
    NOT_WANTED: "#d5d8c8",
}
CHOSEN = "#111418"


def draw_map_picture(picture: PostureMap) -> bytes:
    """Draw the map as a PNG."""
    from matplotlib.colors import LinearSegmentedColormap, ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    values = np.where(~np.isin(picture.reason, list(TONES)), 1e3 * picture.sensitivity, np.nan)
    values = np.where(values > 0, values, np.nan)
    one = len(picture.spin) == 1
    figure = Figure(figsize=(9.0, 2.8 if one else 4.2), dpi=130, layout="constrained")  # none of the user's own
    axes = figure.subplots()
    if one:
        axes.plot(1e3 * picture.length, values[:, 0], color=CHOSEN, linewidth=1.8)
        held = format_set_value(float(np.degrees(picture.spin[0])))
        top = 1.15 * float(np.nanmax(values, initial=0.0)) or None
        axes.set(xlabel="path length, mm", ylabel="remaining deviation, mm", ylim=(0.0, top),
                 title=f"rotation about the tool axis held at {held} deg")  # fmt: skip
        return _save(figure)
    length, spin = _edges(1e3 * picture.length), _edges(np.degrees(picture.spin))
    shades = LinearSegmentedColormap.from_list("sensitivity", list(SEQUENTIAL))
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, (1, 98)) if len(known) else (0.0, 1.0)
    mesh = axes.pcolormesh(length, spin, values.T, cmap=shades, vmin=low, vmax=high, rasterized=True)
    figure.colorbar(mesh, ax=axes, label="remaining deviation, mm")
    handles: list[Any] = []
    for reason, tone in TONES.items():
        mask = np.equal(picture.reason, reason)
        if mask.any():
            shown = np.where(mask, 1.0, np.nan)
            axes.pcolormesh(length, spin, shown.T, cmap=ListedColormap([tone]), rasterized=True)
            handles.append(Patch(color=tone, label=REASONS[reason]))
    along, turn = _wrapped(picture)
    handles += axes.plot(1e3 * along, np.degrees(turn), color=CHOSEN, linewidth=1.8, label="chosen")
    axes.set(xlabel="path length, mm", ylabel="rotation about the tool axis, deg", ylim=(spin[0], spin[-1]))
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.12), ncols=6, frameon=False, fontsize=8)
    return _save(figure)


def _save(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def extra_axis_sections(plan: Plan) -> list[Section]:
    """Build the section that shows the remaining deviation by extra axis; none where the robot has none."""
    start = plan.task.start
    if start is None or start.stance is None or not start.stance.map.held_grid.size:
        return []

    picture = start.stance.map
    slides = bool(plan.robot.prismatic[0])
    scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
    figure = go.Figure()
    figure.add_heatmap(
        x=(1e3 * picture.length).round(2), y=scale * picture.held_grid, z=1e3 * picture.held_sensitivity.T,
        colorscale=[list(stop) for stop in SEQUENTIAL], colorbar={"title": {"text": "remaining, mm", "side": "top"}},
    )  # fmt: skip
    line = {"color": BEFORE, "width": 3}
    figure.add_scatter(
        x=1e3 * picture.length, y=scale * picture.held[:, 0], mode="lines", line=line, name="chosen"
    )
    figure.update_xaxes(title_text="path length, mm", showgrid=False)
    figure.update_yaxes(title_text=f"{plan.robot.joint_names[0]}, {unit}", showgrid=False)
    caption = "Colour: least deviation that would remain over all rotations. Line: positions chosen."
    blocks: list[Block] = [Chart(figure, caption, height=340)]
    return [Section("Extra axis", blocks, "Position of the extra axis against path length.")]


def _edges(centres: Array) -> Array:
    """Return the borders of cells around their centres."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.r_[centres[0] - (middle[0] - centres[0]), middle, centres[-1] + (centres[-1] - middle[-1])]


def _wrapped(picture: PostureMap) -> tuple[Array, Array]:
    """Return the chosen line within the map's turn; NaN where it goes round."""
    low = float(np.radians(_edges(np.degrees(picture.spin))[0]))
    turn = (picture.chosen - low) % (2 * np.pi) + low
    jumps = np.flatnonzero(np.abs(np.diff(turn)) > np.pi) + 1
    return np.insert(picture.length, jumps, np.nan), np.insert(turn, jumps, np.nan)
