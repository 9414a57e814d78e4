"""The page of a lesson: what was measured, what explains it, whether the step is taken, what to expect next."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from compplan.learning.part import LearnedPart
from compplan.reporting import figure as go
from compplan.reporting.effect_text import show_size
from compplan.reporting.page import Chart, Column, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.style import AFTER, BEFORE, CATEGORIES, format_length
from compplan.reporting.summaries import open_learning
from compplan.robot import Array

BANDS = "95 % band of the true tip. Dotted: in the directions that were measured alone."


def write_learn_page(teaching: LearnedPart, file: Path) -> None:
    """Write the page of a lesson.

    Args:
        teaching: The lesson with its plans.
        file: The HTML file.
    """
    lesson = teaching.lesson
    sections = [
        Section(
            "The part",
            [Chart(_draw_part(teaching), "Dots: measured. Lines: what explains them; distances, without sign.", 380)],
            "Distance of the cut part from the wanted path, in the directions that were measured.",
        ),
        Section("What explains it", [_explain(teaching), _learned(teaching)]),
        Section(
            "The next part",
            [Chart(_draw_bands(teaching), BANDS, 320)],
            _expect(teaching),
        ),
    ]
    warning = "" if lesson.taken else f"The program stays as it is: {lesson.reason}."
    write_page(
        file, teaching.after.name, _summarise(teaching), sections,
        kind=f"Measured part, {teaching.robot.name}",
        opening=open_learning(teaching, Chart(_draw_part(teaching), "Dots: measured. Lines: what explains it.", 340)),
        warning=warning, notes=teaching.notes[1:],
        provenance=describe_robot(teaching.robot, [("corrected plan", "plan.html")]),
    )  # fmt: skip


def _summarise(teaching: LearnedPart) -> str:
    lesson = teaching.lesson
    text = f"The part is off by {format_length(lesson.rms)} rms at {len(teaching.measured)} measured points."
    if not lesson.taken:
        return f"{text} The program stays as it is."
    return (
        f"{text} The corrected program should leave {format_length(lesson.expected)};"
        f" on stretches left out in turn it leaves {format_length(lesson.held_out)} of what was measured."
    )


def _expect(teaching: LearnedPart) -> str:
    lesson = teaching.lesson
    before, after = (format_length(float(band.max())) for band in (lesson.band_before, lesson.band_after))
    seen = format_length(float(lesson.band_seen[1].max()))
    told = f"in the directions that were measured it is {seen}"
    if not lesson.taken:
        return f"Nothing changes: the band stays at {before} at its widest; {told}."
    return f"The band narrows from {before} to {after} at its widest; {told}."


def _size(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _draw_part(teaching: LearnedPart) -> Any:

    lesson, figure = teaching.lesson, go.Figure()
    gathered, at = lesson.gathered, 1e3 * teaching.length
    few = np.unique(np.linspace(0, len(teaching.measured) - 1, 1500).astype(int))
    figure.add_scatter(
        x=1e3 * teaching.measured.length[few], y=1e3 * _size(teaching.measured.seen[few]), mode="markers",
        name="measured", marker={"size": 4, "color": BEFORE},
    )  # fmt: skip
    parts = (
        ("the robot", lesson.physics, CATEGORIES[2]), ("the force", lesson.pushed, CATEGORIES[4]),
        ("the path itself", lesson.residual, CATEGORIES[3]),
        ("all three together", lesson.physics + lesson.pushed + lesson.residual, AFTER),
    )  # fmt: skip
    for name, part, colour in parts:
        seen = np.einsum("bij,bj->bi", gathered.counts, part[gathered.row])
        figure.add_scatter(x=at[gathered.row], y=1e3 * _size(seen), mode="lines", name=name, line={"color": colour})
    figure.update_xaxes(title_text="along the path, mm")
    figure.update_yaxes(title_text="distance, mm", rangemode="tozero")
    return figure


def _draw_bands(teaching: LearnedPart) -> Any:

    lesson, figure = teaching.lesson, go.Figure()
    for name, band, colour in (("before", lesson.band_before, BEFORE), ("after", lesson.band_after, AFTER)):
        figure.add_scatter(x=1e3 * teaching.length, y=1e3 * band, mode="lines", name=name, line={"color": colour})
    line = {"color": AFTER, "dash": "dot"}
    at, seen = 1e3 * teaching.length[lesson.gathered.row], 1e3 * lesson.band_seen[1]
    figure.add_scatter(x=at, y=seen, mode="lines", name="after, in measured directions", line=line)
    figure.update_xaxes(title_text="along the path, mm")
    figure.update_yaxes(title_text="95 % band, mm", rangemode="tozero")
    return figure


def _explain(teaching: LearnedPart) -> PageTable:
    lesson = teaching.lesson
    rows: list[Row] = [["measured deviation", 1e3 * lesson.rms]]
    for name, part in (
        ("the robot's parameters", lesson.physics), ("the force, other than predicted", lesson.pushed),
        ("the path itself", lesson.residual),
    ):  # fmt: skip
        rows.append([name, 1e3 * float(np.sqrt(np.mean(_size(part) ** 2)))])
    held = 1e3 * lesson.held_out if np.isfinite(lesson.held_out) else None
    rows.append(["left on stretches that were not used", TableCell(held, "strong")])
    caption = "Robot, force and path can have the same effect; this is the likeliest division."
    return PageTable([Column(""), Column("rms", "mm")], rows, caption)


def _learned(teaching: LearnedPart) -> PageTable:
    rows: list[Row] = []
    for one in teaching.learned:
        place = TableCell("robot folder", "good") if one.kept else TableCell("this path", "muted")
        moved, width = (show_size(one.key, value) for value in (one.value, one.width))
        name = re.sub(r"_(rad|m)#\d+$", "", one.name).replace("_", " ")
        rows.append([name, moved, width, one.value / one.width if one.width > 0 else None, place])
    columns = [
        Column("parameter"), Column("change"), Column("known before, ±"), Column("ratio", "", 2), Column("kept in"),
    ]  # fmt: skip
    caption = "The greatest changes and the standard deviation of each value before."
    return PageTable(columns, rows, caption)
