"""Page of `compplan convert`: the path by tool, and the assumptions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.io.palette import CATEGORIES, NEUTRAL
from compplan.io.quantities import format_number
from compplan.reporting.charts import Figure
from compplan.reporting.page import Chart, DataTable, Provenance, Section, Summary, render_page
from compplan.reporting.scenes import add_moves, frame_scenes
from compplan.robot import Array
from compplan.toolpath.readers import CamFacts
from compplan.toolpath.toolpath import Toolpath

#: Approximate number of drawn points of a path.
POINTS = 8000


def render_toolpath(toolpath: Toolpath, facts: CamFacts) -> str:
    """Return the page of a CAM file; the toolpath is in the part frame."""
    tools, number = _number_tools(toolpath)
    name, tone = Path(facts.file).name, "unsure" if facts.notes else "good"
    verdict = f"{name} is read: {facts.cutting_moves} cutting moves, {facts.cutting_length_mm:.1f}\u00a0mm."
    figures = [
        (f"{format_number(facts.cutting_length_mm)}\u00a0mm", f"cut in {facts.cutting_moves} moves"),
        (str(facts.rapid_moves), "rapid moves"), (str(len(facts.notes)), "assumptions", tone),
    ]  # fmt: skip
    figure = Figure(scenes=True)
    styles = [(tool, CATEGORIES[k % len(CATEGORIES)], 5) for k, tool in enumerate(tools)]
    hover, kind = "x %{x:.3f}, y %{y:.3f}, z %{z:.3f} mm", np.where(toolpath.rapid, len(tools), number)
    add_moves(figure, toolpath.position, kind, [*styles, ("rapid", NEUTRAL, 2)], POINTS, hover)
    frame_scenes(figure, 1e3 * toolpath.position, size=1.75)
    figure.layout["showlegend"] = True
    scene = Chart(figure, "The path by tool; rapid moves are grey.", 480)
    sides = () if facts.box_mm is None else zip("xyz", *facts.box_mm, strict=True)
    box = [[axis, low, high, high - low] for axis, low, high in sides]
    heads = ["axis", *(f"{title} [mm, 6]" for title in ("least", "greatest", "extent"))]
    sections = [
        Section("Box of the cut", [DataTable(heads, box)], open=True),
        Section("Tools", [_list_tools(toolpath, tools, number)], open=True),
    ]
    if facts.notes:
        sections.append(Section("Assumed or read past", facts.notes, open=True))
    todo = "Check box, tools and assumptions against the drawing, then plan: compplan plan JOB."
    origin = Provenance([("language", facts.kind), ("lines", str(facts.lines)), ("unit", facts.unit)])
    return render_page(name, Summary(verdict, tone, figures, scene, todo), sections, kind="CAM file", provenance=origin)


def _number_tools(toolpath: Toolpath) -> tuple[list[str], Array]:
    """Return the names of the tools in order, and the index of the tool of the move to each waypoint. Shape (n,)."""
    names, number = ["tool not stated"], np.zeros(len(toolpath), int)
    for event in toolpath.events:
        if event.kind == "tool":
            name = f"T{event.value:g} {event.text}".strip()
            names += [name] if name not in names else []
            number[max(event.place + 1, 0) :] = names.index(name)
    return names, number


def _list_tools(toolpath: Toolpath, tools: list[str], number: Array) -> DataTable:
    steps, rows = np.r_[0.0, toolpath.steps], []
    for k, name in enumerate(tools):
        own = ~toolpath.rapid & (number == k) & (steps > 0.0)
        if own.any():
            feeds = 6e4 * toolpath.feed[own]
            deepest = 1e3 * float(toolpath.position[own, 2].min())
            rows.append([name, 1e3 * float(steps[own].sum()), float(feeds.min()), float(feeds.max()), deepest])
    columns = ["tool", "cut [mm, 5]", "least feed [mm/min, 4]", "greatest feed [mm/min, 4]", "least z [mm, 5]"]
    return DataTable(columns, rows)
