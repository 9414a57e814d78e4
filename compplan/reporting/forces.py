"""What `compplan forces` writes: forces.json, forces.csv, the page, and fitted coefficients or a measured level."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import ValidationError

from compplan.errors import InputError
from compplan.io.notes import list_stops
from compplan.io.palette import AFTER, BEFORE, CATEGORIES, NEUTRAL
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_number
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import replace_folder
from compplan.job.force_prediction import ForcePrediction
from compplan.process.engagement import Engagement
from compplan.process.fit import ForceFit
from compplan.process.force_law import Process
from compplan.process.force_models import name_force_model
from compplan.process.learned_force import (
    SCATTER,
    LearnedForce,
    LearnedPartTable,
    add_part,
    find_axes,
    read_learned_force,
    write_learned_force,
)
from compplan.process.materials import CoefficientTable
from compplan.reporting import page
from compplan.reporting.along_path import Stations, draw_lines, draw_wrench, find_spans
from compplan.reporting.charts import Figure
from compplan.reporting.scenes import add_path, colour_axis, frame_scenes
from compplan.reporting.thinning import thin_path
from compplan.robot import Array
from compplan.toolpath.toolpath import WRENCH_HEADERS, Toolpath

#: Largest ratio of measured and predicted force that is learned.
MOST_LEVEL = 100.0
#: What is left of the stock: part frame, millimetres.
STOCK = "stock.stl"
#: About how many points of a path are drawn in a scene.
POINTS = 4000


def summarise_forces(found: ForcePrediction) -> dict[str, Any]:
    """Return what forces.json holds."""
    force = np.linalg.norm(found.wrench[:, :3], axis=1)
    acts = force > 0.0
    summary: dict[str, Any] = {
        "schema": 1, "name": found.job.name, "model": found.job.process.model, "waypoints": len(found.nominal),
        "waypoints_in_contact": int(acts.sum()),
        "force_N": {"max": float(force.max()), "mean_in_contact": float(force[acts].mean()) if acts.any() else 0.0},
        "moment_Nm": {"max": float(np.linalg.norm(found.wrench[:, 3:], axis=1).max())},
        "uncertainty": getattr(found.job.process, "uncertainty", None),
        "uncertainty_stated": _states_uncertainty(found.job.process),
        "notes": found.notes,
    }  # fmt: skip
    summary["stops"] = list_stops(summary["notes"])
    if found.law.cutting is not None:
        cut = found.law.cutting.engagement
        summary["engagement"] = {
            "axial_depth_mm": {"max": float(1e3 * cut.axial.max())},
            "radial_width_mm": {"max": float(1e3 * cut.radial.max())},
            "removed_mm3": float(1e9 * (cut.section[1:] * found.nominal.steps * ~found.nominal.rapid[1:]).sum()),
        }
        resistance = found.law.cutting.process.resistance
        summary["coefficients"] = {
            "cutting_N_mm2": list(resistance.cutting), "edge_N_mm": list(resistance.edge),
            "exponent": list(resistance.exponent), "source": resistance.source, "assumed": resistance.assumed,
        }  # fmt: skip
    if found.fit is not None:
        summary["log"] = {
            "rows": found.fit.rows, "rms_N": found.fit.level, "rms_before_N": found.fit.rms_before,
            "rms_after_N": found.fit.rms_after, "fitted": [asdict(number) for number in found.fit.numbers],
            "level": found.fit.ratio[0], "level_sigma": found.fit.ratio[1], "notes": list(found.fit.notes),
        }  # fmt: skip
    return summary


def _states_uncertainty(process: Process) -> bool:
    """Tell whether the job states the uncertainty of its force, in place of an assumed one."""
    return any("uncertainty" in table.model_fields_set for table in (process, getattr(process, "coefficients", None))
               if table is not None)  # fmt: skip


def write_forces(found: ForcePrediction, folder: Path) -> dict[str, Any]:
    """Write forces.json, forces.csv, report.html, and what a cutter leaves of its stock; return what forces.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    summary = {**summarise_forces(found), "made_by": describe_origin()}
    with replace_folder(folder, "forces") as part:
        write_table(part / "forces.csv", _tabulate(found))
        write_text(part / "report.html", _render(found, summary))
        if found.law.cutting is not None:
            left = found.law.cutting.leave()
            left.apply_scale(1e3)
            (part / STOCK).write_bytes(left.export(file_type="stl"))
        write_json(part / "forces.json", summary)
    return summary


def write_coefficients(found: ForcePrediction, file: Path) -> None:
    """Write the fitted coefficients as the table [process.coefficients] of a later job.

    Raises:
        InputError: If the force model has no coefficients, or the file cannot be written.
    """
    fitted = None if found.fit is None else found.fit.coefficients
    if fitted is None:
        message = f"process.model is {found.job.process.model!r}, --write is for models with cutting coefficients"
        raise InputError(message, file=found.job.file, where="process.model")
    table = {
        "cutting_N_mm2": [float(f"{value:.5g}") for value in fitted.cutting],
        "edge_N_mm": [float(f"{value:.4g}") for value in fitted.edge], "exponent": list(fitted.exponent),
        "uncertainty": fitted.uncertainty,
    }  # fmt: skip
    try:
        CoefficientTable.model_validate(table)
    except ValidationError as error:
        why = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise InputError(f"the fitted coefficients are no job's: {why}", file=file) from None
    text = (f"# {fitted.source}. Copy this table into a later job, in place of [process] material.\n"
            "# uncertainty is that of the force along the cut that was logged, one standard deviation; another tool,\n"
            "# wear, another cut add to it.\n" + tomli_w.dumps({"process": {"coefficients": table}}))  # fmt: skip
    write_text(file, text)


def write_level(found: ForcePrediction, file: Path) -> None:
    """Enter the level of a measured force into process.toml of a robot folder, from where later plans take it.

    The level of the log is worth its own error and what differs from part to part; it is weighed against what is known:
    earlier parts, or the prediction with its uncertainty.

    Raises:
        InputError: If the file does not stand in a robot folder, or nothing was fitted.
    """
    if found.fit is None or not (file.parent / "robot.urdf").is_file():
        raise InputError("process.toml belongs into a robot folder, beside robot.urdf", file=file)
    process, (level, sigma) = found.job.process, found.fit.ratio
    if not 0.0 < level <= MOST_LEVEL:
        raise InputError(f"the log's force is {level:.3g} times the predicted one, above 0 is allowed", file=file)
    known = read_learned_force(file.parent, process)
    scatter = SCATTER if known is None else known.scatter
    before, width = (1.0, getattr(process, "uncertainty", np.inf)) if known is None else (
        known.level, known.common * known.level
    )  # fmt: skip
    own = sigma**2 + (scatter * level) ** 2
    share = 1.0 if not np.isfinite(width) else width**2 / max(width**2 + own, 1e-300)
    force = LearnedForce(
        before + share * (level - before), float(np.sqrt(share * own)), np.zeros(3), None, scatter,
        () if known is None or not known.same else known.parts, find_axes(process),
    )  # fmt: skip
    if known is not None and known.same and known.turn_sigma is not None:
        force = replace(force, turn=known.turn, turn_sigma=known.turn_sigma)
    today = datetime.datetime.now(tz=datetime.UTC).date()
    part = LearnedPartTable(date=today, job=found.job.name or found.job.file.stem, level=level, sigma=sigma)
    write_learned_force(add_part(force, part), process, file.parent, file.parent)


def _tabulate(found: ForcePrediction) -> dict[str, object]:
    """Return the table against path length, one row a waypoint."""
    nominal = found.nominal
    columns: dict[str, object] = {"s_mm": 1e3 * nominal.arc_length, "rapid": nominal.rapid.astype(np.int64)}
    columns["feed_mm_s"] = 1e3 * nominal.feed
    if found.law.cutting is not None:
        cut = found.law.cutting.engagement
        arc = np.nan_to_num(np.degrees(cut.arc))
        columns |= {
            "axial_depth_mm": 1e3 * cut.axial, "radial_width_mm": 1e3 * cut.radial, "section_mm2": 1e6 * cut.section,
            "first_angle_deg": arc[:, 0], "last_angle_deg": arc[:, 1],
        }  # fmt: skip
    columns |= {name: found.wrench[:, k] for k, name in enumerate(WRENCH_HEADERS)}
    return columns


def _render(found: ForcePrediction, summary: Mapping[str, Any]) -> str:
    """Return the page: the path coloured by force and engagement, and both along the path."""
    stations, cut, notes = _locate_stations(found.nominal), found.engagement, list(summary["notes"])
    size = np.linalg.norm(found.wrench[:, :3], axis=1)
    scenes = [page.Chart(_colour_path(found, size, "N"), "The path coloured by the size of the force.", 430, True)]
    if cut is not None:
        swept = _colour_path(found, 1e6 * cut.section, "mm²")
        about = "The path coloured by what the tool sweeps through material a length of path."
        scenes.append(page.Chart(swept, about, 430, True))
    turns = "; turning one scene turns the other" if len(scenes) > 1 else ""
    sections = [
        page.Section("Along the path", [page.Columns([[scene] for scene in scenes])],
                     f"Moves without contact are grey{turns}."),
        page.Section("Force", _show_force(found, stations)),
    ]  # fmt: skip
    sections += [] if cut is None else [page.Section("Engagement", _show_engagement(found, cut, stations))]
    sections += [] if found.fit is None else [page.Section("Measured log", _show_fit(found.fit))]
    facts = [("force model", name_force_model(found.job.process.model)), *_list_coefficients(summary)]
    lines = draw_lines(stations, {"force": _leave_out_air(found, size)}, "N", title="force", zero=True)
    picture = page.Chart(lines, "Size of the force along the path.", height=330)
    return page.render_page(
        found.job.name or "Forces", _describe(summary), sections, kind="Forces",
        opening=_open(found, summary, picture), notes=notes,
        provenance=page.Provenance(facts, [note for note in notes if "assumed" in note]),
    )  # fmt: skip


def _describe(summary: Mapping[str, Any]) -> str:
    force, level = summary["force_N"], summary.get("uncertainty")
    share = summary["waypoints_in_contact"] / max(summary["waypoints"], 1)
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    text = (f"The tool carries up to {most}\u00a0N, {mean}\u00a0N on average where it is in contact, which is at "
            f"{100 * share:.0f}\u00a0% of the waypoints.")  # fmt: skip
    if level is None:
        return text
    whence = "as the job says" if summary["uncertainty_stated"] else "assumed"
    return f"{text} The level is uncertain by {100 * level:.0f}\u00a0% (one standard deviation, {whence})."


def _open(found: ForcePrediction, summary: Mapping[str, Any], picture: page.Chart) -> page.Summary:
    """Return the first screen: what force the tool carries."""
    force, level, stated = summary["force_N"], summary.get("uncertainty"), summary["uncertainty_stated"]
    most, mean = format_number(force["max"]), format_number(force["mean_in_contact"])
    sizes = np.abs(found.local)
    along, across = sizes[:, 2].max(initial=0.0), np.hypot(sizes[:, 0], sizes[:, 1]).max(initial=0.0)
    about = np.abs(np.einsum("ni,ni->n", found.wrench[:, 3:], found.nominal.axis)).max(initial=0.0)
    verdict = (f"The force on the tool is at most {most}\u00a0N: {format_number(float(along))}\u00a0N along its axis, "
               f"{format_number(float(across))}\u00a0N across")  # fmt: skip
    verdict += f"; torque {format_number(float(about))}\u00a0N\u00a0m." if about > 1e-3 else "."
    figures = [page.KeyFigure(f"{most}\u00a0N", "greatest force"),
               page.KeyFigure(f"{mean}\u00a0N", "mean force in the cut")]  # fmt: skip
    if level is not None:
        words = f"uncertainty of these forces, one standard deviation, {'as the job says' if stated else 'assumed'}"
        figures.append(page.KeyFigure(f"± {100 * level:.0f}\u00a0%", words))
    todo = "Plan with it: compplan plan JOB."
    if level is not None and not stated:
        todo = "Measure the force of one cut and give the log: compplan forces JOB --log LOG.csv."
    if stops := list_stops(summary["notes"]):
        todo = "Settle what is listed before the machine moves."
        return page.Summary(verdict, "bad", figures, picture, todo, stops)
    return page.Summary(verdict, "" if found.fit is None else "good", figures, picture, todo)


def _leave_out_air(found: ForcePrediction, value: Array) -> Array:
    """Return values with NaN in rapid moves that carry nothing: no line goes from a cut into the air. As value."""
    idle = found.nominal.rapid & ~found.wrench.any(axis=1)
    return np.where(idle if value.ndim == 1 else idle[:, None], np.nan, value)


def _list_coefficients(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the coefficients of a cut as the page shows them; nothing where there are none."""
    found = summary.get("coefficients")
    if found is None:
        return []
    names = (("cutting coefficients, N/mm²", "cutting_N_mm2"), ("edge coefficients, N/mm", "edge_N_mm"),
             ("Kienzle's exponent", "exponent"))  # fmt: skip
    parts = ("tangential", "radial", "axial")
    facts = [(words, ", ".join(f"{part} {value:g}" for part, value in zip(parts, found[name], strict=True)))
             for words, name in names]  # fmt: skip
    return [*facts, ("coefficients are", f"{'assumed' if found['assumed'] else 'taken over'}: {found['source']}")]


def _locate_stations(nominal: Toolpath) -> Stations:
    """Return where the waypoints are, for the charts."""
    rests = nominal.rapid[1:] | (nominal.feed[1:] <= 0.0)
    step = np.where(rests, 0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9))
    spans = find_spans(nominal.rapid)
    spans = np.column_stack([np.maximum(spans[:, 0] - 1, 0), spans[:, 1]]).astype(int)
    shaded = nominal.arc_length[spans].reshape(-1, 2)
    return Stations(nominal.arc_length, np.r_[0.0, np.cumsum(step)], np.zeros(0, int), shaded)


def _colour_path(found: ForcePrediction, value: Array, unit: str) -> Figure:
    """Draw the path coloured by a value; moves where it is zero are grey."""
    figure, points = Figure(scenes=True), 1e3 * found.nominal.position
    rows = thin_path(found.nominal.position, value, POINTS)
    shown, air = points[rows], value[rows] <= 0.0
    travel = air | np.r_[air[1:], False]  # a move into the air begins at the waypoint before
    add_path(figure, np.where(travel[:, None], shown, np.nan), "", NEUTRAL, 2)
    add_path(
        figure, np.where(air[:, None], np.nan, shown), "", value[rows], 6, coloraxis="coloraxis",
        custom=np.column_stack([rows, value[rows]]),
        hover="waypoint %{customdata[0]:.0f}: %{customdata[1]:.4g} " + unit + "<extra></extra>",
    )  # fmt: skip
    frame_scenes(figure, points, size=1.75)
    figure.layout |= {"showlegend": False, "coloraxis": colour_axis(unit, 0.0, float(max(value.max(), 1e-9)))}
    return figure


def _show_force(found: ForcePrediction, stations: Stations) -> list[page.Block]:
    names = ("along the travel", "to the left", "along the tool axis")
    series = dict(zip(names, _leave_out_air(found, found.local[:, :3]).T, strict=True))
    mean = draw_lines(stations, series, "N", title="force", colours=CATEGORIES[:3])
    about = "Mean force of the environment on the tool; left as seen down the tool axis, the axis from tip up."
    tall = 440 if np.abs(found.wrench[:, 3:]).max() > 1e-9 else 300
    lines = draw_wrench(stations, _leave_out_air(found, found.wrench))
    base = page.Chart(lines, "The same wrench at the tip, base axes.", height=tall)
    return [page.Chart(mean, about, height=340), base]


def _show_engagement(found: ForcePrediction, cut: Engagement, stations: Stations) -> list[page.Block]:
    """Show depth, width and angle along the path, and all of them at even lengths of the cut."""
    depth = {"axial depth": 1e3 * _leave_out_air(found, cut.axial),
             "radial width": 1e3 * _leave_out_air(found, cut.radial)}  # fmt: skip
    arc, length = np.degrees(cut.arc), 1e3 * found.nominal.arc_length
    angles = {"first": arc[:, 0], "last": arc[:, 1]}
    force, touches = np.linalg.norm(found.wrench[:, :3], axis=1), np.flatnonzero(cut.touches)
    rows = touches[np.unique(np.linspace(0, len(touches) - 1, min(len(touches), 60)).astype(int))]
    table: list[page.Row] = [
        [int(i), float(length[i]), float(1e3 * cut.axial[i]), float(1e3 * cut.radial[i]), float(arc[i, 0]),
         float(arc[i, 1]), page.Cell(float(force[i]), "strong")]
        for i in rows
    ]  # fmt: skip
    columns = ["waypoint", "length [mm, 4]", "axial depth [mm]", "radial width [mm]", "first angle [deg]",
               "last angle [deg]", "force [N]"]  # fmt: skip
    colours = (AFTER, BEFORE)
    return [
        page.Chart(draw_lines(stations, depth, "mm", title="engaged", colours=colours, zero=True),
                   "Axial depth and radial width of what the cutter meets.", height=300),
        page.Chart(draw_lines(stations, angles, "deg", title="angle", colours=colours),
                   "First and last engaged angle, from the travel to the left; none in the air.", height=280),
        page.DataTable(columns, table, "At even steps of the cut; forces.csv has every waypoint.", scroll=14),
    ]  # fmt: skip


def _show_fit(fit: ForceFit) -> list[page.Block]:
    table: list[page.Row] = []
    for number in fit.numbers:
        inside = number.low <= number.in_job <= number.high
        verdict = page.Cell("within" if inside else "differs", "good" if inside else "bad")
        fitted = page.Cell(number.value, "strong")
        table.append([number.name, number.in_job, fitted, number.low, number.high, number.unit, verdict])
    columns = ["number", "in the job [, 4]", "fitted [, 4]", "from", "to (95 %)", "unit",
               "the job's value"]  # fmt: skip
    before, after, level = (format_number(v) for v in (fit.rms_before, fit.rms_after, fit.level))
    text = (f"{fit.rows} rows of the log lie in the cut. The prediction is off by {before} N (rms), of {level} N "
            f"measured; with the fitted numbers by {after} N.")  # fmt: skip
    return [text, *fit.notes, page.DataTable(columns, table, "Intervals from leaving out blocks of the path.")]
