"""Outputs of `compplan diagnose`: diagnosis.json, the updated robot folder, and the page.

The page shows the gap by place, the effects that cause it, its reduction, and the corrections for the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis import Diagnosis
from compplan.diagnosis.data.conventions import name_convention
from compplan.diagnosis.results.assessment import Assessment, Correction, Pose, assess_diagnosis
from compplan.diagnosis.results.next_measurement import propose_measurements
from compplan.diagnosis.results.shares import CALIBRATION, Share
from compplan.diagnosis.results.verdict import FLOORS_LEFT
from compplan.diagnosis.results.where import Split, split_diagnosis
from compplan.diagnosis.self_test import SelfTest
from compplan.errors import InputError
from compplan.io.palette import CATEGORIES
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_mm, format_percent
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import replace_folder
from compplan.measurement.registration import write_registration
from compplan.reporting import diagnosis_text as words
from compplan.reporting.charts import Bars, Figure, draw_bars, thin_rows
from compplan.reporting.diagnosis_text import describe_change, describe_effect, describe_parameters, name_effect
from compplan.reporting.page import Block, Cell, Chart, DataTable, Fold, Section, Summary, render_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.scenes import (
    add_path,
    add_shapes,
    choose_magnification,
    colour_axis,
    describe_magnification,
    frame_scenes,
    place_shapes,
)
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Array, Robot
from compplan.simulation.predict import predict_campaign

#: Allowed difference of predictions by the written and the updated robot (theory: rounding of the equilibrium). [m]
SAME_POSITION = 1e-9
#: Share of its half width below which a change is omitted: noise alone gives an observed parameter more.
UNSEEN = 0.01
#: Decimal places, by unit.
DIGITS = {"mm": 3, "deg": 4}
#: Greatest number of drawn residual vectors.
VECTORS = 900
#: Descriptions of the kinds of robot folders.
DELIVERED = {"nominal": "nominal robot, unchanged", "calibrated": "calibrated robot: all estimated errors"}


def deliver_diagnosis(
    diagnosis: Diagnosis, out: Path, progress: Callable[[str], None] = lambda text: None,
    tested: SelfTest | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Locate the gap, assess the accuracy, propose the next measurements, and write all results.

    `tested`: self-test of the campaign. Returns the content of diagnosis.json.
    """
    progress("where")
    split = split_diagnosis(diagnosis)
    progress("accuracy")
    assessment = assess_diagnosis(diagnosis)
    progress("what to measure next")
    extra = {"where": split.to_json(), **assessment.to_json(), "next_measurement": propose_measurements(diagnosis)}
    extra |= {} if tested is None else {"self_test": tested.to_json()}
    table = {**diagnosis.to_table(extra), "log_notes": list(diagnosis.fit.problem.campaign.notes)}
    progress("report")
    return write_diagnosis(diagnosis, split, assessment, table, out)


def write_diagnosis(
    diagnosis: Diagnosis, split: Split, assessment: Assessment, table: Mapping[str, Any], out: Path
) -> dict[str, Any]:
    """Write diagnosis.json, report.html and the updated robot folder; return the content of diagnosis.json."""
    table = {**table, "made_by": describe_origin()}
    with replace_folder(out, "diagnose") as part:
        folder, registration = part / "robot", diagnosis.delivery.state.registration
        read = deliver_robot_folder(diagnosis.updated, folder, diagnosis.robot)
        table["gap"] = {**table["gap"], "after_rms_mm": round(1e3 * _measure_gap(diagnosis, read, folder), 5)}
        if registration is not None:
            write_registration(registration, folder / "registration.toml")
        write_text(part / "report.html", render_diagnosis(diagnosis, split, assessment, table))
        write_json(part / "diagnosis.json", table, indent=2)
    return table


def _measure_gap(diagnosis: Diagnosis, robot: Robot, folder: Path) -> float:
    """Return the root mean square gap of a robot read from its folder, over the rows without outliers. [m]"""
    campaign, delivery = diagnosis.fit.problem.campaign, diagnosis.delivery
    registration = delivery.state.registration
    gap = predict_campaign(robot, campaign, registration=registration, later=False).gap
    expected = delivery.residual
    if registration is not None and registration.contacts:  # a prediction refits the contact positions
        expected = predict_campaign(diagnosis.updated, campaign, registration=registration, later=False).gap
    good = campaign.usable.copy()
    alike = good
    if any(effect.name == "backlash" for effect in delivery.state.effects):
        alike = good & ~campaign.first_visit  # their approach is fitted, not stored in a folder
    off = float(np.abs(gap[alike] - expected[alike]).max(initial=0.0))
    if off > SAME_POSITION:
        message = f"the folder as read predicts tips {1e3 * off:.3g} mm off the validated model; report a defect"
        raise InputError(message, file=folder)
    good[diagnosis.outliers] = False
    return float(np.sqrt(np.mean(np.sum(gap[good] ** 2, axis=1))))


class _UsedRows(NamedTuple):
    """Measured rows for charts, without outliers and incomplete rows; k of n rows, base axes."""

    used: NDArray[np.bool_]  #: Selected rows; the others are outliers or incomplete. Shape (n,).
    q: Array  #: Joint positions. Shape (k, nq). [rad or m]
    point: Array  #: Measured points. Shape (k, 3). [m]
    before: Array  #: Measured minus predicted by the nominal robot. Shape (k, 3). [m]
    after: Array  #: Measured minus predicted by the updated robot. Shape (k, 3). [m]


def render_diagnosis(
    diagnosis: Diagnosis, split: Split, assessment: Assessment | None, table: Mapping[str, Any]
) -> str:
    """Return the page of a diagnosis; `table`: content of diagnosis.json; no corrections without `assessment`."""
    campaign, before, after = diagnosis.fit.problem.campaign, diagnosis.residual_before, diagnosis.residual_after
    used = campaign.usable & np.isfinite(before).all(1) & np.isfinite(after).all(1)
    used[diagnosis.outliers] = False
    rows = _UsedRows(used, np.nan_to_num(campaign.q[used]), diagnosis.points[used], before[used], after[used])
    structure, robot, kind = words.describe_structure(diagnosis), diagnosis.robot, diagnosis.delivery.kind
    verdict, gap, steps = table["verdict"], table["gap"], table["next_measurement"]
    sections = [_show_where(diagnosis, split, rows), _show_which(table, structure), _show_how_far(gap)]
    sections += [] if assessment is None else [_show_calibration(assessment)]
    sections += [_show_next(steps)] if steps else []
    sections += [_show_self_test(table["self_test"])] if "self_test" in table else []
    notes = [
        f"Considered and not named: {name_effect(effect)} "
        + (f"({effect['beyond']})." if "beyond" in effect else f"(probability {effect['probability']:.2f}).")
        for effect in verdict.get("doubtful", [])
    ]
    if convention := name_convention(robot, [finding.effect for finding in diagnosis.verdict.findings]):
        notes.append(f"The joints of the log are counted as a {convention} counts them.")
    caption = "Share of the error by place. Lines: 95 % intervals; where one is long, another place explains it as well"
    picture = Chart(draw_gap_shares(split.shares.by_place, "place"), f"{caption}.", 330)
    todo = words.describe_next(table, kind, "below")
    name = "measurements in memory"
    if campaign.file is not None:
        name = ", ".join(filter(None, (campaign.file.stem, campaign.file.resolve().parent.name)))
    return render_page(
        f"{robot.name}: diagnosis",
        open_diagnosis(verdict, gap, kind, picture, todo, split.shares.by_place[CALIBRATION].share),
        [section for section in sections if section.blocks], kind=f"Diagnosis of {name}",
        notes=notes,
        provenance=describe_robot(robot, _list_facts(diagnosis, rows)),
    )  # fmt: skip


def open_diagnosis(
    table: Mapping[str, Any], gap: Mapping[str, float | None], delivered: str, picture: Block | None, todo: str,
    small: float = 0.0,
) -> Summary:  # fmt: skip
    """Return the first screen: identified effects, and the error before and after the update.

    table: the verdict of diagnosis.json; delivered: kind of the robot folder that is written; todo: the next step;
    small: share of the gap due to small errors of all parameters.
    """
    status, effects = table["status"], table["effects"]
    first = "; ".join(describe_effect(effect) for effect in effects[:2])
    first += f"; and {len(effects) - 2} more" if len(effects) > 2 else ""
    taken_up = words.reaches_noise(gap, delivered)
    alone = " alone: many small errors fit these poses, but hardly those left out" if small > 0.5 else ""
    alone = " alone, but the calibrated model reduces it to the noise" if taken_up else alone
    verdicts = {
        "none": ("No error found: the gap is not larger than the measurement noise.", "good"),
        "unknown": (f"No known effect explains the gap{alone}.", "unsure"),
        "calibrated": ("The robot is not calibrated: the gap comes from many small errors, none dominates.", "good"),
        "explained": (f"Found: {first}.", "good"),
    }
    rivals = [len(effect.get("ambiguous_with", [])) for effect in effects]
    after, before, floor = map(gap.get, ("held_out_after_rms_mm", "held_out_before_rms_mm", "noise_floor_mm"))
    if any(rivals):
        fit = "other effects fit" if sum(rivals) > 1 else "another effect fits"
        verdicts["explained"] = (f"Found, but {fit} as well: {first}.", "unsure")
    elif after and floor and after > FLOORS_LEFT * floor:
        verdicts["explained"] = (f"Found, but more than the noise remains: {first}.", "unsure")
    left = "The rest matches no known effect, but the calibrated model reduces it to the noise." if taken_up else (
        "A part of the gap is not explained.")  # fmt: skip
    if small > 0.5:
        left = f"Most of the gap comes from many small errors, as of an uncalibrated robot. {left}"
    verdict, tone = verdicts.get(status, (f"Found: {first}. {left}", "unsure"))
    figures: list[tuple[str, ...]] = []
    if before is not None and after is not None:
        figures = [
            (format_mm(1e-3 * before), "rms error of the robot model before, at poses not used for the fit"),
            (format_mm(1e-3 * after), "the same of the updated model", "good" if after < 0.5 * before else ""),
        ]  # fmt: skip
    if floor:
        figures.append((format_mm(1e-3 * floor), "measurement noise"))
    return Summary(verdict, tone, figures, picture, todo)


def _list_facts(diagnosis: Diagnosis, rows: _UsedRows) -> list[tuple[str, str]]:
    campaign, left, outliers = diagnosis.fit.problem.campaign, int((~rows.used).sum()), diagnosis.outliers
    apart = f", of which {left} are left out as outliers or incomplete" if left else ""
    shown = f"rows {', '.join(str(int(row)) for row in outliers[:20])}{', …' if len(outliers) > 20 else ''}"
    return [
        *([] if campaign.file is None else [("measurements", str(campaign.file))]),
        ("rows", f"{len(rows.used)}{apart}"),
        ("robot folder that is delivered", DELIVERED[diagnosis.delivery.kind]),
        ("noise floor from", diagnosis.noise),
        *([] if diagnosis.repeats is None else [("poses measured again", diagnosis.repeats.sentence)]),
        ("frames fitted first", ", ".join(diagnosis.fit.problem.register) or "none"),
        ("outliers", f"{shown} ({len(outliers)}), counted from 0" if len(outliers) else "none"),
    ]


def _show_where(diagnosis: Diagnosis, split: Split, rows: _UsedRows) -> Section:
    shares, magnified = split.shares, describe_magnification(rows.point, rows.before)
    blocks: list[Block] = [
        Chart(draw_residuals(diagnosis.robot, rows.q, rows.point, rows.before, rows.after),
              f"Measured minus predicted point, {magnified}; turning one scene turns the other.", 430, True),
        Chart(draw_gap_shares(shares.by_factor, "factor"), "What the error follows; lines: 95 % intervals.",
              90 + 30 * len(shares.by_factor)),
    ]  # fmt: skip
    if split.small_errors is not None and split.small_errors.groups:
        kinds = [
            [place, kind, format_percent(one.share), f"{format_percent(one.low)} to {format_percent(one.high)}"]
            for place, kind, one in split.small_errors.groups
        ]
        caption = "The gap divided among all errors of the updated robot, named or not, by place and kind."
        blocks.append(DataTable(["place", "kind", "share of the gap", "95 %"], kinds, caption, 12))
    return Section("Where it lies", blocks)


def _show_which(table: Mapping[str, Any], structure: Sequence[str]) -> Section:
    effects, candidates = table["verdict"]["effects"], table["candidates"]
    blocks: list[Block] = []
    if effects:
        rows = []
        for effect in effects:
            rivals = "; ".join(name_effect(rival) for rival in effect.get("ambiguous_with", [])) or "nothing listed"
            sure, change = Cell(f"{effect['probability']:.2f}", "strong"), describe_change(effect) or None
            sizes = describe_parameters(effect.get("parameters", {}), effect.get("interval95"))
            rows.append([name_effect(effect), sure, Cell(change, "strong"), sizes, rivals])
        heads = ["effect", "probability", "change of the model's value, 95 %", "parameters", "may also be"]
        blocks.append(DataTable(heads, rows, "Effects present together, the largest share of the gap first."))
    blocks += [f"What is left: {sentence}" for sentence in structure]
    if candidates:
        rows = [[name_effect(c), float(c["probability"]), c.get("held_out_rms_mm")] for c in candidates]
        heads = ["candidate", "probability", "rms, rows not in the fit [mm, 4]"]
        blocks.append(DataTable(heads, rows, "All candidates, ranked.", 12))
    return Section("Which effect", blocks)


def _show_how_far(gap: Mapping[str, Any]) -> Section:
    floor = Cell(gap.get("noise_floor_mm"), "muted")
    rows: list[list[Any]] = [
        ["nominal model", gap.get("before_rms_mm"), gap.get("held_out_before_rms_mm")],
        [Cell("updated model", "strong"), gap.get("after_rms_mm"), Cell(gap.get("held_out_after_rms_mm"), "strong")],
        [Cell("noise floor", "muted"), floor, floor],
    ]  # fmt: skip
    heads = ["model", "all rows [mm]", "rows left out of the choice [mm]"]
    figures = DataTable(heads, rows, "Rms of the 3D distance, outliers left out.")
    return Section("How far it shrinks", [figures])


def _show_next(steps: Sequence[Mapping[str, Any]]) -> Section:
    rows = []
    for step in steps:
        gain = step.get("expected_gain", step.get("expected_probability_gain"))
        how = str(step.get("how", step.get("kind", ""))) or "–"
        separates = [name_effect(item) if isinstance(item, Mapping) else str(item).replace("_", " ")
                     for item in step.get("separates", [])]  # fmt: skip
        rows.append([" from ".join(separates), how, len(step.get("poses", [])), gain])
    text = "Poses and loads are in diagnosis.json; all are within joint limits and the loads of this campaign."
    return Section("What to measure next", [DataTable(["separates", "how", "poses", "expected gain"], rows), text])


def _show_self_test(tested: Mapping[str, Any]) -> Section:
    """Show which effects, planted in these poses and this noise, the diagnosis found."""
    rows = []
    for planted in tested["planted"]:
        named = "; ".join(f"{name_effect(one)} ({one['probability']:.2f})" for one in planted["named"])
        tone = "strong" if planted["outcome"] == "found" else "muted"
        size = describe_parameters(planted["parameters"])
        rows.append([name_effect(planted), planted["moved_rms_mm"], size, Cell(planted["outcome"], tone), named or "–"])
    heads = ["planted", "moves the target [mm]", "parameters", "outcome", "named (probability)"]
    caption = ("One effect a diagnosis, among small errors as large as those of this campaign; tied: an effect that the"
               " poses cannot tell from it is named.")  # fmt: skip
    lines = words.describe_self_test(tested)
    return Section("Self-test", [DataTable(heads, rows, caption, 12), lines[0], lines[-1].strip()])


def _show_calibration(assessment: Assessment) -> Section:
    """Show pose accuracy before and after, and the corrections for the controller."""
    accuracy = []
    for name, word in (("before", "nominal model"), ("after", "delivered model, not in the fit")):
        a = assessment.accuracy[name]
        accuracy.append([word, a.mean_mm, a.max_mm, a.mean_and_3_sigma_mm, a.rms_mm])
    caption = "Distance between command and mean attained position (AP of ISO 9283) over "
    heads = ["pose accuracy", "mean [mm]", "largest [mm]", "mean + 3 sigma [mm]", "rms [mm]"]
    table = DataTable(heads, accuracy, f"{caption}{assessment.accuracy['before'].poses} poses.")
    blocks: list[Block] = [table]
    if assessment.corrections:
        zeros = [c for c in assessment.corrections if c.effect == "joint_offset"]
        others = [c for c in assessment.corrections if c.effect != "joint_offset"]
        blocks += _list_corrections(zeros, "Zeros: add to the position that the controller counts.")
        if shown := [c for c in others if c.named or c.plain]:
            caption = "Lengths, directions, tool and base that differ from the model."
            blocks += _list_corrections(shown, caption)
        text = "Every length and direction; lengths in axes of the parent link, tool and base in their own"
        caption = "Intervals hold 95 %. Parameters that these poses do not determine are left out."
        every = _list_corrections(others, caption)
        blocks.append(Fold(text, every) if every else "No length or direction is certain enough to be entered.")
    else:
        blocks.append("The nominal robot is delivered as it is: there is nothing to enter.")
    return Section("For the controller", [*blocks, _list_frames(assessment.frames)])


def _list_corrections(corrections: Sequence[Correction], caption: str) -> list[Block]:
    """List corrections in a table; no table if all are too small."""
    rows = []
    for c in corrections:
        if abs(c.value) >= UNSEEN * (c.high - c.value):
            what = " ".join(part for part in (c.effect.replace("_", " "), c.joint, c.axis) if part)
            value, low, high = (f"{number:.{DIGITS[c.unit]}f}" for number in (c.value, c.low, c.high))
            tone = "strong" if c.plain else "muted"
            rows.append([what, Cell(value, tone), f"{low} to {high}", c.unit, "named" if c.named else ""])
    return [DataTable(["what", "change", "95 %", "unit", ""], rows, caption, 12)] if rows else []


def _list_frames(frames: Sequence[Pose]) -> DataTable:
    def show(values: Any, digits: int, sign: str = "") -> str:
        return "–" if values is None else sign + ", ".join(f"{v:.{digits}f}" for v in values)

    rows = [
        [f.name, show(f.position, 3), show(f.half_position, 3, "± "), show(f.angles, 4), show(f.half_angles, 4, "± ")]
        for f in frames
    ]
    caption = (
        "Tool: TCP in the controller's flange frame. Base: robot base in the measurement frame. A, B, C turn about z, "
        "the new y and the new x; half widths are along and about the frame's own axes."
    )
    return DataTable(["frame", "x, y, z [mm]", "95 % [mm]", "A, B, C [deg]", "95 % [deg]"], rows, caption)


def draw_residuals(robot: Robot, q: Array, point: Array, before: Array, after: Array) -> Figure:
    """Draw residual vectors in space, before and after, with the robot in a middle pose.

    q: joints of the rows, shape (n, nq) [rad or m]; point: measured points, base frame; before, after: measured minus
    predicted by the nominal and the updated model, shape (n, 3) [m].
    """
    sizes = [np.linalg.norm(side, axis=1) for side in (before, after)]
    rows = thin_rows([sizes[0]], VECTORS)
    factor = choose_magnification(point, before)
    titles = [
        f"{name}: rms {format_length(float(np.sqrt(np.mean(size**2))))}"
        for name, size in zip(("nominal model", "updated model"), sizes, strict=True)
    ]
    figure = Figure(titles, 2, gaps=(0.01, 0.0), scenes=True)
    shapes = place_shapes(robot, q[int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(1)))])
    for panel, (side, size) in enumerate(zip((before, after), sizes, strict=True)):
        add_shapes(figure, shapes, robot.name, 0.35, panel)
        ends = np.full((len(rows), 3, 3), np.nan)
        ends[:, 0], ends[:, 1] = 1e3 * point[rows], 1e3 * (point[rows] + factor * side[rows])
        colour = np.repeat(1e3 * size[rows], 3)
        add_path(
            figure, ends.reshape(-1, 3), "residual", colour, 4, panel=panel, coloraxis="coloraxis",
            custom=np.column_stack([np.repeat(rows, 3), colour]),
            hover="row %{customdata[0]:.0f}: %{customdata[1]:.3g} mm",
        )  # fmt: skip
    corners = [1e3 * shape.vertices for shape in shapes]
    frame_scenes(figure, np.vstack([1e3 * point, 1e3 * (point + factor * before), *corners]), top=30)
    top = float(np.percentile(sizes[0], 99)) * 1e3
    figure.layout |= {"showlegend": False, "coloraxis": colour_axis("deviation, mm", 0.0, top)}
    return figure


def draw_gap_shares(shares: Mapping[str, Share], title: str) -> Figure:
    """Draw shares of the gap as bars with their intervals; `title`: criterion of the division."""
    value, low, high = 100 * np.array([(s.share, s.low, s.high) for s in shares.values()]).reshape(-1, 3).T
    bars = Bars(value, CATEGORIES[0], low, high)
    figure = draw_bars(list(shares), {"": bars}, f"share of the gap by {title}, %", hover="%{x:.1f} %")
    figure.axis("x", range=[0, 104])
    return figure
