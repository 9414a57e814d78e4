"""The page of `compplan convert`: the path that was read, by tool, and what was refused or assumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.reporting import figure as go
from compplan.reporting.page import (
    Chart,
    Column,
    KeyFigure,
    PageTable,
    Provenance,
    Row,
    Section,
    Summary,
    write_page,
)
from compplan.reporting.robot_scene import frame_scene
from compplan.reporting.style import CATEGORIES, format_number
from compplan.reporting.thinning import thin_path
from compplan.robot import Array
from compplan.toolpath.readers import CamFacts
from compplan.toolpath.toolpath import Toolpath

#: About how many points of a path are drawn, and the colour of rapid moves.
POINTS, RAPID = 8000, "#d62728"


def write_convert_page(toolpath: Toolpath, facts: CamFacts, file: Path) -> None:
    """Write the page of a CAM file that was read.

    Args:
        toolpath: The toolpath, part frame.
        facts: The facts about the file.
        file: The page.

    """
    tools, number = _number_tools(toolpath)
    name = Path(facts.file).name
    verdict = f"{name} is read: {facts.cutting_moves} cutting moves, {facts.cutting_length_mm:.1f}\u00a0mm."
    figures = [
        KeyFigure(f"{format_number(facts.cutting_length_mm)}\u00a0mm", f"cut in {facts.cutting_moves} moves"),
        KeyFigure(str(facts.rapid_moves), "rapid moves"),
        KeyFigure(str(len(facts.notes)), "assumptions", "unsure" if facts.notes else "good"),
    ]
    scene = Chart(_draw_path(toolpath, tools, number), "The path by tool; rapid moves are red.", height=480)
    todo = "Check box, tools and assumptions against the drawing, then plan: compplan plan JOB."
    opening = Summary(verdict, "unsure" if facts.notes else "good", figures, scene, todo)
    sections = [
        Section("Box of the cut", [_tabulate_box(facts)], open=True),
        Section("Tools", [_tabulate_tools(toolpath, tools, number)], open=True),
    ]
    if facts.notes:
        sections.append(Section("Assumed or read past", [_tabulate_notes(facts.notes)], open=True))
    origin = [("language", facts.kind), ("lines", str(facts.lines)), ("unit", facts.unit)]
    write_page(file, name, verdict, sections, kind="CAM file", opening=opening, provenance=Provenance(origin))


def write_refusal_page(camfile: Path, error: InputError, file: Path) -> None:
    """Write the page of a CAM file that is refused: the line, why, and what to do.

    Args:
        camfile: The CAM file.
        error: Why it is refused.
        file: The page.

    """
    place = f"line {error.where}" if error.where else camfile.name
    opening = Summary(f"{camfile.name} is refused.", "bad", next=f"{place}: {error.message}")
    section = Section("Refused", [PageTable([Column("where"), Column("what")], [[place, error.message]])], open=True)
    write_page(file, camfile.name, opening.verdict, [section], kind="CAM file", opening=opening)


def _number_tools(toolpath: Toolpath) -> tuple[list[str], Array]:
    """Return the names of the tools in order, and which of them makes the move to each waypoint. Shape (n,)."""
    names, number = ["tool not stated"], np.zeros(len(toolpath), int)
    for event in toolpath.events:
        if event.kind == "tool":
            name = f"T{event.value:g} {event.text}".strip()
            names += [name] if name not in names else []
            number[max(event.place + 1, 0) :] = names.index(name)
    return names, number


def _draw_path(toolpath: Toolpath, tools: list[str], number: Array) -> object:
    points, rapid = 1e3 * toolpath.position, toolpath.rapid
    shown = thin_path(toolpath.position, np.column_stack([rapid, number]).astype(float), POINTS)
    lines = [(name, CATEGORIES[k % len(CATEGORIES)], 5, ~rapid & (number == k)) for k, name in enumerate(tools)]
    figure = go.Figure()
    for name, colour, width, moves in [*lines, ("rapid", RAPID, 2, rapid.copy())]:
        moves[0] = False
        if not moves.any():
            continue
        mine = moves[shown]
        mine = mine | np.r_[mine[1:], False]  # a move begins at the waypoint before
        x, y, z = np.where(mine[:, None], points[shown], np.nan).T.tolist()
        figure.add_trace(go.Scatter3d(
            x=_leave_gaps(x), y=_leave_gaps(y), z=_leave_gaps(z), mode="lines", name=name,
            line={"color": colour, "width": width},
            hovertemplate="x %{x:.3f}, y %{y:.3f}, z %{z:.3f} mm<extra>" + name + "</extra>",
        ))  # fmt: skip
    legend = {"x": 0.01, "y": 0.01, "xanchor": "left", "yanchor": "bottom"}
    margin = {"l": 0, "r": 0, "t": 0, "b": 0}
    figure.update_layout(scene=frame_scene(points, size=1.75), margin=margin, showlegend=True, legend=legend)
    return figure


def _leave_gaps(values: list[float]) -> list[float | None]:
    return [None if np.isnan(value) else round(value, 4) for value in values]


def _tabulate_box(facts: CamFacts) -> PageTable:
    sides = () if facts.box_mm is None else zip("xyz", *facts.box_mm, strict=True)
    rows: list[Row] = [[axis, low, high, high - low] for axis, low, high in sides]
    return PageTable(
        [Column("axis"), Column("least", "mm", 6), Column("greatest", "mm", 6), Column("extent", "mm", 6)], rows
    )


def _tabulate_tools(toolpath: Toolpath, tools: list[str], number: Array) -> PageTable:
    steps, cut = np.r_[0.0, toolpath.steps], ~toolpath.rapid
    rows: list[Row] = []
    for k, name in enumerate(tools):
        own = cut & (number == k) & (steps > 0.0)
        if own.any():
            feeds = 6e4 * toolpath.feed[own]
            deepest = 1e3 * float(toolpath.position[own, 2].min())
            rows.append([name, 1e3 * float(steps[own].sum()), float(feeds.min()), float(feeds.max()), deepest])
    columns = [Column("tool"), Column("cut", "mm", 5), Column("least feed", "mm/min", 4),
               Column("greatest feed", "mm/min", 4), Column("least z", "mm", 5)]  # fmt: skip
    return PageTable(columns, rows)


def _tabulate_notes(notes: tuple[str, ...]) -> PageTable:
    return PageTable([Column("number"), Column("what")], [[k, note] for k, note in enumerate(notes, start=1)])
