"""The page of a plan: what it reaches in a sentence, then the path, the joints, the corrections and the feed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.files.notes import list_remarks
from compplan.report.along_path import (
    FLOOR,
    draw_joints,
    draw_lines,
    draw_shares,
    draw_wrench,
    find_spans,
)
from compplan.report.force_moves import busiest_rate, describe_force
from compplan.report.page import Block, Chart, Column, Fold, Opening, PageTable, Section, TableCell, write_page
from compplan.report.path_scene import describe_magnification, draw_deviation_paths
from compplan.report.plan_view import PlanView
from compplan.report.provenance import describe_grade, describe_robot
from compplan.report.reach_section import show_reach
from compplan.report.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    NEUTRAL,
    format_bound,
    format_length,
    format_number,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.robot import Array

#: Waypoints and stretches that a table lists at most.
LISTED = 40


def write_view(view: PlanView, file: Path, opening: Opening | None = None) -> None:
    """Write the page of a plan.

    Args:
        view: What it shows.
        file: The HTML file.
        opening: Its first screen.
    """
    sections = [
        show_reach(view),
        _deviation(view),
        _joints(view),
        _corrections(view),
        _feed(view),
        *view.extra,
    ]
    facts = [("strategy", view.strategy), ("deviation computed by", view.judge or "–"), *view.facts]
    write_page(
        file,
        view.title,
        describe_plan(view),
        [section for section in sections if section.blocks],
        kind=f"Path plan, {view.robot.name}",
        opening=opening,
        warning=_warn(view),
        notes=list_remarks(view.notes) if opening is not None else view.notes,
        provenance=describe_robot(view.robot, facts, list(view.assumptions)),
    )


def describe_plan(view: PlanView) -> str:
    """Say in a sentence or two what the plan reaches."""
    before, after = (np.linalg.norm(side, axis=1)[view.cut] for side in (view.before, view.after))
    verb = "keeps" if view.status == "solved" else "is a compromise that keeps"
    text = f"{view.verdict} The plan {verb} the loaded tool within {format_bound(float(after.max()))} of the path"
    if before.max() > 0 and view.strategy != "none":
        text += f"; uncorrected it strays up to {format_length(float(before.max()))}"
        ratio = float(before.max() / max(after.max(), 1e-12))
        text += f", {format_number(ratio, 2)} times as far" if 1.5 < ratio < 1e5 else ""
    if view.mismatch is not None:
        wrong = format_length(view.mismatch.max_deviation)
        text += f". Where the robot is not as modelled ({view.mismatch.cell}, assumed) the plan leaves up to {wrong}"
    if view.promise is not None:
        band = format_length(view.promise.whole)
        text += f". Along the whole path the true tip is within {band} with 95\u00a0%"
    if view.inertia > view.tolerance:
        text += f". The inertia of the motion bends the arm by up to {format_length(view.inertia)}, not compensated"
    share = float((after <= view.tolerance).mean())
    within = f"{format_percent(share)} of the cut is within the tolerance of {format_set_length(view.tolerance)}"
    text += f". As modelled, {within}"
    text += f", and the whole path takes {format_set_value(round(float(view.time[-1]), 1))}\u00a0s."
    if view.lowered.any() and not view.notes:
        text += f" The feed is lowered at {view.lowered.sum()} of {view.cut.sum()} waypoints."
    return f"{text} {describe_grade(view.robot)}".strip()


def _warn(view: PlanView) -> str:
    if view.status == "not_confirmed":
        return f"Not confirmed: {'; '.join(view.breaches)}. Not a program to run."
    if view.status != "infeasible":
        return ""
    limits = ", ".join(sorted(set(view.failures.values()))) or "limits"
    count = f"{len(view.failures)} of {len(view.nominal)} waypoints fail ({limits}); " if view.failures else ""
    return f"Infeasible: {count}this is the best compromise, not a program to run."


def _deviation(view: PlanView) -> Section:
    before, after = (np.linalg.norm(side, axis=1) for side in (view.before, view.after))
    names = ("uncorrected", "planned")
    cut = np.flatnonzero(view.cut)
    drawn = draw_deviation_paths(view.nominal[cut], view.before[cut], view.after[cut], names=names)
    magnified = describe_magnification(view.nominal[cut], view.before[cut])
    scene = Chart(
        drawn,
        f"Grey: the wanted path. Coloured: where the loaded tip goes, its deviation {magnified}. Both use one colour "
        "scale, which is logarithmic; turning one turns the other.",
        height=440,
        linked_scenes=True,
        along=True,
    )
    judged = np.where(view.cut, 1.0, np.nan)
    line = draw_lines(
        view.stations,
        {name: 1e3 * np.maximum(size, FLOOR) * judged for name, size in zip(names, (before, after), strict=True)},
        "mm",
        title="deviation",
        colours=(BEFORE, AFTER),
        log=True,
        limit=(1e3 * view.tolerance, f"tolerance {format_set_length(view.tolerance)}"),
    )
    shaded = " Grey bands are rapid moves, which are not compensated." if len(view.stations.shaded) else ""
    marked = " Red bands mark waypoints that fail." if view.failures else ""
    floor = f" What is below {format_bound(0.0)} is drawn there." if after[view.cut].min() < FLOOR else ""
    caption = f"Distance of the loaded tool tip from the path, logarithmic.{floor}{shaded}{marked}"
    fold = Fold("Along the path, logarithmic", [Chart(line, caption, height=340, along=True)])
    blocks: list[Block] = [scene, fold]
    if view.failures:
        blocks.append(_failure_table(view, after))
    return Section("Deviation", blocks, "How far the loaded tool tip is from where the toolpath wants it.")


def _failure_table(view: PlanView, after: Array) -> PageTable:
    failed = np.array(sorted(view.failures))
    reasons = np.array([view.failures[i] for i in failed.tolist()])
    first = np.flatnonzero(np.r_[True, (np.diff(failed) > 1) | (reasons[1:] != reasons[:-1])])
    last = np.r_[first[1:] - 1, len(failed) - 1]
    rows: list[list[TableCell | str | float | int | None]] = []
    for a, b, reason in zip(failed[first].tolist(), failed[last].tolist(), reasons[first].tolist(), strict=True):
        reach = [1e3 * float(view.length[a]), 1e3 * float(view.length[b])]
        rows.append([a, b, *reach, reason, TableCell(1e3 * float(after[a : b + 1].max()), "bad")])
    more = f" The first {LISTED} of {len(rows)} stretches." if len(rows) > LISTED else ""
    columns = [
        Column("from waypoint"), Column("to"), Column("from", "mm", 4), Column("to", "mm", 4),
        Column("stopped by"), Column("deviation left", "mm"),
    ]  # fmt: skip
    return PageTable(columns, rows[:LISTED], f"Waypoints that fail and the limit that stops them.{more}", scroll=12)


def _joints(view: PlanView) -> Section:
    robot = view.robot
    lines = -(-robot.nq // 3)
    figure = draw_joints(view.stations, view.q, robot.lower, robot.upper, robot.joint_names, robot.prismatic)
    return Section(
        "Joints",
        [Chart(figure, "Commanded joint positions; red is beyond the limit.", height=60 + 215 * lines, along=True)],
        "Each chart spans the whole range of its joint.",
    )


def _corrections(view: PlanView) -> Section:
    size = np.linalg.norm(view.correction, axis=1)
    series = {f"d{axis}": 1e3 * view.correction[:, k] for k, axis in enumerate("xyz")} | {"distance": 1e3 * size}
    near = size.max() > 0.5 * view.max_correction
    limit = (1e3 * view.max_correction, f"limit {format_set_length(view.max_correction)}") if near else None
    colours = (*CATEGORIES[:3], NEUTRAL)
    chart = draw_lines(view.stations, series, "mm", title="correction", colours=colours, limit=limit)
    caption = "Commanded (unloaded) tip minus wanted tip, base axes."
    blocks: list[Block] = [Chart(chart, caption, height=320, along=True)]
    if np.abs(view.wrench).max() > 0:
        tall = 440 if np.abs(view.wrench[:, 3:]).max() > 1e-9 else 300
        caption = "Predicted wrench of the environment on the tool at its tip, base axes."
        blocks.append(Chart(draw_wrench(view.stations, view.wrench), caption, height=tall, along=True))
    return Section("Corrections and forces", blocks, describe_force(view.length, view.cut, view.pushed))


def _feed(view: PlanView) -> Section:
    wanted = np.where(view.cut, view.feed_wanted, np.nan)
    series = {"programmed": 1e3 * wanted, "planned": 1e3 * np.where(np.isfinite(wanted), view.feed, np.nan)}
    chart = draw_lines(view.stations, series, "mm/s", title="feed", colours=(BEFORE, AFTER), zero=True)
    blocks: list[Block] = [Chart(chart, "Feed of the tool tip along the cut.", height=280, along=True)]
    rates = {name: (np.abs(values) / limits, view.robot.joint_names) for name, values, limits in view.rates}
    if rates:
        caption = (
            "How much of its limits each joint uses; red is beyond the limit, which lies off the chart where it is far."
        )
        blocks.append(Chart(draw_shares(view.stations, rates), caption, height=60 + 220 * len(rates), along=True))
    clock = draw_lines(view.stations, {"time": view.time}, "s", title="time", zero=True, colours=(NEUTRAL,))
    blocks.append(Fold("Time along the path", [Chart(clock, "", height=240, along=True)]))
    if view.lowered.any():
        blocks.append(_lowered_table(view))
    lede = "The programmed feed holds all along the cut."
    if view.lowered.any():
        lede = view.slow_causes or "The feed is lowered where joint limits need it."
    return Section("Feed and rates", blocks, lede)


def _lowered_table(view: PlanView) -> PageTable:
    spans = find_spans(view.lowered)
    depth = np.array([(view.feed[a : b + 1] / view.feed_wanted[a : b + 1]).min() for a, b in spans])
    rows: list[list[TableCell | str | float | int | None]] = []
    for a, b in spans[np.sort(np.argsort(depth)[:LISTED])]:
        slowest = a + int(np.argmin(view.feed[a : b + 1] / view.feed_wanted[a : b + 1]))
        reach = [1e3 * float(view.length[a]), 1e3 * float(view.length[b])]
        lowest = [1e3 * float(view.feed_wanted[slowest]), 1e3 * float(view.feed[slowest])]
        rows.append([int(a), int(b), *reach, *lowest, busiest_rate(view.rates, view.robot.joint_names, slowest)])
    columns = [
        Column("from waypoint"), Column("to"), Column("from", "mm", 4), Column("to", "mm", 4),
        Column("programmed", "mm/s"), Column("lowest", "mm/s"), Column("busiest there"),
    ]  # fmt: skip
    more = f" The {LISTED} deepest of {len(spans)} stretches." if len(spans) > LISTED else ""
    return PageTable(columns, rows, f"Where the feed is lowered.{more}", scroll=12)
