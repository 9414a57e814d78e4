"""The page of a diagnosis: where, which, how far in three sentences, then the evidence for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.results.shares import CALIBRATION
from compplan.reporting.calibration_section import show_calibration
from compplan.reporting.diagnosis_text import (
    describe_counting,
    describe_how_far,
    describe_structure,
    describe_where,
    describe_which,
    reaches_noise,
)
from compplan.reporting.effect_text import describe_change, describe_parameters, name_effect
from compplan.reporting.gap_figures import (
    chart_candidates,
    draw_factors,
    draw_histogram,
    draw_residuals,
    draw_shares,
    draw_together,
    draw_traces,
)
from compplan.reporting.page import Block, Chart, Column, Columns, Fold, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.path_scene import describe_magnification
from compplan.reporting.provenance import describe_grade, describe_robot
from compplan.reporting.style import format_number, format_percent
from compplan.reporting.summaries import open_diagnosis
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnosis.results.accuracy import Assessment
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.where import Split
    from compplan.measurement.campaign import Campaign

#: Candidates that are drawn at most.
DRAWN = 12
#: Candidates below this probability stand in the table alone.
UNLIKELY = 5e-4
#: What the picture of the first screen shows.
SHARES = "Share of the error by place. Lines: 95 % intervals; where one is long, another place explains it as well."
#: Kinds of robot folders in words.
DELIVERED = {
    "nominal": "the nominal robot as it was",
    "causes": "the named causes alone",
    "calibrated": "all that a calibration finds, named or not",
}


@dataclass(frozen=True, eq=False)
class _Rows:
    """The measured rows that count, as charts take them; k rows, base axes.

    Attributes:
        used: Rows that count; the others are outliers or incomplete. Shape (n,).
        q: Joint positions. Shape (k, nq). [rad or m]
        point: Measured points, base frame. Shape (k, 3). [m]
        before: Measured minus predicted by the nominal robot. Shape (k, 3). [m]
        after: Measured minus predicted by the updated robot. Shape (k, 3). [m]
    """

    used: NDArray[np.bool_]
    q: Array
    point: Array
    before: Array
    after: Array


def write_diagnosis_page(
    diagnosis: Diagnosis, file: Path, split: Split, assessment: Assessment | None, table: Mapping[str, Any]
) -> None:
    """Write the page of a diagnosis.

    Args:
        diagnosis: The diagnosis.
        file: The HTML file.
        split: Where the gap lies.
        assessment: What it is worth to the one who calibrates; left out of the page if None.
        table: What diagnosis.json holds.

    Raises:
        InputError: If the folder cannot be written.
    """
    rows, structure, robot = _take_rows(diagnosis), describe_structure(diagnosis), diagnosis.robot
    verdict, gap = table["verdict"], table["gap"]
    taken_up = reaches_noise(gap, diagnosis.deliveries[0].kind)
    which = describe_which(verdict, structure, split, taken_up=taken_up)
    sections = [_where(diagnosis, split, rows), _which(table, structure), _how_far(diagnosis, gap, split, rows)]
    if assessment is not None:
        sections.append(show_calibration(assessment, split.spread.by_region, robot.joint_names))
    sections.append(_next(table["next_measurement"]))
    notes = [
        f"Considered and not named: {name_effect(effect)} "
        + (f"({effect['beyond']})." if "beyond" in effect else f"(probability {effect['probability']:.2f}).")
        for effect in verdict.get("doubtful", [])
    ]
    notes += [told] if (told := describe_counting(diagnosis)) else []
    write_page(
        file,
        f"{robot.name}: diagnosis",
        [describe_where(verdict, split, taken_up=taken_up), which, describe_how_far(gap)],
        [section for section in sections if section.blocks],
        kind=f"Diagnosis of {_title(diagnosis.fit.problem.campaign)}",
        opening=open_diagnosis(
            verdict,
            gap,
            diagnosis.deliveries[0].kind,
            Chart(draw_shares(split.shares.by_place, "place"), SHARES, 330),
            split.shares.by_place[CALIBRATION].share,
            listed=any(s.get("poses") for s in table["next_measurement"]),
        ),
        notes=[*notes, describe_grade(robot)],
        provenance=describe_robot(robot, _list_facts(diagnosis, rows)),
    )


def _take_rows(diagnosis: Diagnosis) -> _Rows:
    """Take the rows that count."""
    campaign, before, after = diagnosis.fit.problem.campaign, diagnosis.residual_before, diagnosis.residual_after
    used = campaign.usable & np.isfinite(before).all(1) & np.isfinite(after).all(1)
    used[diagnosis.outliers] = False
    return _Rows(used, np.nan_to_num(campaign.q[used]), diagnosis.points[used], before[used], after[used])


def _title(campaign: Campaign) -> str:
    if campaign.file is None:
        return "measurements in memory"
    folder = campaign.file.resolve().parent.name
    return f"{campaign.file.stem}, {folder}" if folder else campaign.file.stem


def _list_facts(diagnosis: Diagnosis, rows: _Rows) -> list[tuple[str, str]]:
    campaign, left = diagnosis.fit.problem.campaign, int((~rows.used).sum())
    words = f", of which {left} are left out as outliers or incomplete" if left else ""
    facts = [] if campaign.file is None else [("measurements", str(campaign.file))]
    return [
        *facts,
        ("rows", f"{len(rows.used)}{words}"),
        ("robot folder that is delivered", DELIVERED[diagnosis.deliveries[0].kind]),
        ("noise floor from", diagnosis.noise),
        ("frames fitted first", ", ".join(diagnosis.fit.problem.register) or "none"),
        ("outliers", _list_rows(diagnosis.outliers)),
    ]


def _list_rows(rows: NDArray[np.int_]) -> str:
    if not len(rows):
        return "none"
    shown = ", ".join(str(int(row)) for row in rows[:20])
    return f"rows {shown}{', …' if len(rows) > 20 else ''} ({len(rows)}), counted from 0"


def _where(diagnosis: Diagnosis, split: Split, rows: _Rows) -> Section:
    shares = split.shares
    figure = draw_residuals(diagnosis.robot, rows.q, rows.point, rows.before, rows.after)
    magnified = describe_magnification(rows.point, rows.before)
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
        *([loads] if len(split.spread.by_load) > 1 else []),
        regions,
        PageTable([Column("direction"), Column("share of the gap"), Column("95 %")], axes, "By direction, base axes."),
    ]
    if approach:
        caption = "Difference of a joint's position between approaches from either side; positive: it lags behind."
        blocks.append(PageTable(columns, approach, caption))
    return blocks


def _which(table: Mapping[str, Any], structure: Sequence[str]) -> Section:
    effects, candidates = table["verdict"]["effects"], table["candidates"]
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
                 Column("parameters"), Column("may also be")]  # fmt: skip
        blocks.append(PageTable(heads, rows, "Effects present together, the largest share of the gap first."))
    blocks += [f"What is left: {sentence}" for sentence in structure]
    if candidates:
        likely = [c for c in candidates if float(c["probability"]) > UNLIKELY] or list(candidates)
        drawn = [(name_effect(candidate), float(candidate["probability"])) for candidate in likely[:DRAWN]]
        chart = Chart(chart_candidates(drawn), "Candidates by probability.", 90 + 26 * len(drawn))
        rows = [
            [name_effect(candidate), float(candidate["probability"]), candidate.get("held_out_rms_mm")]
            for candidate in candidates
        ]
        heads = [Column("candidate"), Column("probability"), Column("rms, rows not in the fit", "mm", 4)]
        blocks.append(Columns([[chart], [PageTable(heads, rows, "All candidates, ranked.", 12)]]))
    return Section("Which effect", blocks)


def _how_far(diagnosis: Diagnosis, gap: Mapping[str, Any], split: Split, measured: _Rows) -> Section:
    held_out = TableCell(gap.get("held_out_after_rms_mm"), "strong")
    rows: list[Row] = [
        ["nominal model", gap.get("before_rms_mm"), gap.get("held_out_before_rms_mm")],
        [TableCell("updated model", "strong"), gap.get("after_rms_mm"), held_out],
    ]
    rows += [[name, None, 1e3 * rms] for name, rms in _list_rivals(diagnosis).items()]
    floor = TableCell(gap.get("noise_floor_mm"), "muted")
    rows.append([TableCell("noise floor", "muted"), floor, floor])
    heads = [Column("model"), Column("all rows", "mm"), Column("rows left out of the choice", "mm")]
    before, after = (np.linalg.norm(side, axis=1) for side in (measured.before, measured.after))
    noise = 1e-3 * float(gap.get("noise_floor_mm") or 0.0)
    histogram = Chart(
        draw_histogram(before, after, noise), "Deviations of all rows; dashed: what noise alone would give.", 320
    )
    table = PageTable(heads, rows, "Rms of the 3D distance, outliers left out.")
    factors = _list_factors(diagnosis, split, measured)
    chart = Chart(
        draw_factors(factors, before, after), "The deviation along each factor.", 70 + 230 * -(-len(factors) // 3)
    )
    return Section("How far it shrinks", [Columns([[table], [histogram]], (0.45, 0.55)), chart])


def _list_rivals(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the held-out rms of other explanations, by what they are. [m]"""
    gap, parts = diagnosis.gap, diagnosis.fit.problem.register
    rivals = {f"registration only ({', '.join(parts)})": gap.registration_only} if parts else {}
    for number, delivery in reversed(list(enumerate(diagnosis.deliveries[1:], start=1))):
        rivals[f"{delivery.folder(number)}: {DELIVERED[delivery.kind]}"] = delivery.held.rms
    named = {"generic fit of zeros and lengths": gap.generic, "best effect that is not named, alone": gap.wrong}
    return {**rivals, **named}


def _list_factors(diagnosis: Diagnosis, split: Split, rows: _Rows) -> dict[str, tuple[Array, str]]:
    campaign, used, point, robot = diagnosis.fit.problem.campaign, rows.used, rows.point, diagnosis.robot
    factors: dict[str, tuple[Array, str]] = {}
    if campaign.time is not None:
        factors["time"] = campaign.time[used], "s"
    else:
        factors["row"] = np.flatnonzero(used).astype(float), ""
    if campaign.load_varies:
        factors["force on the tool"] = np.linalg.norm(np.nan_to_num(campaign.wrench[used, :3]), axis=1), "N"
    factors["reach from the base axis"] = 1e3 * np.hypot(point[:, 0], point[:, 1]), "mm"
    factors["height"] = 1e3 * point[:, 2], "mm"
    if campaign.temperature is not None:
        factors["temperature"] = campaign.temperature[used], "°C"
    speed = np.abs(campaign.speed[used]).max(axis=1)
    if speed.max(initial=0.0) > 0:
        factors["fastest joint"] = speed, "rad/s"
    for name, share in sorted(split.shares.by_place.items(), key=lambda item: -item[1].share)[:2]:
        if name in robot.joint_names and share.share > 0.05 and len(factors) < 6:
            k = robot.joint_names.index(name)
            scale, unit = (1e3, "mm") if robot.prismatic[k] else (180 / np.pi, "deg")
            factors[f"position of {name}"] = campaign.q[used, k] * scale, unit
    return factors


def _next(steps: Sequence[Mapping[str, Any]]) -> Section:
    rows: list[Row] = []
    for step in steps:
        separates = " from ".join(_name_any(item) for item in step.get("separates", []))
        gain = step.get("expected_gain", step.get("expected_probability_gain"))
        how = str(step.get("how", step.get("kind", ""))) or "–"
        rows.append([separates, how, len(step.get("poses", [])), len(step.get("wrenches", [])), gain])
    heads = [Column("separates"), Column("how"), Column("poses"), Column("loads"), Column("expected gain")]
    text = "Poses and loads are in diagnosis.json; all are within joint limits and the loads of this campaign."
    blocks: list[Block] = [PageTable(heads, rows), text] if rows else []
    return Section("What to measure next", blocks)


def _name_any(item: Any) -> str:
    return name_effect(item) if isinstance(item, Mapping) else str(item).replace("_", " ")
