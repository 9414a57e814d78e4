"""What `compplan learn` writes: the updated robot folder, the corrected program and its plan, learn.json, the page."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.display import Curve, Curves
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_mm, format_mm_change
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.learning.part import LearnedPart
from compplan.learning.representable import Residual, residual_file
from compplan.process.learned_force import FILE as PROCESS
from compplan.process.learned_force import write_learned_force
from compplan.reporting import page
from compplan.reporting.charts import draw_curves
from compplan.reporting.effect_text import show_size
from compplan.reporting.plan_page import write_plan_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.writers.plan import choose_rows, summarise_plan, write_joints, write_programs
from compplan.reporting.writers.recording import write_deviation
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Array, Robot


def write_learning(teaching: LearnedPart, folder: Path) -> dict[str, Any]:
    """Write what was learned from a part and return what learn.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    with replace_folder(folder, "learn") as part:
        write_updated(teaching, part / "robot")
        write_programs(teaching.after, part)
        write_joints(teaching.after, part / "joints.csv", teaching.wanted)
        write_deviation(teaching.after, part / "deviation.csv", choose_rows(teaching.after))
        write_plan_page(teaching.after, part / "plan.html")
        write_json(part / "plan.json", summarise_plan(teaching.after), indent=2)
        write_text(part / "report.html", _render(teaching))
        summary = {**summarise_update(teaching), "files": [*map(str, list_files(part)), "learn.json"]}
        write_json(part / "learn.json", summary, indent=2)
    return summary


def write_updated(teaching: LearnedPart, folder: Path) -> None:
    """Write the robot folder as it is known now, with what every path has learned."""
    deliver_robot_folder(teaching.taught, folder, teaching.robot)
    source = teaching.robot.folder
    if source is not None:
        for file in (*source.glob("learned_*.csv"), *source.glob("registration.toml")):
            shutil.copyfile(file, folder / file.name)
    if teaching.force is not None:
        write_learned_force(teaching.force, teaching.job.process, folder, source)
    elif source is not None and (source / PROCESS).is_file():
        shutil.copyfile(source / PROCESS, folder / PROCESS)
    name = residual_file(teaching.robot, teaching.job)
    file_name = f"learned_{teaching.job.file.stem}.csv" if name is None else name.name
    if teaching.lesson.taken:
        write_residual(teaching.residual, teaching.robot, folder / file_name)


def write_residual(residual: Residual, robot: Robot, file: Path) -> None:
    """Write what a path has learned, with the posture in which it has."""
    columns: dict[str, object] = {"s_mm": residual.length * 1e3}
    columns |= {f"d{axis}_mm": residual.deviation[:, k] * 1e3 for k, axis in enumerate("xyz")}
    columns["sigma_mm"] = residual.spread * 1e3
    columns |= robot.joint_columns(residual.q)
    for number, own in enumerate(np.moveaxis(residual.open, 2, 0), 1):
        columns |= {f"u{number}{axis}_mm": own[:, k] * 1e3 for k, axis in enumerate("xyz")}
    write_table(file, columns, decimals=10)


def summarise_update(teaching: LearnedPart) -> dict[str, Any]:
    """Return the content of learn.json."""
    lesson, travel = teaching.lesson, teaching.travel
    steps = ("nothing", "force", "force_and_robot")
    left = {name: 1e3 * v if np.isfinite(v) else None for name, v in zip(steps, travel.left, strict=True)}
    bands = {
        name: {"p95_max": float(band.max()) * 1e3, "p95_max_in_measured_directions": float(seen.max()) * 1e3}
        for name, band, seen in zip(
            ("band_before_mm", "band_after_mm"), (lesson.band_before, lesson.band_after), lesson.band_seen, strict=True
        )
    }
    return {
        "schema": 1, "name": teaching.job.name or teaching.job.file.stem, "robot": teaching.robot.name,
        "step_taken": lesson.taken, "reason": lesson.reason, "status": teaching.after.status,
        "verdict": teaching.after.verdict.describe(), "points": len(teaching.measured),
        "points_left_out": teaching.measured.left_out, "measured_rms_mm": lesson.rms * 1e3,
        "held_out_rms_mm": lesson.held_out * 1e3 if np.isfinite(lesson.held_out) else None,
        "expected_rms_mm": lesson.expected * 1e3 if lesson.taken else None,
        "physics_rms_mm": _rms(lesson.physics) * 1e3, "force_rms_mm": _rms(lesson.pushed) * 1e3,
        "residual_rms_mm": _rms(lesson.residual) * 1e3, **bands,
        "told_other_paths": {
            "force": travel.force and lesson.taken, "robot": travel.robot and lesson.taken, "left_mm": left,
            "force_level": None if teaching.force is None else teaching.force.level,
        },
        "learned": [
            {"unknown": one.name, "value_SI": one.value, "width_before_SI": one.width, "in_robot_folder": one.kept}
            for one in teaching.learned
        ],
        "notes": list(teaching.notes), "made_by": describe_origin(),
    }  # fmt: skip


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _render(teaching: LearnedPart) -> str:
    """Return the page: what was measured, what explains it, whether the step is taken, what to expect next."""
    lesson = teaching.lesson
    text = f"The part is off by {format_length(lesson.rms)} rms at {len(teaching.measured)} measured points."
    before, after, seen = (
        format_length(float(band.max())) for band in (lesson.band_before, lesson.band_after, lesson.band_seen[1])
    )
    told = f"in the directions that were measured it is {seen}"
    lede, expected = f"{text} The program stays as it is.", f"Nothing changes: the band stays at {before} at its widest"
    warning = f"The program stays as it is: {lesson.reason}."
    if lesson.taken:
        lede = (
            f"{text} The corrected program should leave {format_length(lesson.expected)};"
            f" on stretches left out in turn it leaves {format_length(lesson.held_out)} of what was measured."
        )
        expected, warning = f"The band narrows from {before} to {after} at its widest", ""
    bands = "95 % band of the true tip. Dotted: in the directions that were measured alone."
    sections = [
        page.Section("What explains it", [_list_causes(teaching), _list_learned(teaching)]),
        page.Section("The next part", [page.Chart(_draw_bands(teaching), bands, 320)], f"{expected}; {told}."),
    ]
    return page.render_page(
        teaching.after.name, lede, sections, kind=f"Measured part, {teaching.robot.name}", opening=_open(teaching),
        warning=warning, notes=teaching.notes[1:],
        provenance=describe_robot(teaching.robot, [("corrected plan", "plan.html")]),
    )  # fmt: skip


def _open(teaching: LearnedPart) -> page.Summary:
    """Return the first screen: what the next part may be expected to be."""
    lesson = teaching.lesson
    caption = "Dots: measured. Lines: what explains it; distances without sign, in the directions that were measured."
    picture = page.Chart(_draw_part(teaching), caption, 340)
    if not lesson.taken:
        verdict = "The program stays as it is: the measured part does not improve the next one."
        figures = [page.KeyFigure(format_mm(lesson.rms), "rms deviation of the measured part")]
        todo = "Measure more points, or another part, and learn again."
        return page.Summary(verdict, "unsure", figures, picture, todo)
    change = format_mm_change(lesson.rms, lesson.expected)
    figures = [
        page.KeyFigure(change, "rms deviation, measured on this part and expected of the next", "good"),
        page.KeyFigure(format_mm(lesson.held_out), "checked: left on stretches not used for the correction"),
        page.KeyFigure(format_mm(float(lesson.band_after.max())), "95 % band of the next part at its widest"),
    ]
    todo = "Cut the next part with the new program, measure it, and learn again with --robot OUT/robot."
    return page.Summary("The new program should make the next part better.", "good", figures, picture, todo)


def _draw_part(teaching: LearnedPart) -> Any:
    lesson, measured, gathered = teaching.lesson, teaching.measured, teaching.lesson.gathered
    few, at = np.unique(np.linspace(0, len(measured) - 1, 1500).astype(int)), 1e3 * teaching.length[gathered.row]
    dots = 1e3 * np.linalg.norm(measured.seen[few], axis=1)
    lines = [Curve("measured", 1e3 * measured.length[few], dots, "before", "markers")]
    together = lesson.physics + lesson.pushed + lesson.residual
    for name, part, role in (
        ("the robot", lesson.physics, 2), ("the force", lesson.pushed, 4), ("the path itself", lesson.residual, 3),
        ("all three together", together, "after"),
    ):  # fmt: skip
        seen = np.einsum("bij,bj->bi", gathered.counts, part[gathered.row])
        lines.append(Curve(name, at, 1e3 * np.linalg.norm(seen, axis=1), role))
    return draw_curves(Curves("", "along the path [mm]", "distance [mm]", tuple(lines)))


def _draw_bands(teaching: LearnedPart) -> Any:
    lesson, length = teaching.lesson, 1e3 * teaching.length
    lines = (
        Curve("before", length, 1e3 * lesson.band_before, "before"),
        Curve("after", length, 1e3 * lesson.band_after, "after"),
        Curve("after, in measured directions", length[lesson.gathered.row], 1e3 * lesson.band_seen[1], "seen"),
    )
    return draw_curves(Curves("", "along the path [mm]", "95 % band [mm]", lines))


def _list_causes(teaching: LearnedPart) -> page.DataTable:
    lesson = teaching.lesson
    held = 1e3 * lesson.held_out if np.isfinite(lesson.held_out) else None
    rows: list[page.Row] = [
        ["measured deviation", 1e3 * lesson.rms],
        ["the robot's parameters", 1e3 * _rms(lesson.physics)],
        ["the force, other than predicted", 1e3 * _rms(lesson.pushed)],
        ["the path itself", 1e3 * _rms(lesson.residual)],
        ["left on stretches that were not used", page.Cell(held, "strong")],
    ]
    caption = "Robot, force and path can have the same effect; this is the likeliest division."
    return page.DataTable(["", "rms [mm]"], rows, caption)


def _list_learned(teaching: LearnedPart) -> page.DataTable:
    rows: list[page.Row] = []
    for one in teaching.learned:
        place = page.Cell("robot folder", "good") if one.kept else page.Cell("this path", "muted")
        moved, width = (show_size(one.key, value) for value in (one.value, one.width))
        name = re.sub(r"_(rad|m)#\d+$", "", one.name).replace("_", " ")
        rows.append([name, moved, width, one.value / one.width if one.width > 0 else None, place])
    columns = ["parameter", "change", "known before, ±", "ratio [, 2]", "kept in"]
    caption = "The greatest changes and the standard deviation of each value before."
    return page.DataTable(columns, rows, caption)
