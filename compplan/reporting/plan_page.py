"""The page of a plan: what it reaches in a sentence, then the path, the joints, the corrections and the feed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compplan.io.notes import list_remarks
from compplan.io.palette import AFTER, BEFORE, CATEGORIES, NEUTRAL
from compplan.io.quantities import (
    format_angle,
    format_bound,
    format_length,
    format_number,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.io.tables import write_text
from compplan.planning.deflection import describe_bending
from compplan.planning.lost_motion import describe_reversals
from compplan.planning.notes import describe_causes, mark_slow
from compplan.planning.tolerance_verdict import describe_tolerance
from compplan.process.force_models import name_force_model
from compplan.reporting import page
from compplan.reporting.along_path import (
    FLOOR,
    Stations,
    draw_joints,
    draw_lines,
    draw_shares,
    draw_wrench,
    find_spans,
    place_stations,
)
from compplan.reporting.charts import add_area
from compplan.reporting.error_band_section import show_error_band
from compplan.reporting.force_moves import busiest_rate, describe_force, list_rates, mark_force
from compplan.reporting.plan_summary import describe_clearance, describe_margin, open_plan
from compplan.reporting.posture_section import list_uncertainties, show_extra_axis, show_posture
from compplan.reporting.provenance import describe_grade, describe_robot, list_assumptions
from compplan.reporting.scenes import describe_magnification, draw_cell, draw_deviation_paths, place_meshes
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: Waypoints and stretches that a table lists at most.
LISTED = 40
#: Name of the band in the chart of what a plan reaches.
BAND = "true tip, 95 %"


def write_plan_page(plan: Plan, file: Path) -> None:
    """Write the page of a plan; programs that stand beside the file are listed with their checksums.

    Raises:
        InputError: If the folder cannot be written.
    """
    task = plan.task
    stations = place_stations(task.position, plan.timing.time, task.compensated, plan.command.failures)
    sections = [
        _show_reach(plan, stations), _show_deviation(plan, stations), _show_joints(plan, stations),
        _show_corrections(plan, stations), _show_feed(plan, stations),
    ]  # fmt: skip
    sections += [] if plan.promise is None else [show_error_band(plan.promise, stations, task.tolerance)]
    assumptions = list_assumptions(plan.job)
    choice = None if task.start is None else task.start.posture_choice
    if choice is not None:
        assumptions.append(list_uncertainties(choice))
        sections += [show_posture(plan, choice, stations), *show_extra_axis(plan.robot, choice)]
    html = page.render_page(
        plan.name, describe_plan(plan), sections, kind=f"Path plan, {plan.robot.name}",
        opening=open_plan(plan, file.parent), warning=_warn(plan), notes=list_remarks(plan.notes),
        provenance=describe_robot(plan.robot, _list_facts(plan), assumptions),
    )  # fmt: skip
    write_text(file, html)


def _list_facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("strategy", plan.strategy), ("solved by", plan.solved_by), ("deviation computed by", plan.judge)]
    if plan.job is not None and plan.job.file.is_file():
        facts.append(("job", str(plan.job.file)))
    if plan.job is not None:
        facts.append(("force model", name_force_model(plan.job.process.model)))
    facts.append(("toolpath", plan.task.nominal.source or "given in memory"))
    words = ", ".join(f"{name} {word}" for name, word in plan.task.configuration.items())
    return [
        *facts, *([("configuration", words)] if words else []),
        ("axes turn back", describe_reversals(plan.reversals)),
        ("rotation about the tool axis", "free" if plan.task.spin_free else "fixed by the job"),
        ("time in the solver", f"{plan.command.solve_time:.3g} s"),
    ]  # fmt: skip


def describe_plan(plan: Plan) -> list[str]:
    """Say in a few sentences what the plan reaches."""
    before, after = plan.before.max_deviation, plan.after.max_deviation
    tolerance = plan.task.tolerance
    verb = "keeps" if plan.status == "solved" else "is a compromise that keeps"
    model = f"If the robot is as modelled, the plan {verb} the loaded tool within {format_bound(after)} of the path"
    if before > 0 and plan.strategy != "none":
        model += f"; uncorrected it strays up to {format_length(before)}"
    within = format_percent(plan.after.share_within(tolerance))
    left, bending = format_length(plan.mismatch.max_deviation), describe_bending(plan.bending)
    lowered = ""
    if not plan.notes and (slow := mark_slow(plan.task, plan.timing)).any():
        lowered = f" The feed is lowered at {slow.sum()} of {plan.after.cut.sum()} waypoints."
    return [
        plan.verdict.sentence,
        f"{model}. {within} of the cut is then within the tolerance of {format_set_length(tolerance)}.",
        f"If it is not ({plan.mismatch.cell}, assumed), up to {left} is left.",
        f"{bending[0].upper()}{bending[1:]}.",
        f"The path takes {format_set_value(round(float(plan.timing.time[-1]), 1))}\u00a0s.{lowered}",
        describe_grade(plan.robot),
    ]


def _warn(plan: Plan) -> str:
    if plan.status == "not_confirmed":
        return f"Not confirmed: {'; '.join(plan.breaches)}. Not a program to run."
    if plan.status != "infeasible":
        return ""
    failures = plan.command.failures
    limits = ", ".join(sorted(set(failures.values()))) or "limits"
    count = f"{len(failures)} of {len(plan.task)} waypoints fail ({limits}); " if failures else ""
    return f"Infeasible: {count}this is the best compromise, not a program to run."


def _show_reach(plan: Plan, stations: Stations) -> page.Section:
    """Show the band along the path, the figures and the robot in its cell."""
    cut = plan.after.cut
    kinds = np.where(mark_force(plan.task.wrench, cut), 0, np.where(cut, 1, 2))
    start = int(np.flatnonzero(cut)[0])
    scene = None if plan.task.start is None else plan.task.start.settings.scene
    around = [] if scene is None else place_meshes(plan.robot, plan.q[start], scene.meshes)
    named = ", ".join(shape.link for shape in around)
    with_them = f", with the meshes that the job names ({named})" if named else ""
    cell = page.Chart(
        draw_cell(plan.robot, plan.q, plan.task.position, start=start, around=around, kinds=kinds),
        f"The robot at the first waypoint of the cut, drawn from its URDF shapes{with_them}, and the path of the tool "
        "tip: which moves carry force, which are in the cut without, and which are rapid.",
        height=400, along=True,
    )  # fmt: skip
    columns = page.Columns([[_list_figures(plan)], [cell]], (0.5, 0.5))
    return page.Section("What it reaches", [_draw_band(plan, stations), columns])


def _draw_band(plan: Plan, stations: Stations) -> page.Chart:
    """Show how far the true tip may be from the path, against the tolerance."""
    evaluated = np.where(plan.after.cut, 1e3, np.nan)
    tolerance, cell = 1e3 * plan.task.tolerance, plan.mismatch.cell
    series = {"as modelled": plan.after.distance * evaluated, cell: plan.mismatch.distance * evaluated}
    said = "Distance of the loaded tool tip from the path. As modelled: what the plan leaves if the model is the truth."
    said += f" {cell.capitalize()}: what it leaves if all of them are wrong by that much (assumed)."
    if plan.promise is not None:
        series = {BAND: plan.promise.along * evaluated, **series}
        said = f"Shaded: where the true tip is with 95 %, by what is known of robot and force. {said}"
    shown = max(1.25 * tolerance, *(1.08 * float(np.nanmax(values)) for values in series.values()))
    uncorrected = plan.before.distance * evaluated
    most = float(np.nanmax(uncorrected))
    if most < 3 * shown:
        series["uncorrected"], shown = uncorrected, max(shown, 1.08 * most)
    else:
        said += f" Uncorrected lies off the chart, up to {format_length(1e-3 * most)}."
    limit: tuple[float, str] | None = (tolerance, f"tolerance {format_set_length(plan.task.tolerance)}")
    if plan.task.allowed is not None:
        limit, series["tolerance here"] = None, plan.task.allowed.normal * evaluated
        shown = max(shown, 1.08 * float(np.nanmax(series["tolerance here"])))
        said += " The tolerance is that of each part, across the travel where it counts apart."
    known = {BAND: NEUTRAL, "as modelled": AFTER, "uncorrected": BEFORE}
    colours = [known.get(name, CATEGORIES[3]) for name in series]
    figure = draw_lines(stations, series, "mm", title="deviation", limit=limit, zero=True, colours=colours)
    figure.axis("y", range=[0.0, shown])
    if plan.promise is not None:
        line, colour = figure.data[0], "rgba(127, 127, 127, 0.35)"
        add_area(figure, line["x"], line["y"], BAND, colour, showlegend=False, legendgroup=BAND)
        figure.data.insert(0, figure.data.pop())
    return page.Chart(figure, said, height=340, along=True)


def _list_figures(plan: Plan) -> page.DataTable:
    """Return the figures of the plan, uncorrected and planned."""
    task, sides, between, bending = plan.task, (plan.before, plan.after), plan.between, plan.bending
    names = {"rms": "deviation, rms", "mean": "deviation, mean", "max": "deviation, largest"}
    both = {words: [format_length(1e-3 * side.figures[name]) for side in sides] for name, words in names.items()}
    uses = [task.use_tolerance(side.deviation)[side.cut] for side in sides]
    within = format_set_length(task.tolerance) if task.allowed is None else describe_tolerance(task)
    both[f"within {within}"] = [format_percent(float((use <= 1.0).mean())) for use in uses]
    if task.allowed is not None:
        both["worst, in shares of its tolerance"] = [format_percent(float(use.max())) for use in uses]
    both["tool axis off by up to"] = [format_angle(side.max_tilt) for side in sides]
    ways = {"joints linear": between.joint, "tip linear": between.cartesian, "spline": between.spline}
    planned = {f"between waypoints, {way}": format_length(float(m.max(initial=0.0))) for way, m in ways.items()}
    if plan.executed is not None:
        drives = "drives as identified" if plan.executed.known else "drives not known"
        way = "programs" if plan.executed.zone else "waypoints"
        planned[f"as the controller executes the {way}, {drives}"] = format_length(plan.executed.most)
    planned[f"largest, {plan.mismatch.cell}"] = format_length(plan.mismatch.max_deviation)
    allowed = format_set_length(task.max_correction)
    planned["largest correction"] = f"{format_length(plan.margins.max_correction)} of {allowed}"
    planned["smallest joint margin"] = describe_margin(plan)
    for name, rates, limits in list_rates(task, plan.timing):
        share = np.abs(rates) / limits
        joint = plan.robot.joint_names[int(np.argmax(share.max(axis=0)))]
        planned[f"{name} used"] = f"{format_percent(float(share.max()))} ({joint})"
    if plan.promise is not None:
        planned["true tip within, with 95\u00a0%"] = format_length(plan.promise.whole)
    assumed = " (assumed masses)" if "assumed" in bending.masses else ""
    planned |= {"bent by the process": format_length(bending.process), "bent by weight": format_length(bending.weight)}
    if np.isfinite(bending.inertia):
        word = "compensated" if bending.compensated else "not compensated"
        planned[f"bent by inertia, {word}{assumed}"] = format_length(bending.inertia)
    if np.isfinite(bending.frequencies).all():
        rings = ", ".join(f"{frequency:.3g}" for frequency in bending.frequencies)
        planned[f"lowest natural frequencies{assumed}"] = f"{rings}\u00a0Hz"
    if clearance := describe_clearance(plan):
        planned["least clearance"] = clearance
    length = format_number(1e3 * float(task.nominal.arc_length[-1]), 4)
    planned["path"] = f"{length} mm in {format_number(len(task))} waypoints"
    planned["time"] = f"{format_number(float(plan.timing.time[-1]), 4)} s"
    rows: list[page.Row] = [[words, *values] for words, values in both.items()]
    return page.DataTable(
        ["", "uncorrected", "planned"], [*rows, *([words, None, value] for words, value in planned.items())]
    )


def _show_deviation(plan: Plan, stations: Stations) -> page.Section:
    before, after = (side.distance for side in (plan.before, plan.after))
    names, cut = ("uncorrected", "planned"), np.flatnonzero(plan.after.cut)
    path, off = plan.task.position[cut], plan.before.deviation[cut]
    scene = page.Chart(
        draw_deviation_paths(path, off, plan.after.deviation[cut], names=names),
        "Grey: the wanted path. Coloured: where the loaded tip goes, its deviation "
        f"{describe_magnification(path, off)}. Both use one colour scale, which is logarithmic; turning one turns the "
        "other.",
        height=440, linked_scenes=True, along=True,
    )  # fmt: skip
    evaluated = np.where(plan.after.cut, 1e3, np.nan)
    series = {name: np.maximum(size, FLOOR) * evaluated for name, size in zip(names, (before, after), strict=True)}
    limit = (1e3 * plan.task.tolerance, f"tolerance {format_set_length(plan.task.tolerance)}")
    line = draw_lines(stations, series, "mm", title="deviation", colours=(BEFORE, AFTER), log=True, limit=limit)
    shaded = " Grey bands are rapid moves, which are not compensated." if len(stations.shaded) else ""
    marked = " Red bands mark waypoints that fail." if plan.command.failures else ""
    floor = f" What is below {format_bound(0.0)} is drawn there." if after[cut].min() < FLOOR else ""
    caption = f"Distance of the loaded tool tip from the path, logarithmic.{floor}{shaded}{marked}"
    fold = page.Fold("Along the path, logarithmic", [page.Chart(line, caption, height=340, along=True)])
    failed = [_list_failures(plan, after)] if plan.command.failures else []
    about = "Distance of the loaded tool tip from the toolpath."
    return page.Section("Deviation", [scene, fold, *failed], about)


def _list_failures(plan: Plan, after: Array) -> page.DataTable:
    failures, length = plan.command.failures, plan.task.nominal.arc_length
    failed = np.array(sorted(failures))
    reasons = np.array([failures[i] for i in failed.tolist()])
    first = np.flatnonzero(np.r_[True, (np.diff(failed) > 1) | (reasons[1:] != reasons[:-1])])
    last = np.r_[first[1:] - 1, len(failed) - 1]
    rows: list[page.Row] = []
    for a, b, reason in zip(failed[first].tolist(), failed[last].tolist(), reasons[first].tolist(), strict=True):
        reach = [1e3 * float(length[a]), 1e3 * float(length[b])]
        rows.append([a, b, *reach, reason, page.Cell(1e3 * float(after[a : b + 1].max()), "bad")])
    more = f" The first {LISTED} of {len(rows)} stretches." if len(rows) > LISTED else ""
    columns = ["from waypoint", "to", "from [mm, 4]", "to [mm, 4]", "stopped by",
               "deviation left [mm]"]  # fmt: skip
    return page.DataTable(
        columns, rows[:LISTED], f"Waypoints that fail and the limit that stops them.{more}", scroll=12
    )


def _show_joints(plan: Plan, stations: Stations) -> page.Section:
    robot = plan.robot
    figure = draw_joints(stations, plan.q, robot.lower, robot.upper, robot.joint_names, robot.prismatic)
    caption, height = "Commanded joint positions; red is beyond the limit.", 60 + 215 * -(-robot.nq // 3)
    chart = page.Chart(figure, caption, height, along=True)
    return page.Section("Joints", [chart], "Each chart spans the whole range of its joint.")


def _show_corrections(plan: Plan, stations: Stations) -> page.Section:
    size, task = np.linalg.norm(plan.correction, axis=1), plan.task
    series = {f"d{axis}": 1e3 * plan.correction[:, k] for k, axis in enumerate("xyz")} | {"distance": 1e3 * size}
    near = size.max() > 0.5 * task.max_correction
    limit = (1e3 * task.max_correction, f"limit {format_set_length(task.max_correction)}") if near else None
    colours = (*CATEGORIES[:3], NEUTRAL)
    chart = draw_lines(stations, series, "mm", title="correction", colours=colours, limit=limit)
    caption = "Commanded (unloaded) tip minus wanted tip, base axes."
    blocks: list[page.Block] = [page.Chart(chart, caption, height=320, along=True)]
    if np.abs(task.wrench).max() > 0:
        tall = 440 if np.abs(task.wrench[:, 3:]).max() > 1e-9 else 300
        caption = "Predicted wrench of the environment on the tool at its tip, base axes."
        blocks.append(page.Chart(draw_wrench(stations, task.wrench), caption, height=tall, along=True))
    cut = plan.after.cut
    about = describe_force(task.nominal.arc_length, cut, mark_force(task.wrench, cut))
    return page.Section("Corrections and forces", blocks, about)


def _show_feed(plan: Plan, stations: Stations) -> page.Section:
    wanted = np.where(plan.task.compensated & ~plan.task.nominal.rapid, plan.task.nominal.feed, np.nan)
    series = {"programmed": 1e3 * wanted, "planned": 1e3 * np.where(np.isfinite(wanted), plan.timing.feed, np.nan)}
    chart = draw_lines(stations, series, "mm/s", title="feed", colours=(BEFORE, AFTER), zero=True)
    blocks: list[page.Block] = [page.Chart(chart, "Feed of the tool tip along the cut.", height=280, along=True)]
    rates = list_rates(plan.task, plan.timing)
    if rates:
        shares = {name: (np.abs(values) / limits, plan.robot.joint_names) for name, values, limits in rates}
        caption = (
            "How much of its limits each joint uses; red is beyond the limit, which lies off the chart where it is far."
        )
        blocks.append(page.Chart(draw_shares(stations, shares), caption, height=60 + 220 * len(rates), along=True))
    slow = mark_slow(plan.task, plan.timing)
    if slow.any():
        blocks.append(_list_lowered(plan, slow, rates))
    lede = describe_causes(plan.task, plan.timing) or "The programmed feed holds all along the cut."
    return page.Section("Feed and rates", blocks, lede)


def _list_lowered(plan: Plan, slow: NDArray[np.bool_], rates: Sequence[tuple[str, Array, Array]]) -> page.DataTable:
    length, wanted, feed = plan.task.nominal.arc_length, plan.task.nominal.feed, plan.timing.feed
    spans = find_spans(slow)
    share = feed / np.maximum(wanted, 1e-12)
    depth = np.array([share[a : b + 1].min() for a, b in spans])
    rows: list[page.Row] = []
    for a, b in spans[np.sort(np.argsort(depth)[:LISTED])]:
        slowest = a + int(np.argmin(share[a : b + 1]))
        numbers = [1e3 * float(value) for value in (length[a], length[b], wanted[slowest], feed[slowest])]
        rows.append([int(a), int(b), *numbers, busiest_rate(rates, plan.robot.joint_names, slowest)])
    columns = ["from waypoint", "to", "from [mm, 4]", "to [mm, 4]", "programmed [mm/s]",
               "lowest [mm/s]", "busiest there"]  # fmt: skip
    more = f" The {LISTED} deepest of {len(spans)} stretches." if len(spans) > LISTED else ""
    return page.DataTable(columns, rows, f"Where the feed is lowered.{more}", scroll=12)
