"""Page of a plan: attained deviation, path, joints, corrections, feed, 95 % band, posture."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.io.notes import list_remarks
from compplan.io.palette import AFTER, BEFORE, CATEGORIES, LIMIT, NEUTRAL
from compplan.io.quantities import (
    format_length,
    format_number,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.io.tables import write_text
from compplan.planning.notes import describe_causes, mark_slow
from compplan.planning.posture.costs import ASSUMED
from compplan.process.force_models import name_force_model
from compplan.reporting.along_path import (
    Stations,
    chart_lines,
    chart_wrench,
    draw_joints,
    draw_shares,
    find_spans,
    place_stations,
)
from compplan.reporting.page import Block, Cell, Chart, Columns, DataTable, Fold, Section, render_page
from compplan.reporting.plan_summary import open_plan
from compplan.reporting.provenance import describe_robot, list_assumptions
from compplan.reporting.scenes import describe_magnification, draw_cell, draw_deviation_paths, place_meshes
from compplan.robot import Array
from compplan.simulation.simulated_robot import EXACT_EVALUATION
from compplan.uncertainty.band import PARTS, ErrorBand
from compplan.uncertainty.ladder import DO

if TYPE_CHECKING:
    from compplan.planning.plan import Plan
    from compplan.planning.posture.summary import PostureSummary

#: Greatest number of waypoints or stretches in a table.
LISTED = 40
#: Least displayed tilt. [deg]
LEAST_TILT = 1e-4
#: Share of the greatest force below which a force counts as zero.
NO_FORCE = 1e-3
#: Names of the parts of the 95 % band.
WORDS = {
    "model": "parameters of the robot", "unexplained": "what no parameter explains", "repeatability": "repeatability",
    "force": "the force", "motion": "inertia and vibration", "placement": "place of the part",
}  # fmt: skip


def write_plan_page(plan: Plan, file: Path) -> None:
    """Write the page of a plan; programs in the same folder are listed with their checksums."""
    task = plan.task
    stations = place_stations(task.position, plan.timing.time, task.compensated, plan.command.failures)
    rates = [
        (name, values, limits) for name, values, limits in (
            ("velocity", plan.timing.velocity, task.velocity_limits),
            ("acceleration", plan.timing.acceleration, task.acceleration_limits),
        ) if np.isfinite(limits).any()
    ]  # fmt: skip
    figure = draw_joints(stations, plan.q, task.robot.lower, task.robot.upper, task.robot.joint_names,
                         task.robot.prismatic)  # fmt: skip
    joints = Chart(figure, "Commanded joint positions; red is beyond the limit.", 60 + 215 * -(-task.robot.nq // 3),
                   along=True)  # fmt: skip
    sections = [
        _show_reach(plan, rates), _show_deviation(plan),
        Section("Joints", [joints], "Each chart spans the whole range of its joint."),
        _show_corrections(plan, stations), _show_feed(plan, stations, rates),
    ]  # fmt: skip
    sections += [] if plan.error_band is None else [show_error_band(plan.error_band, stations, task.tolerance)]
    assumptions = list_assumptions(plan.job)
    choice = None if task.start is None else task.start.posture_choice
    if choice is not None:
        assumptions.append(_list_uncertainties(choice))
        sections.append(_show_posture(plan, choice, stations))
    write_text(file, render_page(
        plan.name, open_plan(plan, file.parent), sections, kind=f"Path plan, {plan.robot.name}",
        notes=list_remarks(plan.notes), provenance=describe_robot(plan.robot, _list_facts(plan), assumptions),
    ))  # fmt: skip


def _list_facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("strategy", plan.strategy), ("deviation computed by", EXACT_EVALUATION)]
    if plan.job is not None:
        facts += [("job", str(plan.job.file))] if plan.job.file.is_file() else []
        facts.append(("force model", name_force_model(plan.job.process.model)))
    words = ", ".join(f"{name} {word}" for name, word in plan.task.configuration.items())
    return [
        *facts, ("toolpath", plan.task.nominal.source or "given in memory"),
        *([("configuration", words)] if words else []),
        ("rotation about the tool axis", "free" if plan.task.spin_free else "fixed by the job"),
        ("time in the solver", f"{plan.command.solve_time:.3g} s"),
    ]  # fmt: skip


def _show_reach(plan: Plan, rates: Sequence[tuple[str, Array, Array]]) -> Section:
    """Show the figures of the plan, uncorrected and planned, and the robot in its cell."""
    task, sides, between = plan.task, (plan.before, plan.after), plan.between
    names = {"rms": "deviation, rms", "mean": "deviation, mean", "max": "deviation, largest"}
    rows: list[list[Any]] = [
        [words, *(format_length(1e-3 * side.figures[name]) for side in sides)] for name, words in names.items()
    ]
    shares = (format_percent(side.share_within(task.tolerance)) for side in sides)
    rows.append([f"within {format_set_length(task.tolerance)}", *shares])
    tilts = (float(np.degrees(side.max_tilt)) for side in sides)
    shown = (format_number(tilt) if tilt >= LEAST_TILT else f"below {LEAST_TILT:g}" for tilt in tilts)
    rows.append(["tool axis off by up to", *(f"{tilt}\u00a0deg" for tilt in shown)])
    ways = {"joints linear": between.joint, "tip linear": between.cartesian}
    planned = {f"between waypoints, {way}": format_length(float(m.max(initial=0.0))) for way, m in ways.items()}
    if plan.executed is not None:
        drives = "drives as identified" if plan.executed.known else "drives not known"
        planned[f"as the controller executes the programs, {drives}"] = format_length(plan.executed.most)
    allowed = format_set_length(task.max_correction)
    planned["largest correction"] = f"{format_length(plan.max_correction)} of {allowed}"
    for name, values, limits in rates:
        share = np.abs(values) / limits
        joint = plan.robot.joint_names[int(np.argmax(share.max(axis=0)))]
        planned[f"{name} used"] = f"{format_percent(float(share.max()))} ({joint})"
    if plan.motion is not None:
        word = "compensated" if task.inertia else "not compensated"
        assumed = " (assumed masses)" if "assumed" in plan.robot.sources.get("masses", "") else ""
        planned[f"bent by inertia, {word}{assumed}"] = format_length(plan.inertia)
    table = DataTable(["", "uncorrected", "planned"], [*rows, *([key, None, value] for key, value in planned.items())])
    cut = plan.after.cut
    kinds = np.where(mark_force(task.wrench, cut), 0, np.where(cut, 1, 2))
    start, scene = int(np.flatnonzero(cut)[0]), None if task.start is None else task.start.settings.scene
    around = [] if scene is None else place_meshes(plan.robot, plan.q[start], scene.meshes)
    named = f", with the meshes that the job names ({', '.join(shape.link for shape in around)})" if around else ""
    cell = Chart(
        draw_cell(plan.robot, plan.q, task.position, start=start, around=around, kinds=kinds),
        f"The robot at the first waypoint of the cut, drawn from its URDF shapes{named}, and the path of the tool "
        "tip: which moves carry force, which are in the cut without, and which are rapid.",
        height=400, along=True,
    )  # fmt: skip
    return Section("What it reaches", [Columns([[table], [cell]])])


def _show_deviation(plan: Plan) -> Section:
    cut, names = np.flatnonzero(plan.after.cut), ("uncorrected", "planned")
    path, off, after = plan.task.position[cut], plan.before.deviation[cut], plan.after.distance
    scene = Chart(
        draw_deviation_paths(path, off, plan.after.deviation[cut], names=names),
        "Grey: the wanted path. Coloured: where the loaded tip goes, its deviation "
        f"{describe_magnification(path, off)}. Both use one colour scale, which is logarithmic; turning one turns the "
        "other.",
        height=440, linked_scenes=True, along=True,
    )  # fmt: skip
    failed = [_list_failures(plan, after)] if plan.command.failures else []
    about = "Distance of the loaded tool tip from the toolpath."
    return Section("Deviation", [scene, *failed], about)


def _list_failures(plan: Plan, after: Array) -> DataTable:
    failures, length = plan.command.failures, plan.task.nominal.arc_length
    failed = np.array(sorted(failures))
    reasons = np.array([failures[i] for i in failed.tolist()])
    first = np.flatnonzero(np.r_[True, (np.diff(failed) > 1) | (reasons[1:] != reasons[:-1])])
    last = np.r_[first[1:] - 1, len(failed) - 1]
    rows = [
        [a, b, 1e3 * float(length[a]), 1e3 * float(length[b]), reason, Cell(1e3 * float(after[a : b + 1].max()), "bad")]
        for a, b, reason in zip(failed[first].tolist(), failed[last].tolist(), reasons[first].tolist(), strict=True)
    ]
    more = f" The first {LISTED} of {len(rows)} stretches." if len(rows) > LISTED else ""
    columns = ["from waypoint", "to", "from [mm, 4]", "to [mm, 4]", "stopped by", "deviation left [mm]"]
    return DataTable(columns, rows[:LISTED], f"Waypoints that fail and the limit that stops them.{more}", 12)


def _show_corrections(plan: Plan, stations: Stations) -> Section:
    size, task = np.linalg.norm(plan.correction, axis=1), plan.task
    series = {f"d{axis}": 1e3 * plan.correction[:, k] for k, axis in enumerate("xyz")} | {"distance": 1e3 * size}
    near = size.max() > 0.5 * task.max_correction
    limit = (1e3 * task.max_correction, f"limit {format_set_length(task.max_correction)}") if near else None
    caption = "Commanded (unloaded) tip minus wanted tip, base axes."
    blocks: list[Block] = [
        chart_lines(stations, series, "mm", "correction", caption, 320, colours=(*CATEGORIES[:3], NEUTRAL), limit=limit)
    ]
    if np.abs(task.wrench).max() > 0:
        caption = "Predicted wrench of the environment on the tool at its tip, base axes."
        blocks.append(chart_wrench(stations, task.wrench, caption))
    return Section("Corrections and forces", blocks)


def mark_force(wrench: Array, cut: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the moves of the cut (n,) that carry force, by their end waypoint; wrench: (n, 6) [N, N m]."""
    size = np.linalg.norm(wrench[:, :3], axis=1)
    acts = size > NO_FORCE * max(float(size.max(initial=0.0)), 1e-12)
    return np.asarray(cut & (acts | np.r_[acts[:1], acts[:-1]]))


def _show_feed(plan: Plan, stations: Stations, rates: Sequence[tuple[str, Array, Array]]) -> Section:
    task, nominal = plan.task, plan.task.nominal
    wanted = np.where(task.compensated & ~nominal.rapid, nominal.feed, np.nan)
    series = {"programmed": 1e3 * wanted, "planned": 1e3 * np.where(np.isfinite(wanted), plan.timing.feed, np.nan)}
    caption = "Feed of the tool tip along the cut."
    blocks: list[Block] = [
        chart_lines(stations, series, "mm/s", "feed", caption, 280, colours=(BEFORE, AFTER), zero=True)
    ]
    if rates:
        figure = draw_shares(stations, {name: np.abs(v) / limits for name, v, limits in rates}, plan.robot.joint_names)
        caption = (
            "How much of its limits each joint uses; red is beyond the limit, which lies off the chart where it is"
        )
        blocks.append(Chart(figure, f"{caption} far.", 60 + 220 * len(rates), along=True))
    slow, length = mark_slow(task, plan.timing), 1e3 * nominal.arc_length
    if slow.any():
        spans, share = find_spans(slow), plan.timing.feed / np.maximum(nominal.feed, 1e-12)
        depth = np.array([share[a : b + 1].min() for a, b in spans])
        rows = []
        for a, b in spans[np.sort(np.argsort(depth)[:LISTED])].tolist():
            k = a + int(np.argmin(share[a : b + 1]))
            numbers = [float(v) for v in (length[a], length[b], 1e3 * nominal.feed[k], 1e3 * plan.timing.feed[k])]
            rows.append([a, b, *numbers])
        columns = ["from waypoint", "to", "from [mm, 4]", "to [mm, 4]", "programmed [mm/s]", "lowest [mm/s]"]
        more = f" The {LISTED} deepest of {len(spans)} stretches." if len(spans) > LISTED else ""
        blocks.append(DataTable(columns, rows, f"Where the feed is lowered.{more}", 12))
    lede = describe_causes(task, plan.timing) or "The programmed feed holds all along the cut."
    return Section("Feed and rates", blocks, lede)


def show_error_band(band: ErrorBand, stations: Stations, tolerance: float) -> Section:
    """Show the 95 % band of the true tip and its parts; tolerance: greatest allowed deviation. [m]"""
    evaluated, cut, widest = np.where(band.cut, 1e3, np.nan), band.cut, band.widest
    series = {"all together": band.radius * evaluated}
    series |= {WORDS[name]: band.parts[name] * evaluated for name in PARTS if band.parts[name].any()}
    limit = (1e3 * tolerance, f"tolerance {format_set_value(1e3 * tolerance)} mm")
    caption = "95 % band: distance from the path that contains the true tip, in all and by each cause alone."
    blocks: list[Block] = [chart_lines(stations, series, "mm", "95 % band", caption, 360, zero=True, limit=limit)]
    total, rows = band.radius[widest] ** 2, list[list[Any]]()
    for name in (name for name in PARTS if band.parts[name].any()):
        values = band.parts[name]
        share = float(values[widest] ** 2 / total) if total > 0 else 0.0
        rows.append([WORDS[name], 1e3 * _rms(values[cut]), 1e3 * float(values[widest]), format_percent(share)])
    together = [Cell(1e3 * value, "strong") for value in (_rms(band.radius[cut]), float(band.radius[widest]))]
    rows.append(["all together", *together, None])
    rows += [["between waypoints, on top", None, 1e3 * band.between, None]] if band.between > 0 else []
    rows.append(["the whole path at once", None, Cell(1e3 * band.whole, "strong"), None])
    columns = ["95 % band by", "rms [mm]", "at its widest [mm]", "share of its square"]
    blocks.append(DataTable(columns, rows, f"The band is widest at waypoint {widest}."))
    if band.ladder:
        steps = [
            [DO.get(rung.step, "as it is now"), 1e3 * rung.band, 1e3 * rung.alone, "yes" if rung.keeps else "no",
             format_set_value(rung.minutes), rung.instrument or None]
            for rung in band.ladder
        ]  # fmt: skip
        columns = ["measure, one after the other", "band of the whole cut then [mm]", "after this alone [mm]", "keeps",
                   "work, assumed [min]", "with"]  # fmt: skip
        cheapest = " and ".join(DO[step] for step in band.cheapest)
        blocks.append(DataTable(columns, steps, f"Cheapest that keeps the tolerance: {cheapest}." if cheapest else ""))
    if band.leading:
        blocks.append(list_leading(band.leading, "What would narrow the band most, mean over the path."))
    if band.assumed:
        blocks.append(Fold("What is assumed", list(band.assumed)))
    return Section("95 % band", blocks, _describe_error_band(band, tolerance))


def name_unknown(name: str) -> str:
    """Return the displayed name of an uncertain parameter."""
    return re.sub(r"_(rad|m)#\d+$", "", name).replace("_", " ")


def list_leading(leading: Sequence[tuple[str, float]], caption: str = "") -> DataTable:
    """List the uncertain parameters that widen the band most, with their shares of the variance of the tip."""
    rows: list[list[Any]] = [[name_unknown(name), format_percent(share)] for name, share in leading]
    rows = rows or [["nothing stands out", None]]
    return DataTable(["if this were exact", "the variance of the tip would shrink by"], rows, caption)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _describe_error_band(band: ErrorBand, tolerance: float) -> str:
    """Describe the 95 % band at a point and along the path; tolerance: [m]"""
    verdict = "That keeps" if band.whole <= tolerance else "That does not keep"
    text = (
        f"At any point the true tip is within {format_length(band.greatest)} of the path with 95 %; along the whole"
        f" part within {format_length(band.whole)}. {verdict} the tolerance of {format_set_value(1e3 * tolerance)} mm."
    )
    if band.before is not None:
        text += f" The uncorrected program: within {format_length(band.before[1])} along the whole part."
    grade = {"measured": "measured", "assumed": "assumed"}.get(band.known.grade, "from literature")
    return f"{text} The widths are {grade}: {band.known.source}."


def _show_posture(plan: Plan, choice: PostureSummary, stations: Stations) -> Section:
    """Show the chosen posture along the path, and its clearance if computed."""
    angles = {"rotation": choice.spin, "lead": choice.lead, "lean": choice.lean}
    turned = {name: np.degrees(np.interp(plan.task.origin, np.arange(len(angle)), angle))
              for name, angle in angles.items() if np.ptp(angle) > 0.0 or name == "rotation"}  # fmt: skip
    blocks: list[Block] = [chart_lines(
        stations, turned, "deg", "angle", "Rotation about the tool axis, counted from x of the tool as the job has it, "
        "and leans of the axis along and across the travel where it leans.", 280,
    )]  # fmt: skip
    if choice.changes:
        changes = (f"waypoint {waypoint}: {before} to {after}" for waypoint, before, after in choice.changes)
        blocks.append(f"Configuration changes: {'; '.join(changes)}.")
    if (clearance := plan.clearance) is not None:
        waypoint, contact = clearance.least
        least = format_length(contact.distance) if contact.distance > 0 else "none: they overlap"
        blocks.append(chart_lines(
            stations, {"clearance": 1e3 * clearance.distance}, "mm", "clearance",
            "Distance of arm and tool from part and fixture. "
            f"Least at waypoint {waypoint}: {least}, between {contact.first} and {contact.second}.", 280,
            colours=(AFTER if contact.distance >= clearance.wanted else LIMIT,),
            limit=(1e3 * clearance.wanted, f"wanted {1e3 * clearance.wanted:g} mm"),
        ))  # fmt: skip
    return Section("Posture", blocks, f"How the tool turns along the path, preset {choice.settings.preset!r}.")


def _list_uncertainties(choice: PostureSummary) -> str:
    """Describe the errors assumed for the choice of the posture."""
    if choice.settings.errors is not None:
        return f"posture: chosen for the smallest 95 % band; {choice.settings.errors.source}"
    return (
        f"posture: errors of {100 * ASSUMED.wrench:g} % of the wrench and {100 * ASSUMED.compliance:g} % of "
        "the compliances are assumed"
    )
