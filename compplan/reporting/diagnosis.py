"""What `compplan diagnose` writes: diagnosis.json, the updated robot folders, gap.csv, and the page.

The page says where, which, how far in three sentences, then shows the evidence for each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis import Diagnosis
from compplan.diagnosis.results.assessment import Assessment, assess_diagnosis
from compplan.diagnosis.results.next_measurement import propose_measurements
from compplan.diagnosis.results.shares import CALIBRATION
from compplan.diagnosis.results.where import Split, split_diagnosis
from compplan.errors import InputError
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_mm, format_number, format_percent
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.measurement.registration import write_registration
from compplan.reporting import diagnosis_text as words
from compplan.reporting import page
from compplan.reporting.calibration_section import show_calibration
from compplan.reporting.effect_text import describe_change, describe_effect, describe_parameters, name_effect
from compplan.reporting.gap_figures import (
    draw_gap_shares,
    draw_histogram,
    draw_residuals,
    draw_traces,
)
from compplan.reporting.provenance import describe_grade, describe_robot
from compplan.reporting.scenes import describe_magnification
from compplan.reporting.strategy_text import join_names
from compplan.reporting.writers.recording import write_gap
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Array, Robot
from compplan.simulation.predict import predict_campaign

if TYPE_CHECKING:
    from compplan.measurement.campaign import Campaign

#: A written robot reproduces the predictions in memory to this (theory: rounding of the solved equilibrium). [m]
SAME_POSITION = 1e-9
#: Kinds of robot folders in words.
DELIVERED = {"nominal": "the nominal robot as it was", "calibrated": "all that a calibration finds, named or not"}


def deliver_diagnosis(
    diagnosis: Diagnosis, out: Path, progress: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, Any], page.Summary]:
    """Find where the gap lies, what the folders are worth and what to measure next; write all of it.

    Returns what diagnosis.json holds, and the first screen of the page.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    progress("where")
    split = split_diagnosis(diagnosis)
    progress("accuracy")
    assessment = assess_diagnosis(diagnosis)
    progress("what to measure next")
    extra = {"where": split.to_json(), **assessment.to_json(), "next_measurement": propose_measurements(diagnosis)}
    table = {**diagnosis.to_table(extra), "log_notes": list(diagnosis.fit.problem.campaign.notes)}
    progress("report")
    table = write_diagnosis(diagnosis, split, assessment, table, out)
    return table, _open(diagnosis, split, table)


def write_diagnosis(
    diagnosis: Diagnosis, split: Split, assessment: Assessment, table: Mapping[str, Any], out: Path
) -> dict[str, Any]:
    """Write diagnosis.json, report.html and the updated robot folders; return what diagnosis.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    table = {**table, "made_by": describe_origin()}
    with replace_folder(out, "diagnose") as part:
        folder, registration = part / "robot", diagnosis.delivery.state.registration
        read = deliver_robot_folder(diagnosis.updated, folder, diagnosis.robot)
        table["gap"] = {**table["gap"], "after_rms_mm": round(1e3 * measure_gap(diagnosis, read, folder), 5)}
        if registration is not None:
            write_registration(registration, folder / "registration.toml")
        write_text(part / "report.html", render_diagnosis(diagnosis, split, assessment, table))
        write_gap(diagnosis, split.shares, part)
        write_json(part / "diagnosis.json", table, indent=2)
    return table


def measure_gap(diagnosis: Diagnosis, robot: Robot, folder: Path) -> float:
    """Return the root mean square gap of a robot as read from its folder over the rows that are no outliers. [m]

    Raises:
        InputError: If the folder predicts other positions than the model that was judged.
    """
    campaign, delivery = diagnosis.fit.problem.campaign, diagnosis.delivery
    registration = delivery.state.registration
    gap = predict_campaign(robot, campaign, registration=registration, later=False).gap
    expected = delivery.residual
    if registration is not None and registration.contacts:  # the places of contacts are fitted anew by a prediction
        expected = predict_campaign(diagnosis.updated, campaign, registration=registration, later=False).gap
    good = campaign.usable.copy()
    alike = good
    if any(effect.name == "backlash" for effect in delivery.state.effects):
        alike = good & ~campaign.first_visit  # their approach is fitted, no folder holds it
    off = float(np.abs(gap[alike] - expected[alike]).max(initial=0.0))
    if off > SAME_POSITION:
        raise InputError(
            f"the folder as read predicts tips {1e3 * off:.3g} mm off the validated model; report a defect",
            file=folder,
        )
    good[diagnosis.outliers] = False
    return float(np.sqrt(np.mean(np.sum(gap[good] ** 2, axis=1))))


@dataclass(frozen=True, eq=False)
class _UsedRows:
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


def render_diagnosis(
    diagnosis: Diagnosis, split: Split, assessment: Assessment | None, table: Mapping[str, Any]
) -> str:
    """Return the page of a diagnosis; `table` is what diagnosis.json holds, without `assessment` no advice is given."""
    campaign, before, after = diagnosis.fit.problem.campaign, diagnosis.residual_before, diagnosis.residual_after
    used = campaign.usable & np.isfinite(before).all(1) & np.isfinite(after).all(1)
    used[diagnosis.outliers] = False
    rows = _UsedRows(used, np.nan_to_num(campaign.q[used]), diagnosis.points[used], before[used], after[used])
    structure, robot, kind = words.describe_structure(diagnosis), diagnosis.robot, diagnosis.delivery.kind
    verdict, gap, steps = table["verdict"], table["gap"], table["next_measurement"]
    taken_up = words.reaches_noise(gap, kind)
    sections = [
        _show_where(diagnosis, split, rows),
        _show_which(table, structure),
        _show_how_far(diagnosis, gap, rows),
    ]
    if assessment is not None:
        sections.append(show_calibration(assessment, robot.joint_names))
    sections += [_show_next(steps)] if steps else []
    notes = [
        f"Considered and not named: {name_effect(effect)} "
        + (f"({effect['beyond']})." if "beyond" in effect else f"(probability {effect['probability']:.2f}).")
        for effect in verdict.get("doubtful", [])
    ]
    notes += [told] if (told := words.describe_counting(diagnosis)) else []
    answers = [
        words.describe_where(verdict, split, taken_up=taken_up),
        words.describe_which(verdict, structure, split, taken_up=taken_up),
        words.describe_how_far(gap),
    ]
    return page.render_page(
        f"{robot.name}: diagnosis", answers, [section for section in sections if section.blocks],
        kind=f"Diagnosis of {_name_log(campaign)}",
        opening=_open(diagnosis, split, table),
        notes=[*notes, describe_grade(robot)],
        provenance=describe_robot(robot, _list_facts(diagnosis, rows)),
    )  # fmt: skip


def _open(diagnosis: Diagnosis, split: Split, table: Mapping[str, Any]) -> page.Summary:
    shares = draw_gap_shares(split.shares.by_place, "place")
    caption = "Share of the error by place. Lines: 95 % intervals; where one is long, another place explains it as well"
    small = split.shares.by_place[CALIBRATION].share
    return open_diagnosis(
        table["verdict"], table["gap"], diagnosis.delivery.kind, page.Chart(shares, f"{caption}.", 330), small,
        listed=any(step.get("poses") for step in table["next_measurement"]),
    )  # fmt: skip


def open_diagnosis(
    verdict_table: Mapping[str, Any], gap: Mapping[str, float | None], delivered: str, picture: page.Block,
    small: float = 0.0, *, listed: bool = True,
) -> page.Summary:  # fmt: skip
    """Return the first screen: what is wrong with the robot, and how much of the gap that explains.

    delivered: kind of the robot folder that is written; small: share of the gap that small errors everywhere carry;
    listed: whether poses to measure next stand below.
    """
    status, effects = verdict_table["status"], verdict_table["effects"]
    after, before = gap.get("held_out_after_rms_mm"), gap.get("held_out_before_rms_mm")
    first = "; ".join(describe_effect(effect) for effect in effects[:2])
    more = f"; and {len(effects) - 2} more" if len(effects) > 2 else ""
    taken_up = words.reaches_noise(gap, delivered)
    alone = " by itself, but calibration takes it up to the noise" if taken_up else ""
    verdicts = {
        "none": ("Nothing is wrong: what is left is noise of the measurement.", "good"),
        "unknown": (f"No known effect explains the gap{alone}.", "unsure"),
        "calibrated": ("The robot was not calibrated: many small errors, none of them a cause by itself.", "good"),
        "explained": (f"Found: {first}{more}.", "good"),
    }
    doubtful = [effect for effect in effects if effect.get("ambiguous_with")]
    if doubtful:
        rivals = join_names([name_effect(rival) for rival in doubtful[0]["ambiguous_with"][:2]])
        verdicts["explained"] = (f"Found, but not for certain: {first}{more}.", "unsure")
    floor = gap.get("noise_floor_mm")
    left = "A part of the gap is not explained."
    if taken_up:
        left = "The rest has no name, but calibration takes it up to the noise."
    if small > 0.5:
        left = f"Most of the gap is small errors, as of a robot that was not calibrated. {left}"
    verdict, tone = verdicts.get(status, (f"Found in part: {first}{more}. {left}", "unsure"))
    figures = []
    if before is not None and after is not None:
        figures = [
            page.KeyFigure(format_mm(1e-3 * before), "rms error of the robot model before"),
            page.KeyFigure(format_mm(1e-3 * after), "rms error of the updated one; both on rows not used for the fit",
                           "good" if after < 0.5 * before else ""),
        ]  # fmt: skip
    figures += [] if not floor else [page.KeyFigure(format_mm(1e-3 * floor), "noise of the measurement")]
    todo = "Plan with the updated robot: compplan plan JOB --robot OUT/robot."
    more_poses = "Measure more poses, as listed below" if listed else "Measure more poses, other ones than these"
    if doubtful:
        later = f" Until then: {todo[:1].lower()}{todo[1:]}" if delivered != "nominal" else ""
        todo = f"{more_poses}: {rivals} would explain the measurements as well.{later}"
    elif delivered == "nominal" and status != "none":
        todo = f"Nothing predicts better than the robot folder as it was. {more_poses}."
    elif status == "none":
        todo = "Nothing has to be done. Measure again after the next crash or service."
    return page.Summary(verdict, tone, figures, picture, todo)


def _name_log(campaign: Campaign) -> str:
    if campaign.file is None:
        return "measurements in memory"
    folder = campaign.file.resolve().parent.name
    return f"{campaign.file.stem}, {folder}" if folder else campaign.file.stem


def _list_facts(diagnosis: Diagnosis, rows: _UsedRows) -> list[tuple[str, str]]:
    campaign, left, outliers = diagnosis.fit.problem.campaign, int((~rows.used).sum()), diagnosis.outliers
    apart = f", of which {left} are left out as outliers or incomplete" if left else ""
    shown = f"rows {', '.join(str(int(row)) for row in outliers[:20])}{', …' if len(outliers) > 20 else ''}"
    return [
        *([] if campaign.file is None else [("measurements", str(campaign.file))]),
        ("rows", f"{len(rows.used)}{apart}"),
        ("robot folder that is delivered", DELIVERED[diagnosis.delivery.kind]),
        ("noise floor from", diagnosis.noise),
        ("frames fitted first", ", ".join(diagnosis.fit.problem.register) or "none"),
        ("outliers", f"{shown} ({len(outliers)}), counted from 0" if len(outliers) else "none"),
    ]


def _show_where(diagnosis: Diagnosis, split: Split, rows: _UsedRows) -> page.Section:
    shares = split.shares
    figure = draw_residuals(diagnosis.robot, rows.q, rows.point, rows.before, rows.after)
    magnified = describe_magnification(rows.point, rows.before)
    about = f"Measured minus predicted point, {magnified}; turning one scene turns the other."
    factor = draw_gap_shares(shares.by_factor, "factor")
    blocks: list[page.Block] = [
        page.Chart(figure, about, 430, True),
        page.Chart(factor, "What the error follows; lines: 95 % intervals.", 90 + 30 * len(shares.by_factor)),
    ]
    if split.traces:
        caption = (
            "The error that the named joint makes at every row, everything else explained taken out: a soft spring is "
            "a sloped line, lost motion two levels, a gear error a wave."
        )
        blocks.append(page.Chart(draw_traces(split.traces), caption, 60 + 250 * -(-len(split.traces) // 3)))
    blocks.append(page.Fold("By run, time, load, direction, approach and region", _list_splits(split)))
    return page.Section("Where it lies", blocks)


def _list_splits(split: Split) -> list[page.Block]:
    def tail(entry: Mapping[str, Any]) -> page.Row:
        interval = f"{format_percent(entry['low'])} to {format_percent(entry['high'])}"
        after = float(entry["after_rms_mm"])
        return [int(entry["rows"]), float(entry["rms_mm"]), after, format_percent(entry["share"]), interval]

    def reach(pair: Sequence[float]) -> str:
        return f"{format_number(float(pair[0]), 4)} to {format_number(float(pair[1]), 4)}"

    end, spread = ["rows", "rms [mm]", "updated [mm]", "share of the gap", "95 %"], split.spread
    times = [
        [f"{e['rows_from']} to {e['rows_to']}", reach(e["time_s"]) if "time_s" in e else "–", *tail(e)]
        for e in spread.by_time
    ]
    loads = [[reach(e["force_N"]), *tail(e)] for e in spread.by_load]
    regions = [[reach(e["reach_mm"]), reach(e["height_mm"]), *tail(e)] for e in spread.by_region]
    axes = [
        [name.replace("_", " "), format_percent(s.share), f"{format_percent(s.low)} to {format_percent(s.high)}"]
        for name, s in spread.by_axis.items()
    ]
    approach: list[page.Row] = []
    for name, numbers in split.by_approach.items():
        key = next(iter(numbers))
        size, error = numbers[key], numbers["standard_error"]
        shown = page.Cell(size, "strong" if abs(size) > 4 * error else "")
        approach.append([name, shown, error, key.rsplit("_", 1)[1]])
    blocks: list[page.Block] = [
        page.DataTable(["run", *end], [[name, *tail(entry)] for name, entry in spread.by_run.items()], "By run.", 12),
        page.DataTable(["rows of the log", "time [s]", *end], times, "By time."),
        *([page.DataTable(["force [N]", *end], loads, "By load.")] if len(loads) > 1 else []),
        page.DataTable(["reach [mm]", "height [mm]", *end], regions,
                   "By region: distance from the axis of the base, and height."),
        page.DataTable(["direction", "share of the gap", "95 %"], axes, "By direction, base axes."),
    ]  # fmt: skip
    if approach:
        caption = "Difference of a joint's position between approaches from either side; positive: it lags behind."
        blocks.append(page.DataTable(["joint", "lost motion", "standard error", "unit"], approach, caption))
    return blocks


def _show_which(table: Mapping[str, Any], structure: Sequence[str]) -> page.Section:
    effects, candidates = table["verdict"]["effects"], table["candidates"]
    blocks: list[page.Block] = []
    if effects:
        rows: list[page.Row] = []
        for effect in effects:
            rivals = "; ".join(name_effect(rival) for rival in effect.get("ambiguous_with", [])) or "nothing listed"
            sure = page.Cell(f"{effect['probability']:.2f}", "strong")
            told = describe_parameters(effect.get("parameters", {}), effect.get("interval95"))
            rows.append([name_effect(effect), sure, page.Cell(describe_change(effect) or None, "strong"), told, rivals])
        heads = ["effect", "probability", "change of the model's value, 95 %", "parameters", "may also be"]
        blocks.append(page.DataTable(heads, rows, "Effects present together, the largest share of the gap first."))
    blocks += [f"What is left: {sentence}" for sentence in structure]
    if candidates:
        rows = [[name_effect(c), float(c["probability"]), c.get("held_out_rms_mm")] for c in candidates]
        heads = ["candidate", "probability", "rms, rows not in the fit [mm, 4]"]
        blocks.append(page.DataTable(heads, rows, "All candidates, ranked.", 12))
    return page.Section("Which effect", blocks)


def _show_how_far(diagnosis: Diagnosis, gap: Mapping[str, Any], measured: _UsedRows) -> page.Section:
    floor = page.Cell(gap.get("noise_floor_mm"), "muted")
    held_out = page.Cell(gap.get("held_out_after_rms_mm"), "strong")
    rows: list[page.Row] = [
        ["nominal model", gap.get("before_rms_mm"), gap.get("held_out_before_rms_mm")],
        [page.Cell("updated model", "strong"), gap.get("after_rms_mm"), held_out],
        [page.Cell("noise floor", "muted"), floor, floor],
    ]
    heads = ["model", "all rows [mm]", "rows left out of the choice [mm]"]
    figures = page.DataTable(heads, rows, "Rms of the 3D distance, outliers left out.")
    before, after = (np.linalg.norm(side, axis=1) for side in (measured.before, measured.after))
    histogram = draw_histogram(before, after, 1e-3 * float(gap.get("noise_floor_mm") or 0.0))
    bars = page.Chart(histogram, "Deviations of all rows; dashed: what noise alone would give.", 320)
    return page.Section("How far it shrinks", [page.Columns([[figures], [bars]], (0.45, 0.55))])


def _show_next(steps: Sequence[Mapping[str, Any]]) -> page.Section:
    def name(item: Any) -> str:
        return name_effect(item) if isinstance(item, Mapping) else str(item).replace("_", " ")

    rows: list[page.Row] = []
    for step in steps:
        gain = step.get("expected_gain", step.get("expected_probability_gain"))
        how = str(step.get("how", step.get("kind", ""))) or "–"
        separates = " from ".join(map(name, step.get("separates", [])))
        rows.append([separates, how, len(step.get("poses", [])), len(step.get("wrenches", [])), gain])
    text = "Poses and loads are in diagnosis.json; all are within joint limits and the loads of this campaign."
    table = page.DataTable(["separates", "how", "poses", "loads", "expected gain"], rows)
    return page.Section("What to measure next", [table, text])
