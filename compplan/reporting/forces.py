"""Outputs of `compplan forces`: forces.json, forces.csv, the page, and fitted coefficients or a measured level."""

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
from compplan.job.loading import ForcePrediction
from compplan.process.engagement import Engagement
from compplan.process.fit import ForceFit
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
from compplan.reporting.along_path import Stations, chart_lines, chart_wrench, place_stations
from compplan.reporting.charts import Figure, thin_path
from compplan.reporting.page import Block, Cell, Chart, Columns, DataTable, Provenance, Section, Summary, render_page
from compplan.reporting.scenes import add_path, colour_axis, frame_scenes
from compplan.robot import Array
from compplan.toolpath.toolpath import WRENCH_HEADERS, Toolpath

#: Largest accepted ratio of measured to predicted force.
MOST_LEVEL = 100.0
#: Approximate number of drawn points of a path in a scene.
POINTS = 4000


def summarise_forces(found: ForcePrediction) -> dict[str, Any]:
    """Return the content of forces.json; the uncertainty is stated if the job sets it, otherwise assumed."""
    force, process = np.linalg.norm(found.wrench[:, :3], axis=1), found.job.process
    acts = force > 0.0
    tables = filter(None, (process, getattr(process, "coefficients", None)))
    summary: dict[str, Any] = {
        "schema": 1, "name": found.job.name, "model": process.model, "waypoints": len(found.nominal),
        "waypoints_in_contact": int(acts.sum()),
        "force_N": {"max": float(force.max()), "mean_in_contact": float(force[acts].mean()) if acts.any() else 0.0},
        "moment_Nm": {"max": float(np.linalg.norm(found.wrench[:, 3:], axis=1).max())},
        "uncertainty": getattr(process, "uncertainty", None),
        "uncertainty_stated": any("uncertainty" in table.model_fields_set for table in tables),
        "notes": found.notes, "stops": list_stops(found.notes),
    }  # fmt: skip
    if found.law.cutting is not None:
        cut, resistance = found.law.cutting.engagement, found.law.cutting.process.resistance
        summary["engagement"] = {
            "axial_depth_mm": {"max": float(1e3 * cut.axial.max())},
            "radial_width_mm": {"max": float(1e3 * cut.radial.max())},
            "removed_mm3": float(1e9 * (cut.section[1:] * found.nominal.steps * ~found.nominal.rapid[1:]).sum()),
        }
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


def write_forces(found: ForcePrediction, folder: Path) -> dict[str, Any]:
    """Write forces.json, forces.csv and the page; return the content of forces.json."""
    summary = {**summarise_forces(found), "made_by": describe_origin()}
    with replace_folder(folder, "forces") as part:
        write_table(part / "forces.csv", _tabulate(found))
        write_text(part / "report.html", _render(found, summary))
        write_json(part / "forces.json", summary)
    return summary


def write_coefficients(found: ForcePrediction, file: Path) -> None:
    """Write the fitted coefficients as the section [process.coefficients] of a later job."""
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
        raise InputError(f"the fitted coefficients do not fit a job: {why}", file=file) from None
    text = (f"# {fitted.source}. Copy this section into a later job, in place of [process] material.\n"
            "# uncertainty is that of the force along the cut that was logged, one standard deviation; another tool,\n"
            "# wear, another cut add to it.\n" + tomli_w.dumps({"process": {"coefficients": table}}))  # fmt: skip
    write_text(file, text)


def write_level(found: ForcePrediction, file: Path) -> None:
    """Write the level of a measured force to process.toml of a robot folder, which later plans read.

    The variance of the measured level includes the scatter from part to part. The level is combined with the prior,
    from earlier parts or the prediction with its uncertainty, by inverse variances.
    """
    if found.fit is None or not (file.parent / "robot.urdf").is_file():
        raise InputError("no robot.urdf beside it: write process.toml into the folder of a robot", file=file)
    process, (level, sigma) = found.job.process, found.fit.ratio
    if not 0.0 < level <= MOST_LEVEL:
        fault = f"the measured force is {level:.3g} times the predicted one, expected 0 to {MOST_LEVEL:g}"
        raise InputError(f"{fault}; check sign, unit and frame of the log", file=file)
    known = read_learned_force(file.parent, process)
    scatter = SCATTER if known is None else known.scatter
    before, width = 1.0, getattr(process, "uncertainty", np.inf)
    if known is not None:
        before, width = known.level, known.common * known.level
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
    """Return the columns of forces.csv, one row per waypoint."""
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
    return columns | {name: found.wrench[:, k] for k, name in enumerate(WRENCH_HEADERS)}


def _render(found: ForcePrediction, summary: Mapping[str, Any]) -> str:
    """Return the page: the path coloured by force and engagement, and both along the path."""
    stations, cut, notes = _locate_stations(found.nominal), found.engagement, list(summary["notes"])
    size = np.linalg.norm(found.wrench[:, :3], axis=1)
    scenes = [Chart(_colour_path(found, size, "N"), "The path coloured by the size of the force.", 430, True)]
    if cut is not None:
        about = "The path coloured by the cross-section that is cut: removed volume per length of path."
        scenes.append(Chart(_colour_path(found, 1e6 * cut.section, "mm²"), about, 430, True))
    turns = "; turning one scene turns the other" if len(scenes) > 1 else ""
    sections = [
        Section("Along the path", [Columns([[scene] for scene in scenes])], f"Moves without contact are grey{turns}."),
        Section("Force", _show_force(found, stations)),
    ]
    sections += [] if cut is None else [Section("Engagement", _show_engagement(found, cut, stations))]
    sections += [] if found.fit is None else [Section("Measured log", _show_fit(found.fit))]
    contact = f"{summary['waypoints_in_contact']} of {summary['waypoints']} waypoints"
    facts = [("force model", name_force_model(found.job.process.model)), ("in contact", contact)]
    if (known := summary.get("coefficients")) is not None:
        names = (("cutting coefficients, N/mm²", "cutting_N_mm2"), ("edge coefficients, N/mm", "edge_N_mm"),
                 ("Kienzle's exponent", "exponent"))  # fmt: skip
        for words, name in names:
            parts = zip(("tangential", "radial", "axial"), known[name], strict=True)
            facts.append((words, ", ".join(f"{part} {value:g}" for part, value in parts)))
    assumed = [note for note in notes if "assumed" in note]
    return render_page(
        found.job.name or "Forces", open_forces(found, summary), sections, kind="Forces",
        notes=[note for note in notes if note not in assumed], provenance=Provenance(facts, assumed),
    )  # fmt: skip


def open_forces(found: ForcePrediction, summary: Mapping[str, Any]) -> Summary:
    """Return the first screen: greatest force and torque on the tool."""
    force, level, stated = summary["force_N"], summary.get("uncertainty"), summary["uncertainty_stated"]
    most, sizes = format_number(force["max"]), np.abs(found.local)
    along, across = sizes[:, 2].max(initial=0.0), np.hypot(sizes[:, 0], sizes[:, 1]).max(initial=0.0)
    torque = np.abs(np.einsum("ni,ni->n", found.wrench[:, 3:], found.nominal.axis)).max(initial=0.0)
    verdict = (f"The force on the tool is at most {most}\u00a0N: {format_number(float(along))}\u00a0N along its axis, "
               f"{format_number(float(across))}\u00a0N across")  # fmt: skip
    verdict += f"; torque {format_number(float(torque))}\u00a0N\u00a0m." if torque > 1e-3 else "."
    figures = [(f"{most}\u00a0N", "greatest force"),
               (f"{format_number(force['mean_in_contact'])}\u00a0N", "mean force in the cut")]  # fmt: skip
    if level is not None:
        words = f"uncertainty of these forces, one standard deviation, {'as the job says' if stated else 'assumed'}"
        figures.append((f"± {100 * level:.0f}\u00a0%", words))
    todo = "Plan with it: compplan plan JOB."
    if found.fit is not None:
        todo = found.fit.level_warning or _use_fit(found.fit, found.job.process)
    elif level is not None and not stated:
        todo = "Measure the force of one cut and give the log: compplan forces JOB --log LOG.csv."
    if summary["stops"]:
        todo = "Settle what is listed before the machine moves."
    tone = "bad" if summary["stops"] else "" if found.fit is None else "good"
    series = {"force": _leave_out_air(found, np.linalg.norm(found.wrench[:, :3], axis=1))}
    about, where = "Size of the force along the path.", _locate_stations(found.nominal)
    picture = chart_lines(where, series, "N", "force", about, 330, zero=True)
    return Summary(verdict, tone, figures, picture, todo, summary["stops"])


def _use_fit(fit: ForceFit, process: object) -> str:
    """Return the next step with fitted numbers: where they belong in the job."""
    if fit.coefficients is not None:
        return "Write the coefficients for the job: --write FILE."
    keys = {"factor to the left": "lateral_N", "factor along the tool axis": "axial_N"}
    factors = []
    for one in fit.numbers:
        if one.unit == "1" and one.determined:
            key = keys.get(one.name, "")
            name = key if hasattr(process, key) else one.name.replace("factor", "the force")
            factors.append(f"{name} by {one.value:.4g}")
    if not factors:
        return "Log the force again, with stretches in the air before and after the cut."
    return f"Multiply {' and '.join(factors)} in [process] of the job, then compplan plan JOB."


def list_fitted(fit: ForceFit) -> list[str]:
    """Return a line for each fitted number: value, 95 % interval, value in the job."""
    lines = []
    for one in fit.numbers:
        value = f"{one.value:.4g} {one.unit}".removesuffix(" 1") if one.determined else "not determined"
        job = f"; {one.in_job:.4g} in the job" if one.in_job else ""
        lines.append(f"  {one.name}: {value} (95 %: {one.low:.4g} to {one.high:.4g}){job}")
    return lines


def _leave_out_air(found: ForcePrediction, value: Array) -> Array:
    """Return values with NaN in rapid moves without force, where no line is drawn. Shape as value."""
    idle = found.nominal.rapid & ~found.wrench.any(axis=1)
    return np.where(idle if value.ndim == 1 else idle[:, None], np.nan, value)


def _locate_stations(nominal: Toolpath) -> Stations:
    """Return path length and time of the waypoints, for the charts."""
    rests = nominal.rapid[1:] | (nominal.feed[1:] <= 0.0)
    step = np.where(rests, 0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9))
    return place_stations(nominal.position, np.r_[0.0, np.cumsum(step)], ~nominal.rapid)


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


def _show_force(found: ForcePrediction, stations: Stations) -> list[Block]:
    names, colours = ("along the travel", "to the left", "along the tool axis"), CATEGORIES[:3]
    series = dict(zip(names, _leave_out_air(found, found.local[:, :3]).T, strict=True))
    caption = "Mean force of the environment on the tool; left as seen down the tool axis, the axis from tip up."
    mean = chart_lines(stations, series, "N", "force", caption, colours=colours)
    wrench = _leave_out_air(found, found.wrench)
    return [mean, chart_wrench(stations, wrench, "The same wrench at the tip, base axes.")]


def _show_engagement(found: ForcePrediction, cut: Engagement, stations: Stations) -> list[Block]:
    """Show depth, width and angle along the path."""
    depth = {"axial depth": 1e3 * _leave_out_air(found, cut.axial),
             "radial width": 1e3 * _leave_out_air(found, cut.radial)}  # fmt: skip
    arc = np.degrees(cut.arc)
    colours, caption = (AFTER, BEFORE), "Axial depth and radial width of the cut."
    angles = {"first": arc[:, 0], "last": arc[:, 1]}
    turn = "First and last engaged angle, from the travel to the left; none in the air."
    return [
        chart_lines(stations, depth, "mm", "engaged", caption, 300, colours=colours, zero=True),
        chart_lines(stations, angles, "deg", "angle", turn, 280, colours=colours),
    ]


def _show_fit(fit: ForceFit) -> list[Block]:
    table = []
    for number in fit.numbers:
        inside = number.low <= number.in_job <= number.high
        verdict = Cell("within" if inside else "differs", "good" if inside else "bad")
        verdict = verdict if number.determined else Cell("not determined", "unsure")
        fitted = Cell(number.value, "strong")
        table.append([number.name, number.in_job, fitted, number.low, number.high, number.unit, verdict])
    columns = ["number", "in the job [, 4]", "fitted [, 4]", "from", "to (95 %)", "unit", "the job's value"]
    before, after, level = (format_number(v) for v in (fit.rms_before, fit.rms_after, fit.level))
    text = (f"{fit.rows} rows of the log lie in the cut. The prediction is off by {before} N (rms), of {level} N "
            f"measured; with the fitted numbers by {after} N.")  # fmt: skip
    return [text, *fit.notes, DataTable(columns, table, "Intervals from leaving out blocks of the path.")]
