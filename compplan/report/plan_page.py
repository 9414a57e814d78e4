"""The page of a plan: what it reaches in a sentence, then the path, the joints, the corrections and the feed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.plan.evaluate import Mismatch
from compplan.report.along_path import (
    FLOOR,
    Stations,
    draw_joints,
    draw_lines,
    draw_shares,
    draw_wrench,
    find_spans,
)
from compplan.report.force_moves import busiest_rate, mark_force, tell_force
from compplan.report.page import Block, Chart, Column, Columns, Fold, PageTable, Section, TableCell, write_page
from compplan.report.path_scene import describe_magnification, draw_cell, draw_deviation_paths
from compplan.report.provenance import describe_grade, describe_robot
from compplan.report.robot_scene import Shape
from compplan.report.style import (
    AFTER,
    BEFORE,
    CATEGORIES,
    format_angle,
    format_bound,
    format_length,
    format_number,
    format_percent,
    format_set_value,
)
from compplan.robot import Array, Robot

#: The feed counts as lowered below this share of the programmed one.
LOWERED = 0.995
#: Waypoints and stretches that a table lists at most.
LISTED = 40


@dataclass(frozen=True)
class PlanView:
    """What the page of a plan shows, waypoint by waypoint; n waypoints, nq joints, base frame.

    Attributes:
        title: Name of the job.
        robot: The robot, with the tool that the job mounts.
        strategy: How the corrections were found.
        status: "solved" or "infeasible".
        nominal: Wanted tool tip. Shape (n, 3). [m]
        rapid: Moves that are not compensated. Shape (n,).
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time of each waypoint. Shape (n,). [s]
        before: Deviation of the tip without correction. Shape (n, 3). [m]
        after: Deviation of the tip as planned. Shape (n, 3). [m]
        mismatch: What the plan leaves in a cell that differs from the model, or None.
        tilt_before: Angle between wanted and attained tool axis without correction, or None. Shape (n,). [rad]
        tilt_after: The same as planned, or None. Shape (n,). [rad]
        correction: Unloaded tip of the command minus nominal. Shape (n, 3). [m]
        wrench: Predicted wrench of the environment on the tool at the tip. Shape (n, 6). [N, N m]
        velocity: Joint velocities. Shape (n, nq). [rad/s or m/s]
        acceleration: Joint accelerations. Shape (n, nq). [rad/s^2 or m/s^2]
        feed_wanted: Programmed feed; NaN where there is none. Shape (n,). [m/s]
        feed: Feed as planned. Shape (n,). [m/s]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        max_correction: Greatest correction allowed. [m]
        velocity_limits: Limits that the plan kept; the robot's if left out. Shape (nq,). [rad/s or m/s]
        acceleration_limits: The same. Shape (nq,). [rad/s^2 or m/s^2]
        slowed: Waypoints whose feed had to be lowered; found from the feeds if left out. Shape (n,).
        failures: Waypoints that fail, each with the limit that stops it.
        breaches: What keeps the judge from confirming the plan, one sentence each.
        bending: Further rows of figures: name and value.
        between: Greatest distance of the loaded tip from the path between waypoints, by the way a controller goes. [m]
        judge: Who computed the deviations.
        uncoupled: Root mean square and greatest uncorrected distance if the force did not ask where the tool is, or
            None where it does not. [m]
        facts: Rows of name and value for the foot of the page.
        notes: Warnings of the plan, one sentence each.
        assumptions: What was assumed, one sentence each.
        extra: Further sections, such as the map of postures.
        around: Part, fixture and tool where their meshes are known, as they stand at the first waypoint of the cut.
    """

    title: str
    robot: Robot
    strategy: str
    status: str
    nominal: Array
    rapid: NDArray[np.bool_]
    q: Array
    time: Array
    before: Array
    after: Array
    correction: Array
    wrench: Array
    velocity: Array
    acceleration: Array
    feed_wanted: Array
    feed: Array
    tolerance: float
    max_correction: float
    velocity_limits: Array | None = None
    acceleration_limits: Array | None = None
    slowed: NDArray[np.bool_] | None = None
    mismatch: Mismatch | None = None
    tilt_before: Array | None = None
    tilt_after: Array | None = None
    failures: Mapping[int, str] = field(default_factory=dict)
    breaches: Sequence[str] = ()
    between: Mapping[str, float] = field(default_factory=dict)
    bending: Mapping[str, str] = field(default_factory=dict)
    judge: str = ""
    uncoupled: tuple[float, float] | None = None
    facts: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    assumptions: Sequence[str] = ()
    extra: Sequence[Section] = ()
    around: Sequence[Shape] = ()

    @property
    def start(self) -> int:
        """The first waypoint of the cut."""
        return int(np.flatnonzero(self.cut)[0])

    @cached_property
    def pushed(self) -> NDArray[np.bool_]:
        """Moves of the cut that carry force, by the waypoint that they end at. Shape (n,)."""
        return mark_force(self.wrench, self.cut)

    @cached_property
    def cut(self) -> NDArray[np.bool_]:
        """Waypoints that are compensated and judged. Shape (n,)."""
        return ~self.rapid if (~self.rapid).any() else np.ones(len(self.rapid), bool)

    @cached_property
    def length(self) -> Array:
        """Path length up to each waypoint, rapid moves included [m]. Shape (n,)."""
        steps = np.linalg.norm(np.diff(self.nominal, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def stations(self) -> Stations:
        """Where the waypoints are, for the charts."""
        spans = find_spans(self.rapid)
        spans = np.column_stack([np.maximum(spans[:, 0] - 1, 0), spans[:, 1]]).astype(int)
        return Stations(self.length, self.time, np.array(sorted(self.failures), int), self.length[spans].reshape(-1, 2))

    @cached_property
    def lowered(self) -> NDArray[np.bool_]:
        """Waypoints whose feed had to be lowered. Shape (n,)."""
        return self.cut & (self.feed < LOWERED * self.feed_wanted if self.slowed is None else self.slowed)


def write_view(view: PlanView, file: Path) -> None:
    """Write the page of a plan.

    Args:
        view: What it shows.
        file: The HTML file.
    """
    sections = [
        _overview(view),
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
        summarise_plan(view),
        [section for section in sections if section.blocks],
        kind=f"Path plan, {view.robot.name}",
        warning=_warn(view),
        notes=view.notes,
        provenance=describe_robot(view.robot, facts, list(view.assumptions)),
    )


def summarise_plan(view: PlanView) -> str:
    """Say in a sentence or two what the plan reaches."""
    before, after = (np.linalg.norm(side, axis=1)[view.cut] for side in (view.before, view.after))
    verb = "keeps" if view.status == "solved" else "is a compromise that keeps"
    text = f"The plan {verb} the loaded tool within {format_bound(float(after.max()))} of the path"
    if before.max() > 0 and view.strategy != "none":
        text += f"; uncorrected it strays up to {format_length(float(before.max()))}"
        ratio = float(before.max() / max(after.max(), 1e-12))
        text += f", {format_number(ratio, 2)} times as far" if 1.5 < ratio < 1e5 else ""
    if view.mismatch is not None:
        wrong = format_length(view.mismatch.max_deviation)
        text += f". Where the robot is not as modelled ({view.mismatch.cell}, assumed) the plan leaves up to {wrong}"
    share = float((after <= view.tolerance).mean())
    text += (
        f". As modelled, {format_percent(share)} of the cut is within the tolerance of {_set_length(view.tolerance)}"
    )
    text += f", and the whole path takes {format_set_value(round(float(view.time[-1]), 1))}\u00a0s."
    if view.lowered.any() and not view.notes:
        text += f" The feed is lowered at {view.lowered.sum()} of {view.cut.sum()} waypoints."
    return f"{text} {describe_grade(view.robot)}"


def _warn(view: PlanView) -> str:
    if view.status == "not_confirmed":
        return f"Not confirmed: {'; '.join(view.breaches)}. Not a program to run."
    if view.status != "infeasible":
        return ""
    limits = ", ".join(sorted(set(view.failures.values()))) or "limits"
    count = f"{len(view.failures)} of {len(view.nominal)} waypoints fail ({limits}); " if view.failures else ""
    return f"Infeasible: {count}this is the best compromise, not a program to run."


def _set_length(metres: float) -> str:
    return f"{format_set_value(1e3 * metres)}\u00a0mm"


def _overview(view: PlanView) -> Section:
    kinds = np.where(view.pushed, 0, np.where(view.cut, 1, 2))
    named = ", ".join(shape.link for shape in view.around)
    with_them = f", with the meshes that the job names ({named})" if named else ""
    cell = Chart(
        draw_cell(view.robot, view.q, view.nominal, start=view.start, around=view.around, kinds=kinds),
        f"The robot at the first waypoint of the cut, drawn from its URDF shapes{with_them}, and the path of the tool "
        "tip: which moves carry force, which are in the cut without, and which are rapid.",
        height=400,
    )
    return Section("What it reaches", [Columns([[_key_figures(view)], [cell]], (0.5, 0.5))])


def _key_figures(view: PlanView) -> PageTable:
    rows: list[list[TableCell | str | float | int | None]] = []
    cut = view.cut
    before, after = (np.linalg.norm(side, axis=1)[cut] for side in (view.before, view.after))
    for name, reduce in (("rms", lambda size: np.sqrt(np.mean(size**2))), ("mean", np.mean), ("largest", np.max)):
        rows.append([f"deviation, {name}", *(_length_cell(float(reduce(size))) for size in (before, after))])
    for name, value in zip(("rms", "largest"), view.uncoupled or (), strict=False):
        rows.append([f"{name}, by the force on the path", _length_cell(value), None])
    for way, distance in view.between.items():
        rows.append([f"between waypoints, {way}", None, _length_cell(distance)])
    if view.mismatch is not None:
        wrong = format_length(view.mismatch.max_deviation)
        rows.append([f"largest, {view.mismatch.cell}", None, TableCell(wrong, "strong")])
    shares = [TableCell(format_percent(float((size <= view.tolerance).mean()))) for size in (before, after)]
    rows.append([f"within {_set_length(view.tolerance)}", *shares])
    if view.tilt_before is not None and view.tilt_after is not None:
        tilts = [float(tilt[cut].max()) for tilt in (view.tilt_before, view.tilt_after)]
        rows.append(["tool axis off by up to", *(TableCell(format_angle(tilt)) for tilt in tilts)])
    correction = float(np.linalg.norm(view.correction, axis=1)[cut].max())
    allowed = f"{format_length(correction)} of {_set_length(view.max_correction)}"
    rows.append(["largest correction", None, TableCell(allowed)])
    rows.append(["smallest joint margin", None, TableCell(_tightest(view))])
    for name, rates, limits in _rates(view):
        share = np.abs(rates) / limits
        joint = view.robot.joint_names[int(np.argmax(share.max(axis=0)))]
        rows.append([f"{name} used", None, TableCell(f"{format_percent(float(share.max()))} ({joint})")])
    rows += [[name, None, TableCell(value)] for name, value in view.bending.items()]
    rows.append(["waypoints", None, TableCell(f"{format_number(len(cut))}")])
    rows.append(["path length", None, TableCell(f"{format_number(1e3 * float(view.length[-1]), 4)} mm")])
    rows.append(["time", None, TableCell(f"{format_number(float(view.time[-1]), 4)} s")])
    return PageTable([Column(""), Column("uncorrected"), Column("planned")], rows)


def _length_cell(value: float) -> TableCell:
    return TableCell(format_length(value), "strong")


def _tightest(view: PlanView) -> str:
    margin = np.minimum(view.q - view.robot.lower, view.robot.upper - view.q).min(axis=0)
    scale = np.where(view.robot.prismatic, 1e3, 180 / np.pi)
    share = margin / np.where(view.robot.prismatic, 1.0, np.pi)
    if not np.isfinite(share).any():
        return "no limits"
    k = int(np.argmin(share))
    unit = "mm" if view.robot.prismatic[k] else "deg"
    return f"{format_number(float(margin[k] * scale[k]))} {unit} ({view.robot.joint_names[k]})"


def _rates(view: PlanView) -> list[tuple[str, Array, Array]]:
    robot = view.robot
    speeds = robot.velocity_limits if view.velocity_limits is None else view.velocity_limits
    pushes = robot.acceleration_limits if view.acceleration_limits is None else view.acceleration_limits
    pairs = [("velocity", view.velocity, speeds), ("acceleration", view.acceleration, pushes)]
    return [(name, rates, limits) for name, rates, limits in pairs if np.isfinite(limits).any()]


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
    )
    judged = np.where(view.cut, 1.0, np.nan)
    line = draw_lines(
        view.stations,
        {name: 1e3 * np.maximum(size, FLOOR) * judged for name, size in zip(names, (before, after), strict=True)},
        "mm",
        title="deviation",
        colours=(BEFORE, AFTER),
        log=True,
        limit=(1e3 * view.tolerance, f"tolerance {_set_length(view.tolerance)}"),
    )
    shaded = " Grey bands are rapid moves, which are not compensated." if len(view.stations.shaded) else ""
    marked = " Red bands mark waypoints that fail." if view.failures else ""
    floor = f" What is below {format_bound(0.0)} is drawn there." if after[view.cut].min() < FLOOR else ""
    caption = f"Distance of the loaded tool tip from the path, logarithmic.{floor}{shaded}{marked}"
    blocks: list[Block] = [scene, Chart(line, caption, height=340)]
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
        [Chart(figure, "Commanded joint positions; red is beyond the limit.", height=60 + 215 * lines)],
        "Each chart spans the whole range of its joint.",
    )


def _corrections(view: PlanView) -> Section:
    size = np.linalg.norm(view.correction, axis=1)
    series = {f"d{axis}": 1e3 * view.correction[:, k] for k, axis in enumerate("xyz")} | {"distance": 1e3 * size}
    near = size.max() > 0.5 * view.max_correction
    limit = (1e3 * view.max_correction, f"limit {_set_length(view.max_correction)}") if near else None
    colours = (*CATEGORIES[:3], CATEGORIES[9])
    chart = draw_lines(view.stations, series, "mm", title="correction", colours=colours, limit=limit)
    blocks: list[Block] = [Chart(chart, "Commanded (unloaded) tip minus wanted tip, base axes.", height=320)]
    if np.abs(view.wrench).max() > 0:
        tall = 440 if np.abs(view.wrench[:, 3:]).max() > 1e-9 else 300
        caption = "Predicted wrench of the environment on the tool at its tip, base axes."
        blocks.append(Chart(draw_wrench(view.stations, view.wrench), caption, height=tall))
    return Section("Corrections and forces", blocks, tell_force(view.length, view.cut, view.pushed))


def _feed(view: PlanView) -> Section:
    wanted = np.where(view.cut, view.feed_wanted, np.nan)
    series = {"programmed": 1e3 * wanted, "planned": 1e3 * np.where(np.isfinite(wanted), view.feed, np.nan)}
    chart = draw_lines(view.stations, series, "mm/s", title="feed", colours=(BEFORE, AFTER), zero=True)
    blocks: list[Block] = [Chart(chart, "Feed of the tool tip along the cut.", height=280)]
    rates = {name: (np.abs(values) / limits, view.robot.joint_names) for name, values, limits in _rates(view)}
    if rates:
        caption = (
            "How much of its limits each joint uses; red is beyond the limit, which lies off the chart where it is far."
        )
        blocks.append(Chart(draw_shares(view.stations, rates), caption, height=60 + 220 * len(rates)))
    clock = draw_lines(view.stations, {"time": view.time}, "s", title="time", zero=True, colours=CATEGORIES[9:])
    blocks.append(Fold("Time along the path", [Chart(clock, "", height=240)]))
    if view.lowered.any():
        blocks.append(_lowered_table(view))
    lede = "The programmed feed holds all along the cut."
    if view.lowered.any():
        lede = "The feed is lowered where joint limits need it."
    return Section("Feed and rates", blocks, lede)


def _lowered_table(view: PlanView) -> PageTable:
    spans = find_spans(view.lowered)
    depth = np.array([(view.feed[a : b + 1] / view.feed_wanted[a : b + 1]).min() for a, b in spans])
    rows: list[list[TableCell | str | float | int | None]] = []
    for a, b in spans[np.sort(np.argsort(depth)[:LISTED])]:
        slowest = a + int(np.argmin(view.feed[a : b + 1] / view.feed_wanted[a : b + 1]))
        reach = [1e3 * float(view.length[a]), 1e3 * float(view.length[b])]
        lowest = [1e3 * float(view.feed_wanted[slowest]), 1e3 * float(view.feed[slowest])]
        rows.append([int(a), int(b), *reach, *lowest, busiest_rate(_rates(view), view.robot.joint_names, slowest)])
    columns = [
        Column("from waypoint"), Column("to"), Column("from", "mm", 4), Column("to", "mm", 4),
        Column("programmed", "mm/s"), Column("lowest", "mm/s"), Column("busiest there"),
    ]  # fmt: skip
    more = f" The {LISTED} deepest of {len(spans)} stretches." if len(spans) > LISTED else ""
    return PageTable(columns, rows, f"Where the feed is lowered.{more}", scroll=12)
