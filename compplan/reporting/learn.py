"""Outputs of `compplan learn`: the updated robot folder, the corrected program and its plan, learn.json, the page."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.display import Curve, Curves
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_mm, format_mm_change, format_number
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.learning.part import LearnedPart
from compplan.learning.path_state import state_file, write_state
from compplan.learning.representable import residual_file
from compplan.process.learned_force import FILE as PROCESS
from compplan.process.learned_force import write_learned_force
from compplan.reporting.charts import draw_curves
from compplan.reporting.page import Cell, Chart, DataTable, Section, Summary, render_page
from compplan.reporting.plan_page import name_unknown, write_plan_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.writers.plan import choose_rows, write_joints, write_programs
from compplan.reporting.writers.recording import write_deviation
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Array

#: Displayed units of parameter changes, by the suffix of the key: factor from SI and unit.
SMALL = {
    "rad_per_Nm": (1e9, "nrad/(N m)"), "m_per_N": (1e9, "nm/N"), "rad_per_N": (1e9, "nrad/N"), "_rad": (1e6, "µrad"),
    "_m": (1e6, "µm"), "ratio": (1e2, "%"), "_N": (1.0, "N"), "_Nm": (1.0, "N m"), "_kg": (1.0, "kg"),
}  # fmt: skip


def write_learning(update: LearnedPart, folder: Path) -> dict[str, Any]:
    """Write the model update from a measured part and return the content of learn.json."""
    plan = update.after
    with replace_folder(folder, "learn") as part:
        _write_updated(update, part / "robot")
        write_programs(plan, part)
        write_joints(plan, part / "joints.csv", update.nominal)
        write_deviation(plan, part / "deviation.csv", choose_rows(plan))
        write_plan_page(plan, part / "plan.html")
        write_json(part / "plan.json", plan.to_dict(), indent=2)
        write_text(part / "report.html", _render(update))
        summary = {**summarise_update(update), "files": [*map(str, list_files(part)), "learn.json"]}
        write_json(part / "learn.json", summary, indent=2)
    return summary


def _write_updated(update: LearnedPart, folder: Path) -> None:
    """Write the updated robot folder, with the learned residuals of all paths."""
    deliver_robot_folder(update.updated, folder, update.robot)
    source = update.robot.folder
    if source is not None:
        for file in (*source.glob("learned_*"), *source.glob("registration.toml")):
            shutil.copyfile(file, folder / file.name)
    if update.force is not None:
        write_learned_force(update.force, update.job.process, folder, source)
    elif source is not None and (source / PROCESS).is_file():
        shutil.copyfile(source / PROCESS, folder / PROCESS)
    name, residual = residual_file(update.robot, update.job), update.residual
    if update.model_update.taken and residual is not None:
        columns: dict[str, object] = {"s_mm": residual.length * 1e3}
        columns |= {f"d{axis}_mm": residual.deviation[:, k] * 1e3 for k, axis in enumerate("xyz")}
        columns |= update.robot.joint_columns(residual.q)
        file_name = f"learned_{update.job.file.stem}.csv" if name is None else name.name
        write_table(folder / file_name, columns, decimals=10)
    if update.state is not None:
        write_state(update.state, folder / state_file(update.job))


def summarise_update(update: LearnedPart) -> dict[str, Any]:
    """Return the content of learn.json."""
    model_update, transfer = update.model_update, update.transfer
    steps = ("nothing", "force", "force_and_robot")
    left = {name: 1e3 * v if np.isfinite(v) else None for name, v in zip(steps, transfer.left, strict=True)}
    bands = {
        name: {"p95_max": widest * 1e3, "p95_max_in_measured_directions": float(seen.max()) * 1e3}
        for name, widest, seen in zip(
            ("band_before_mm", "band_after_mm"),
            (float(model_update.band_before.max()), update.widest_band),
            model_update.band_seen,
            strict=True,
        )
    }
    return {
        "schema": 1, "name": update.job.name or update.job.file.stem, "robot": update.robot.name,
        "step_taken": model_update.taken, "reason": model_update.reason, "status": update.after.status,
        "verdict": update.after.verdict.describe(), "points": len(update.measured),
        "points_left_out": update.measured.left_out, "measured_rms_mm": model_update.rms * 1e3,
        "held_out_rms_mm": model_update.held_out * 1e3 if np.isfinite(model_update.held_out) else None,
        "expected_rms_mm": model_update.expected * 1e3 if model_update.taken else None,
        "physics_rms_mm": _rms(model_update.physics) * 1e3, "force_rms_mm": _rms(model_update.pushed) * 1e3,
        "residual_rms_mm": _rms(model_update.residual) * 1e3, **bands,
        "told_other_paths": {
            "force": transfer.force and model_update.taken, "robot": transfer.robot and model_update.taken,
            "left_mm": left, "force_level": None if update.force is None else update.force.level,
        },
        "learned": [
            {"unknown": one.name, "value_SI": one.value, "width_before_SI": one.width, "in_robot_folder": one.kept}
            for one in update.learned
        ],
        "notes": list(update.notes), "made_by": describe_origin(),
    }  # fmt: skip


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _render(update: LearnedPart) -> str:
    """Return the page: measured deviation, its causes, decision on the update, 95 % band of the next part."""
    model_update, length = update.model_update, 1e3 * update.length
    before, after, seen = map(
        format_length, (model_update.band_before.max(), update.widest_band, model_update.band_seen[1].max())
    )
    expected = f"At the worst point of the path the band narrows from {before} to {after}"
    if not model_update.taken:
        expected = f"Nothing changes: at the worst point of the path the band stays at {before}"
    lines = (
        Curve("before", length, 1e3 * model_update.band_before, "before"),
        Curve("after", length, 1e3 * model_update.band_after, "after"),
        Curve(
            "after, in measured directions", length[model_update.gathered.row], 1e3 * model_update.band_seen[1], "seen"
        ),
    )
    figure = draw_curves(Curves("", "along the path [mm]", "95 % band [mm]", lines))
    bands = Chart(figure, "95 % band of the true tip. Dotted: only in the directions that were measured.", 320)
    sections = [Section("The next part", [bands], f"{expected}; in the directions that were measured it is {seen}.")]
    if model_update.taken:
        sections.insert(0, Section("What explains it", [_list_causes(update), _list_learned(update)]))
    return render_page(
        update.after.name, open_update(update), sections, kind=f"Measured part, {update.robot.name}",
        notes=update.notes[1:],
        provenance=describe_robot(update.robot, [("corrected plan", "plan.html")]),
    )  # fmt: skip


def open_update(update: LearnedPart) -> Summary:
    """Return the first screen: expected deviation of the next part."""
    model_update, measured, gathered = update.model_update, update.measured, update.model_update.gathered
    few, at = np.unique(np.linspace(0, len(measured) - 1, 1500).astype(int)), 1e3 * update.length[gathered.row]
    dots = 1e3 * np.linalg.norm(measured.seen[few], axis=1)
    lines = [Curve("measured", 1e3 * measured.length[few], dots, "before", "markers")]
    together = model_update.physics + model_update.pushed + model_update.residual
    parts = (("the robot", model_update.physics, 2), ("the force", model_update.pushed, 4),
             ("this path only", model_update.residual, 3), ("this part alone", model_update.alone, 5),
             ("what repeats", together, "after"))  # fmt: skip
    for name, part, role in parts if model_update.taken else ():
        seen = np.einsum("bij,bj->bi", gathered.counts, part[gathered.row])
        lines.append(Curve(name, at, 1e3 * np.linalg.norm(seen, axis=1), role))
    curves = Curves("", "along the path [mm]", "distance [mm]", tuple(lines))
    caption = "Dots: measured. Lines: the part explained by each cause. Distances in the measured directions, unsigned."
    if not model_update.taken:
        caption = "Measured distances from the path, unsigned."
    picture = Chart(draw_curves(curves), caption, 340)
    if not model_update.taken:
        reason = re.sub(r"[:,] the program stays as it is$", "", model_update.reason)
        verdict = f"The program stays as it is: {reason}."
        figures = [(format_mm(model_update.rms), "rms deviation of the measured part")]
        todo = "Measure more points or another part, then run: compplan learn JOB MEASURED --robot OUT/robot"
        return Summary(verdict, "unsure", figures, picture, todo)
    better, checked = model_update.expected < model_update.rms, model_update.held_out < model_update.rms
    ends = [float(model_update.band_before.max()), update.widest_band]
    change = format_mm_change(model_update.rms, model_update.expected)
    verdict = f"The corrected program should reduce the rms deviation of the next part: {change}."
    if not better and ends[1] < ends[0]:
        verdict = f"The corrected program narrows the 95 % band of the next part: {format_mm_change(*ends)}."
    elif not better:
        verdict = "The program is corrected, but the next part may deviate as much as this one."
    taken = [
        (format_mm_change(model_update.rms, model_update.held_out),
         "rms deviation of this part: as measured, and with the correction on stretches left out of its fit",
         "good" if checked else ""),
        (format_mm(model_update.expected),
         "rms deviation expected of the next part (also in directions not measured; with another force)"),
        (format_mm(update.widest_band), "95 % band of the next part, at the worst point of the path"),
    ]  # fmt: skip
    todo = "Cut the next part with the new program, measure it, then run: compplan learn JOB MEASURED --robot OUT/robot"
    return Summary(verdict, "good" if better or ends[1] < ends[0] else "unsure", taken, picture, todo)


def _list_causes(update: LearnedPart) -> DataTable:
    model_update = update.model_update
    rows = [
        [f"measured deviation, {len(update.measured)} points", 1e3 * model_update.rms],
        ["the robot's parameters", 1e3 * _rms(model_update.physics)],
        ["the difference from the predicted force", 1e3 * _rms(model_update.pushed)],
        ["this path only", 1e3 * _rms(model_update.residual)],
        ["this part alone: its force and clamping, which the next one does not repeat", 1e3 * _rms(model_update.alone)],
        ["remaining on stretches left out of the fit",
         Cell(1e3 * model_update.held_out if np.isfinite(model_update.held_out) else None, "strong")],
    ]  # fmt: skip
    caption = "Robot, force and path can cause the same deviation; this is the most probable division."
    return DataTable(["", "rms [mm]"], rows, caption)


def _list_learned(update: LearnedPart) -> DataTable:
    rows = []
    for one in update.learned:
        place = Cell("robot folder", "good") if one.kept else Cell("this path", "muted")
        moved, width = (_show_size(one.key, value) for value in (one.value, one.width))
        rows.append([name_unknown(one.name), moved, width, one.value / one.width if one.width > 0 else None, place])
    columns = ["parameter", "change", "known before, ±", "ratio [, 2]", "kept in"]
    caption = "The greatest changes and the standard deviation of each value before."
    return DataTable(columns, rows, caption)


def _show_size(key: str, value: float) -> str:
    """Format a value in the unit of its key; in SI without unit if the unit is unknown."""
    end = key.split("#")[0]
    factor, unit = next((SMALL[name] for name in SMALL if end.endswith(name)), (1.0, ""))
    return f"{format_number(factor * value)}\u00a0{unit}".rstrip()
