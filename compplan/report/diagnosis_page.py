"""The page of a diagnosis: where, which, how far in three sentences, then the evidence for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.shares import CALIBRATION, UNEXPLAINED, Share
from compplan.diagnose.small_errors import SmallErrors
from compplan.diagnose.verdict import CALIBRATED
from compplan.report.calibration_section import show_calibration
from compplan.report.effect_words import describe_change, describe_effect, describe_parameters, name_effect
from compplan.report.gap_figures import (
    draw_candidates,
    draw_factors,
    draw_histogram,
    draw_residuals,
    draw_shares,
    draw_together,
    draw_traces,
)
from compplan.report.openings import open_diagnosis
from compplan.report.page import Block, Chart, Column, Columns, Fold, PageTable, Section, TableCell, write_page
from compplan.report.path_scene import describe_magnification
from compplan.report.provenance import describe_grade, describe_robot
from compplan.report.style import format_length, format_number, format_percent
from compplan.robot import Array, Robot

if TYPE_CHECKING:
    from compplan.diagnose.assessment import Assessment
    from compplan.diagnose.where import Split
    from compplan.measure.campaign import Campaign

#: Candidates that are drawn at most.
DRAWN = 12
#: Candidates below this probability stand in the table alone.
UNLIKELY = 5e-4
#: What the picture of the first screen shows.
SHARES = "Share of the error by place. Lines: 95 % intervals; where one is long, another place explains it as well."
Row = list[TableCell | str | float | int | None]


@dataclass(frozen=True, eq=False)
class DiagnosisView:
    """What the page of a diagnosis shows; n rows.

    Attributes:
        title: Name of the campaign.
        robot: The nominal robot.
        campaign: The measurement log.
        verdict: `verdict` of diagnosis.json.
        gap: `gap` of diagnosis.json.
        candidates: `candidates` of diagnosis.json, the most probable first.
        next_measurement: `next_measurement` of diagnosis.json.
        split: Where the gap lies.
        assessment: What it is worth to the one who calibrates; left out of the page if None.
        point: Measured points, base frame. Shape (n, 3). [m]
        before: Measured minus predicted by the nominal robot, base axes. Shape (n, 3). [m]
        after: Measured minus predicted by the updated robot, base axes. Shape (n, 3). [m]
        used: Rows that count; the others are outliers or incomplete. Shape (n,).
        rivals: Held-out rms of other explanations, by what they are, such as "registration only". [m]
        structure: What an unexplained rest looks like, one sentence each.
        facts: Rows of name and value for the foot of the page.
        notes: Warnings, one sentence each.
        assumptions: What was assumed, one sentence each.
        delivered: Kind of the robot folder that goes out: "nominal", "causes" or "calibrated".
    """

    title: str
    robot: Robot
    campaign: Campaign
    verdict: Mapping[str, Any]
    gap: Mapping[str, float | None]
    candidates: Sequence[Mapping[str, Any]]
    next_measurement: Sequence[Mapping[str, Any]]
    split: Split
    assessment: Assessment | None
    point: Array
    before: Array
    after: Array
    used: NDArray[np.bool_]
    rivals: Mapping[str, float] | None = None
    structure: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    assumptions: Sequence[str] = ()
    delivered: str = "causes"


def write_diagnosis(view: DiagnosisView, file: Path) -> None:
    """Write the page of a diagnosis.

    Args:
        view: What it shows.
        file: The HTML file.
    """
    sections = [_where(view), _which(view), _how_far(view)]
    if view.assessment is not None:
        sections.append(show_calibration(view.assessment, view.split.spread.by_region, view.robot.joint_names))
    sections.append(_next(view))
    write_page(
        file,
        f"{view.robot.name}: diagnosis",
        [describe_where(view), describe_which(view), describe_how_far(view)],
        [section for section in sections if section.blocks],
        kind=f"Diagnosis of {view.title}",
        opening=open_diagnosis(
            view.verdict, view.gap, view.delivered, Chart(draw_shares(view.split.shares.by_place, "place"), SHARES, 330)
        ),
        notes=[*view.notes, describe_grade(view.robot)],
        provenance=describe_robot(view.robot, [*_count_rows(view), *view.facts], list(view.assumptions)),
    )


def describe_where(view: DiagnosisView) -> str:
    """Answer where the gap lies, in a sentence."""
    shares, split = view.split.shares, view.split
    gap = f"Where: the nominal model leaves {format_length(split.spread.rms)} rms"
    parts: list[str] = []
    if view.verdict["status"] == CALIBRATED and split.small_errors is not None:
        return f"{gap}; {_describe_places(split.small_errors)}."
    for carrier in shares.carriers[:3]:
        if carrier.share.share >= 0.05 or not parts:
            sure = f"probability {carrier.probability:.2f}, {_describe_interval(carrier.share)} if so"
            how = carrier.effect.replace("_", " ")
            parts.append(f"{carrier.place} carries {format_percent(carrier.share.share)} by {how} ({sure})")
    rest = {
        "small errors everywhere (calibration) carry": shares.by_place[CALIBRATION],
        "no model explains": shares.by_place[UNEXPLAINED],
    }
    parts += [f"{what} {format_percent(share.share)} ({_describe_interval(share)})"
              for what, share in rest.items() if share.share >= 0.02]  # fmt: skip
    if shares.noise >= 0.02:
        parts.append(f"noise is {format_percent(shares.noise)}")
    if not shares.carriers:
        parts.insert(0, "no joint, frame, sensor or load is named that carries a part of it")
    return f"{gap}; {'; '.join(parts)}."


def _describe_places(errors: SmallErrors) -> str:
    """Say where the small errors of a robot that was not calibrated sit."""
    order = sorted(errors.by_place.items(), key=lambda item: (item[0] == UNEXPLAINED, -item[1].share))
    parts = [
        f"{'no model explains' if name == UNEXPLAINED else name + ' carries'} {format_percent(share.share)} "
        f"({_describe_interval(share)})"
        for name, share in order if share.share >= 0.02
    ]  # fmt: skip
    return "; ".join(parts)


def _describe_interval(share: Share) -> str:
    return f"95 %: {format_percent(share.low)} to {format_percent(share.high)}"


def describe_which(view: DiagnosisView) -> str:
    """Answer which effect causes the gap, in a sentence."""
    status, effects = view.verdict["status"], view.verdict["effects"]
    if status == "none":
        return "Which: none; the residual is noise."
    if status == CALIBRATED and view.split.small_errors is not None:
        return describe_small_errors(view.split.small_errors)
    if not effects:
        text = " ".join(view.structure[:1])
        return f"Which: unknown; there is structure in the residual and no effect explains it. {text}".rstrip()
    told = [
        f"{describe_effect(effect)} ({change + ', ' if (change := describe_change(effect)) else ''}"
        f"probability {effect['probability']:.2f})"
        for effect in effects[:3]
    ]
    text = f"Which: {'; '.join(told)}"
    if len(effects) > 3:
        text += f"; and {len(effects) - 3} more"
    for effect in effects[:3]:
        rivals = [name_effect(rival) for rival in effect.get("ambiguous_with", [])]
        if rivals:
            text += f"; this campaign cannot tell {name_effect(effect)} from {' or '.join(rivals[:3])}"
    if status == "partly_explained":
        text += "; structure is left that none of them explains"
    left = f" {view.structure[0]}" if view.structure and status == "partly_explained" else ""
    return f"{text}.{left}"


def describe_small_errors(errors: SmallErrors) -> str:
    """Say what a robot that was not calibrated has small errors of, and where."""
    kinds = [
        f"{kind} {format_percent(share.share)} ({_describe_interval(share)})"
        for kind, share in sorted(errors.by_kind.items(), key=lambda item: -item[1].share)
        if share.share >= 0.02 and kind != UNEXPLAINED
    ]
    text = f"Which: no single cause; small errors make the gap: {', '.join(kinds)}"
    groups = [f"{group.kind} of {group.place}, {format_percent(group.share.share)}" for group in errors.groups[:3]]
    return f"{text}. {'; '.join(groups)}: both halves of the poses tell so." if groups else f"{text}."


def describe_how_far(view: DiagnosisView) -> str:
    """Answer how far the gap shrinks, in a sentence."""
    before, after = view.gap.get("held_out_before_rms_mm"), view.gap.get("held_out_after_rms_mm")
    floor = view.gap.get("noise_floor_mm")
    if before is None or after is None:
        return "How far: too few rows to leave some out, so no honest figure can be given."
    text = f"How far: on rows that had no part in the choice the deviation goes from {format_length(1e-3 * before)} "
    text += f"to {format_length(1e-3 * after)} rms"
    if floor:
        text += f", {format_number(after / floor, 3)} times the noise floor of {format_length(1e-3 * floor)}"
    return f"{text}."


def _count_rows(view: DiagnosisView) -> list[tuple[str, str]]:
    left = int((~view.used).sum())
    facts = [
        (
            "rows",
            f"{len(view.used)}, of which {left} are left out as outliers or incomplete"
            if left
            else f"{len(view.used)}",
        )
    ]
    if view.campaign.file is not None:
        facts.insert(0, ("measurements", str(view.campaign.file)))
    return facts


def _where(view: DiagnosisView) -> Section:
    split, shares, used = view.split, view.split.shares, view.used
    q = np.nan_to_num(view.campaign.q[used])
    point, before = view.point[used], view.before[used]
    figure = draw_residuals(view.robot, q, point, before, view.after[used])
    magnified = describe_magnification(point, before)
    blocks: list[Block] = [
        Chart(figure, f"Measured minus predicted point, {magnified}; turning one scene turns the other.", 430, True),
        Columns([
            [Chart(draw_shares(shares.by_place, "place"), "Where what is named sits; lines: 95 % intervals.", 340)],
            [Chart(draw_shares(shares.by_factor, "factor"), "What the error follows; lines: 95 % intervals.", 340)],
        ]),
    ]  # fmt: skip
    if split.traces:
        caption = (
            "The error that the named joint makes at every row, everything else explained taken out: a soft spring is "
            "a sloped line, lost motion two levels, a gear error a wave."
        )
        blocks.append(Chart(draw_traces(split.traces), caption, 60 + 250 * -(-len(split.traces) // 3)))
    caption = "How much of the gap, in per cent, each place carries by each effect."
    together = {place: own for place, own in shares.together.items() if any(s >= 0.005 for s in own.values())}
    if together:
        blocks.append(Chart(draw_together(together), caption, 120 + 30 * len(together)))
    blocks.append(Fold("By run, time, load, direction, approach and region", _split_tables(split)))
    return Section("Where it lies", blocks)


def _split_tables(split: Split) -> list[Block]:
    end = [Column("rows"), Column("rms", "mm"), Column("updated", "mm"), Column("share of the gap"), Column("95 %")]

    def tail(entry: Mapping[str, Any]) -> Row:
        interval = f"{format_percent(entry['low'])} to {format_percent(entry['high'])}"
        after = float(entry["after_rms_mm"])
        return [int(entry["rows"]), float(entry["rms_mm"]), after, format_percent(entry["share"]), interval]

    def reach(pair: Sequence[float]) -> str:
        return f"{format_number(float(pair[0]), 4)} to {format_number(float(pair[1]), 4)}"

    runs = PageTable(
        [Column("run"), *end], [[name, *tail(entry)] for name, entry in split.spread.by_run.items()], "By run.", 12
    )
    times: list[Row] = []
    for entry in split.spread.by_time:
        span = reach(entry["time_s"]) if "time_s" in entry else "–"
        times.append([f"{entry['rows_from']} to {entry['rows_to']}", span, *tail(entry)])
    loads = PageTable(
        [Column("force", "N"), *end], [[reach(e["force_N"]), *tail(e)] for e in split.spread.by_load], "By load."
    )
    regions = PageTable(
        [Column("reach", "mm"), Column("height", "mm"), *end],
        [[reach(entry["reach_mm"]), reach(entry["height_mm"]), *tail(entry)] for entry in split.spread.by_region],
        "By region: distance from the axis of the base, and height.",
    )
    axes: list[Row] = [
        [
            name.replace("_", " "),
            format_percent(share.share),
            f"{format_percent(share.low)} to {format_percent(share.high)}",
        ]
        for name, share in split.spread.by_axis.items()
    ]
    approach: list[Row] = []
    for name, numbers in split.by_approach.items():
        key = next(iter(numbers))
        size, error = numbers[key], numbers["standard_error"]
        shown = TableCell(size, "strong" if abs(size) > 4 * error else "")
        approach.append([name, shown, error, key.rsplit("_", 1)[1]])
    columns = [Column("joint"), Column("lost motion"), Column("standard error"), Column("unit")]
    blocks: list[Block] = [
        runs,
        PageTable([Column("rows of the log"), Column("time", "s"), *end], times, "By time."),
        loads,
        regions,
        PageTable([Column("direction"), Column("share of the gap"), Column("95 %")], axes, "By direction, base axes."),
    ]
    if approach:
        caption = "How far a joint stands apart when its last move came from either side; positive: it lags behind."
        blocks.append(PageTable(columns, approach, caption))
    return blocks


def _which(view: DiagnosisView) -> Section:
    effects = view.verdict["effects"]
    blocks: list[Block] = []
    if effects:
        rows: list[Row] = []
        for effect in effects:
            rivals = "; ".join(name_effect(rival) for rival in effect.get("ambiguous_with", [])) or "nothing listed"
            sure = TableCell(f"{effect['probability']:.2f}", "strong")
            told = describe_parameters(effect.get("parameters", {}), effect.get("interval95"))
            change = TableCell(describe_change(effect) or None, "strong")
            rows.append([name_effect(effect), sure, change, told, rivals])
        heads = [Column("effect"), Column("probability"), Column("change of the model's value, 95 %"),
                 Column("parameters"), Column("cannot be told from")]  # fmt: skip
        blocks.append(PageTable(heads, rows, "Effects present together, the largest share of the gap first."))
    blocks += [f"What is left: {sentence}" for sentence in view.structure]
    if view.candidates:
        likely = [c for c in view.candidates if float(c["probability"]) > UNLIKELY] or list(view.candidates)
        drawn = [(name_effect(candidate), float(candidate["probability"])) for candidate in likely[:DRAWN]]
        chart = Chart(draw_candidates(drawn), "Candidates by probability.", 90 + 26 * len(drawn))
        rows = [
            [name_effect(candidate), float(candidate["probability"]), candidate.get("held_out_rms_mm")]
            for candidate in view.candidates
        ]
        heads = [Column("candidate"), Column("probability"), Column("held-out rms", "mm", 4)]
        blocks.append(Columns([[chart], [PageTable(heads, rows, "All candidates, ranked.", 12)]]))
    return Section("Which effect", blocks)


def _how_far(view: DiagnosisView) -> Section:
    gap, used = view.gap, view.used
    held_out = TableCell(gap.get("held_out_after_rms_mm"), "strong")
    rows: list[Row] = [
        ["nominal model", gap.get("before_rms_mm"), gap.get("held_out_before_rms_mm")],
        [TableCell("updated model", "strong"), gap.get("after_rms_mm"), held_out],
    ]
    rows += [[name, None, 1e3 * rms] for name, rms in (view.rivals or {}).items()]
    floor = TableCell(gap.get("noise_floor_mm"), "muted")
    rows.append([TableCell("noise floor", "muted"), floor, floor])
    heads = [Column("model"), Column("all rows", "mm"), Column("rows left out of the choice", "mm")]
    before, after = (np.linalg.norm(side[used], axis=1) for side in (view.before, view.after))
    noise = 1e-3 * float(gap.get("noise_floor_mm") or 0.0)
    histogram = Chart(
        draw_histogram(before, after, noise), "Deviations of all rows; dashed: what noise alone would give.", 320
    )
    table = PageTable(heads, rows, "Rms of the 3D distance, outliers left out.")
    factors = _list_factors(view)
    chart = Chart(
        draw_factors(factors, before, after), "The deviation along each factor.", 70 + 230 * -(-len(factors) // 3)
    )
    return Section("How far it shrinks", [Columns([[table], [histogram]], (0.45, 0.55)), chart])


def _list_factors(view: DiagnosisView) -> dict[str, tuple[Array, str]]:
    campaign, used, point = view.campaign, view.used, view.point
    factors: dict[str, tuple[Array, str]] = {}
    if campaign.time is not None:
        factors["time"] = campaign.time[used], "s"
    else:
        factors["row"] = np.flatnonzero(used).astype(float), ""
    if campaign.load_varies:
        factors["force on the tool"] = np.linalg.norm(np.nan_to_num(campaign.wrench[used, :3]), axis=1), "N"
    factors["reach from the base axis"] = 1e3 * np.hypot(point[used, 0], point[used, 1]), "mm"
    factors["height"] = 1e3 * point[used, 2], "mm"
    if campaign.temperature is not None:
        factors["temperature"] = campaign.temperature[used], "°C"
    speed = np.abs(campaign.speed[used]).max(axis=1)
    if speed.max(initial=0.0) > 0:
        factors["fastest joint"] = speed, "rad/s"
    for name, share in sorted(view.split.shares.by_place.items(), key=lambda item: -item[1].share)[:2]:
        if name in view.robot.joint_names and share.share > 0.05 and len(factors) < 6:
            k = view.robot.joint_names.index(name)
            scale, unit = (1e3, "mm") if view.robot.prismatic[k] else (180 / np.pi, "deg")
            factors[f"position of {name}"] = campaign.q[used, k] * scale, unit
    return factors


def _next(view: DiagnosisView) -> Section:
    rows: list[Row] = []
    for step in view.next_measurement:
        separates = " from ".join(_name_any(item) for item in step.get("separates", []))
        gain = step.get("expected_gain", step.get("expected_probability_gain"))
        how = str(step.get("how", step.get("kind", ""))) or "–"
        rows.append([separates, how, len(step.get("poses", [])), len(step.get("wrenches", [])), gain])
    heads = [Column("separates"), Column("how"), Column("poses"), Column("loads"), Column("expected gain")]
    text = "Poses and loads stand in diagnosis.json; all are within joint limits and the loads of this campaign."
    blocks: list[Block] = [PageTable(heads, rows), text] if rows else []
    return Section("What to measure next", blocks)


def _name_any(item: Any) -> str:
    return name_effect(item) if isinstance(item, Mapping) else str(item).replace("_", " ")
