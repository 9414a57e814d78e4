"""The page of a plan: what it reaches in a sentence, then the path, the joints, the corrections and the feed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compplan.io.notes import list_remarks
from compplan.planning.deflection import describe_bending
from compplan.planning.lost_motion import describe_reversals, list_reversals
from compplan.planning.posture.start import compare_postures
from compplan.planning.slow import describe_causes, mark_slow
from compplan.process.force_models import name_force_model
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
from compplan.reporting.error_band_section import show_error_band
from compplan.reporting.force_moves import busiest_rate, describe_force, list_rates, mark_force
from compplan.reporting.page import Block, Chart, Column, Fold, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.path_scene import describe_magnification, draw_deviation_paths
from compplan.reporting.plan_summary import open_plan
from compplan.reporting.posture_section import list_uncertainties, show_posture
from compplan.reporting.provenance import describe_grade, describe_robot, list_assumptions
from compplan.reporting.reach_section import show_reach
from compplan.reporting.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    NEUTRAL,
    format_bound,
    format_length,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.planning.plan import Plan

#: Waypoints and stretches that a table lists at most.
LISTED = 40


def write_plan_page(plan: Plan, file: Path, extra: Sequence[Section] = ()) -> None:
    """Write the page of a plan.

    Args:
        plan: The plan.
        file: The HTML file; programs that stand beside it are listed with their checksums.
        extra: Further sections, such as the map of postures; they stand last.

    Raises:
        InputError: If the folder cannot be written.
    """
    task = plan.task
    stations = place_stations(task.position, plan.timing.time, task.compensated, plan.command.failures)
    sections = [
        show_reach(plan, stations),
        _deviation(plan, stations),
        _joints(plan, stations),
        _corrections(plan, stations),
        _feed(plan, stations),
    ]
    sections += [] if plan.promise is None else [show_error_band(plan.promise, stations, task.tolerance)]
    assumptions = list_assumptions(plan.job)
    posture_choice = None if task.start is None else task.start.posture_choice
    if posture_choice is not None:
        assumptions.append(list_uncertainties(posture_choice))
        sections.append(show_posture(posture_choice, stations, plan.clearance, _weigh_postures(plan)))
    write_page(
        file,
        plan.name,
        describe_plan(plan),
        [section for section in (*sections, *extra) if section.blocks],
        kind=f"Path plan, {plan.robot.name}",
        opening=open_plan(plan, file.parent),
        warning=_warn(plan),
        notes=list_remarks(plan.notes),
        provenance=describe_robot(plan.robot, _list_facts(plan), assumptions),
    )


def _weigh_postures(plan: Plan) -> tuple[dict[str, float], dict[str, float]] | None:
    """Measure the posture beside the plain one."""
    if plan.job is None or plan.task.start is None or plan.robot.nq < 6:
        return None
    return compare_postures(plan.robot, plan.task.start, plan.job.tool_x_base)


def _list_facts(plan: Plan) -> list[tuple[str, str]]:
    facts = [("strategy", plan.strategy), ("solved by", plan.solved_by), ("deviation computed by", plan.judge)]
    if plan.job is not None and plan.job.file.is_file():
        facts.append(("job", str(plan.job.file)))
    if plan.job is not None:
        facts.append(("force model", name_force_model(plan.job.process.model)))
    facts.append(("toolpath", plan.task.nominal.source or "given in memory"))
    words = ", ".join(f"{name} {word}" for name, word in plan.task.configuration.items())
    if words:
        facts.append(("configuration", words))
    facts.append(("axes turn back", describe_reversals(list_reversals(plan.task, plan.q))))
    facts.append(("rotation about the tool axis", "free" if plan.task.spin_free else "fixed by the job"))
    facts.append(("time in the solver", f"{plan.command.solve_time:.3g} s"))
    return facts


def describe_plan(plan: Plan) -> list[str]:
    """Say in a few sentences what the plan reaches."""
    before, after = plan.before.max_deviation, plan.after.max_deviation
    tolerance = plan.task.tolerance
    verb = "keeps" if plan.status == "solved" else "is a compromise that keeps"
    model = f"If the robot is as modelled, the plan {verb} the loaded tool within {format_bound(after)} of the path"
    if before > 0 and plan.strategy != "none":
        model += f"; uncorrected it strays up to {format_length(before)}"
    within = format_percent(plan.after.share_within(tolerance))
    left = format_length(plan.mismatch.max_deviation)
    said = [
        plan.verdict.sentence,
        f"{model}. {within} of the cut is then within the tolerance of {format_set_length(tolerance)}.",
        f"If it is not ({plan.mismatch.cell}, assumed), up to {left} is left.",
    ]
    told = describe_bending(plan.bending)
    said.append(f"{told[0].upper()}{told[1:]}.")
    lowered = ""
    if not plan.notes and (slow := mark_slow(plan.task, plan.timing)).any():
        lowered = f" The feed is lowered at {slow.sum()} of {plan.after.cut.sum()} waypoints."
    said.append(f"The path takes {format_set_value(round(float(plan.timing.time[-1]), 1))}\u00a0s.{lowered}")
    return [*said, describe_grade(plan.robot)]


def _warn(plan: Plan) -> str:
    if plan.status == "not_confirmed":
        return f"Not confirmed: {'; '.join(plan.breaches)}. Not a program to run."
    if plan.status != "infeasible":
        return ""
    failures = plan.command.failures
    limits = ", ".join(sorted(set(failures.values()))) or "limits"
    count = f"{len(failures)} of {len(plan.task)} waypoints fail ({limits}); " if failures else ""
    return f"Infeasible: {count}this is the best compromise, not a program to run."


def _deviation(plan: Plan, stations: Stations) -> Section:
    before, after = (side.distance for side in (plan.before, plan.after))
    names = ("uncorrected", "planned")
    cut = np.flatnonzero(plan.after.cut)
    path, off = plan.task.position[cut], plan.before.deviation[cut]
    drawn = draw_deviation_paths(path, off, plan.after.deviation[cut], names=names)
    magnified = describe_magnification(path, off)
    scene = Chart(
        drawn,
        f"Grey: the wanted path. Coloured: where the loaded tip goes, its deviation {magnified}. Both use one colour "
        "scale, which is logarithmic; turning one turns the other.",
        height=440,
        linked_scenes=True,
        along=True,
    )
    evaluated = np.where(plan.after.cut, 1.0, np.nan)
    line = draw_lines(
        stations,
        {name: 1e3 * np.maximum(size, FLOOR) * evaluated for name, size in zip(names, (before, after), strict=True)},
        "mm",
        title="deviation",
        colours=(BEFORE, AFTER),
        log=True,
        limit=(1e3 * plan.task.tolerance, f"tolerance {format_set_length(plan.task.tolerance)}"),
    )
    shaded = " Grey bands are rapid moves, which are not compensated." if len(stations.shaded) else ""
    marked = " Red bands mark waypoints that fail." if plan.command.failures else ""
    floor = f" What is below {format_bound(0.0)} is drawn there." if after[cut].min() < FLOOR else ""
    caption = f"Distance of the loaded tool tip from the path, logarithmic.{floor}{shaded}{marked}"
    fold = Fold("Along the path, logarithmic", [Chart(line, caption, height=340, along=True)])
    blocks: list[Block] = [scene, fold]
    if plan.command.failures:
        blocks.append(_failure_table(plan, after))
    return Section("Deviation", blocks, "How far the loaded tool tip is from where the toolpath wants it.")


def _failure_table(plan: Plan, after: Array) -> PageTable:
    failures, length = plan.command.failures, plan.task.nominal.arc_length
    failed = np.array(sorted(failures))
    reasons = np.array([failures[i] for i in failed.tolist()])
    first = np.flatnonzero(np.r_[True, (np.diff(failed) > 1) | (reasons[1:] != reasons[:-1])])
    last = np.r_[first[1:] - 1, len(failed) - 1]
    rows: list[Row] = []
    for a, b, reason in zip(failed[first].tolist(), failed[last].tolist(), reasons[first].tolist(), strict=True):
        reach = [1e3 * float(length[a]), 1e3 * float(length[b])]
        rows.append([a, b, *reach, reason, TableCell(1e3 * float(after[a : b + 1].max()), "bad")])
    more = f" The first {LISTED} of {len(rows)} stretches." if len(rows) > LISTED else ""
    columns = [
        Column("from waypoint"), Column("to"), Column("from", "mm", 4), Column("to", "mm", 4),
        Column("stopped by"), Column("deviation left", "mm"),
    ]  # fmt: skip
    return PageTable(columns, rows[:LISTED], f"Waypoints that fail and the limit that stops them.{more}", scroll=12)


def _joints(plan: Plan, stations: Stations) -> Section:
    robot = plan.robot
    lines = -(-robot.nq // 3)
    figure = draw_joints(stations, plan.q, robot.lower, robot.upper, robot.joint_names, robot.prismatic)
    return Section(
        "Joints",
        [Chart(figure, "Commanded joint positions; red is beyond the limit.", height=60 + 215 * lines, along=True)],
        "Each chart spans the whole range of its joint.",
    )


def _corrections(plan: Plan, stations: Stations) -> Section:
    size = np.linalg.norm(plan.correction, axis=1)
    series = {f"d{axis}": 1e3 * plan.correction[:, k] for k, axis in enumerate("xyz")} | {"distance": 1e3 * size}
    near = size.max() > 0.5 * plan.task.max_correction
    limit = (1e3 * plan.task.max_correction, f"limit {format_set_length(plan.task.max_correction)}") if near else None
    colours = (*CATEGORIES[:3], NEUTRAL)
    chart = draw_lines(stations, series, "mm", title="correction", colours=colours, limit=limit)
    caption = "Commanded (unloaded) tip minus wanted tip, base axes."
    blocks: list[Block] = [Chart(chart, caption, height=320, along=True)]
    if np.abs(plan.task.wrench).max() > 0:
        tall = 440 if np.abs(plan.task.wrench[:, 3:]).max() > 1e-9 else 300
        caption = "Predicted wrench of the environment on the tool at its tip, base axes."
        blocks.append(Chart(draw_wrench(stations, plan.task.wrench), caption, height=tall, along=True))
    cut = plan.after.cut
    told = describe_force(plan.task.nominal.arc_length, cut, mark_force(plan.task.wrench, cut))
    return Section("Corrections and forces", blocks, told)


def _feed(plan: Plan, stations: Stations) -> Section:
    wanted = np.where(plan.task.compensated & ~plan.task.nominal.rapid, plan.task.nominal.feed, np.nan)
    series = {"programmed": 1e3 * wanted, "planned": 1e3 * np.where(np.isfinite(wanted), plan.timing.feed, np.nan)}
    chart = draw_lines(stations, series, "mm/s", title="feed", colours=(BEFORE, AFTER), zero=True)
    blocks: list[Block] = [Chart(chart, "Feed of the tool tip along the cut.", height=280, along=True)]
    rates = list_rates(plan.task, plan.timing)
    if rates:
        shares = {name: (np.abs(values) / limits, plan.robot.joint_names) for name, values, limits in rates}
        caption = (
            "How much of its limits each joint uses; red is beyond the limit, which lies off the chart where it is far."
        )
        blocks.append(Chart(draw_shares(stations, shares), caption, height=60 + 220 * len(rates), along=True))
    clock = draw_lines(stations, {"time": plan.timing.time}, "s", title="time", zero=True, colours=(NEUTRAL,))
    blocks.append(Fold("Time along the path", [Chart(clock, "", height=240, along=True)]))
    slow = mark_slow(plan.task, plan.timing)
    if slow.any():
        blocks.append(_lowered_table(plan, slow, rates))
    lede = describe_causes(plan.task, plan.timing) or "The programmed feed holds all along the cut."
    return Section("Feed and rates", blocks, lede)


def _lowered_table(plan: Plan, slow: NDArray[np.bool_], rates: Sequence[tuple[str, Array, Array]]) -> PageTable:
    length, wanted, feed = plan.task.nominal.arc_length, plan.task.nominal.feed, plan.timing.feed
    spans = find_spans(slow)
    share = feed / np.maximum(wanted, 1e-12)
    depth = np.array([share[a : b + 1].min() for a, b in spans])
    rows: list[Row] = []
    for a, b in spans[np.sort(np.argsort(depth)[:LISTED])]:
        slowest = a + int(np.argmin(share[a : b + 1]))
        numbers = [1e3 * float(value) for value in (length[a], length[b], wanted[slowest], feed[slowest])]
        rows.append([int(a), int(b), *numbers, busiest_rate(rates, plan.robot.joint_names, slowest)])
    columns = [
        Column("from waypoint"), Column("to"), Column("from", "mm", 4), Column("to", "mm", 4),
        Column("programmed", "mm/s"), Column("lowest", "mm/s"), Column("busiest there"),
    ]  # fmt: skip
    more = f" The {LISTED} deepest of {len(spans)} stretches." if len(spans) > LISTED else ""
    return PageTable(columns, rows, f"Where the feed is lowered.{more}", scroll=12)
