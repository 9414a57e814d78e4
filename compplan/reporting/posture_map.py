"""The map over an extra axis: how much of the deviation would remain by its position, along the path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from compplan.reporting import figure as go
from compplan.reporting.page import Block, Chart, Section
from compplan.reporting.style import BEFORE, SEQUENTIAL

if TYPE_CHECKING:
    from compplan.planning.plan import Plan


def extra_axis_sections(plan: Plan) -> list[Section]:
    """Build the section that shows the remaining deviation by extra axis; none where the robot has none."""
    start = plan.task.start
    if start is None or start.posture_choice is None or not start.posture_choice.map.held_grid.size:
        return []

    picture = start.posture_choice.map
    slides = bool(plan.robot.prismatic[0])
    scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
    figure = go.Figure()
    figure.add_heatmap(
        x=(1e3 * picture.length).round(2), y=scale * picture.held_grid, z=1e3 * picture.held_sensitivity.T,
        colorscale=[list(stop) for stop in SEQUENTIAL], colorbar={"title": {"text": "remaining, mm", "side": "top"}},
    )  # fmt: skip
    line = {"color": BEFORE, "width": 3}
    figure.add_scatter(x=1e3 * picture.length, y=scale * picture.held[:, 0], mode="lines", line=line, name="chosen")
    figure.update_xaxes(title_text="along the path, mm", showgrid=False)
    figure.update_yaxes(title_text=f"{plan.robot.joint_names[0]}, {unit}", showgrid=False)
    caption = "Colour: least deviation that would remain over all rotations. Line: positions chosen."
    blocks: list[Block] = [Chart(figure, caption, height=340)]
    return [Section("Extra axis", blocks, "Position of the extra axis against path length.")]
