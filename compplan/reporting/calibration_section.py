"""The section of a diagnosis for the one who calibrates: what to enter, how accurate, where worst, what comes next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.reporting import figure as go
from compplan.reporting.page import Block, Chart, Column, Columns, Fold, PageTable, Row, Section, TableCell
from compplan.reporting.style import AFTER, NEUTRAL, format_number, format_percent

if TYPE_CHECKING:
    from compplan.diagnosis.results.accuracy import Assessment, Learning
    from compplan.diagnosis.results.calibration import Correction, Pose

#: Regions that are listed as the worst.
WORST_REGIONS = 3
#: A change of less than this share of its half width is none: poses that see a parameter by noise alone give it more.
UNSEEN = 0.01
#: Digits behind the point, by unit.
DIGITS = {"mm": 3, "deg": 4}


def show_calibration(assessment: Assessment, regions: Sequence[Mapping[str, Any]], joints: Sequence[str]) -> Section:
    """Show what a diagnosis is worth to the one who calibrates.

    Args:
        assessment: What it is worth.
        regions: `by_region` of the gap.
        joints: Names of the joints.
    """
    blocks: list[Block] = [Columns([[_accuracy(assessment)], _more_poses(assessment.learning)], (0.5, 0.5))]
    if assessment.corrections:
        zeros = [c for c in assessment.corrections if c.effect == "joint_offset"]
        others = [c for c in assessment.corrections if c.effect != "joint_offset"]
        blocks.append(_corrections(zeros, "Zeros: add to the position that the controller counts."))
        shown = [c for c in others if c.named or c.plain]
        if shown:
            blocks.append(_corrections(shown, "Lengths, directions, tool and base that differ from the model."))
        text = "Every length and direction; lengths in axes of the parent link, tool and base in their own"
        words = "Intervals hold 95 %. Parameters that these poses do not determine are left out."
        blocks.append(Fold(text, [_corrections(others, words)]))
    else:
        blocks.append("The nominal robot is delivered as it is: there is nothing to enter.")
    blocks.append(_frames(assessment.frames))
    blocks.append(Columns([[_regions(regions)], [_poses(assessment, joints)]], (0.5, 0.5)))
    return Section("For the controller", [block for block in blocks if block is not None])


def _accuracy(assessment: Assessment) -> PageTable:
    rows: list[Row] = []
    for name, word in (("before", "nominal model"), ("after", "delivered model, not in the fit")):
        a = assessment.accuracy[name]
        rows.append([word, *(1e3 * value for value in (a.mean, a.largest, a.three_sigma, a.rms))])
    heads = [Column("pose accuracy"), *(Column(h, "mm", 3) for h in ("mean", "largest", "mean + 3 sigma", "rms"))]
    poses = assessment.accuracy["before"].poses
    caption = f"Distance between command and mean attained position (AP of ISO 9283) over {poses} poses."
    return PageTable(heads, rows, caption)


def _more_poses(learning: Learning | None) -> list[Block]:
    if learning is None:
        return ["Too few poses, or nothing delivered: the gain of more poses is unknown."]

    from compplan.diagnosis.results.accuracy import MORE

    count = np.linspace(min(learning.poses), learning.now + 2 * MORE, 60)
    figure = go.Figure()
    figure.add_scatter(x=list(learning.poses), y=[1e3 * e for e in learning.errors], mode="markers",
                       name="not in the fit", marker={"color": AFTER, "size": 7})  # fmt: skip
    figure.add_scatter(x=count, y=[1e3 * learning.at(n) for n in count], mode="lines", name="expected",
                       line={"color": NEUTRAL, "dash": "dash"})  # fmt: skip
    figure.update_xaxes(title_text="poses given")
    figure.update_yaxes(title_text="rms of the others, mm", rangemode="tozero")
    now, then = learning.at(learning.now), learning.at(learning.now + MORE)
    less, least = (format_percent(1.0 - error / now) if now > 0.0 else "0 %" for error in (then, learning.floor))
    text = f"{MORE} more poses like these would take {less} off the error, endless ones {least}. Names and noise held."
    return [Chart(figure, text, 260)]


def _corrections(corrections: Sequence[Correction], caption: str) -> PageTable:
    rows: list[Row] = []
    for c in corrections:
        if abs(c.value) < UNSEEN * (c.high - c.value):
            continue
        what = " ".join(part for part in (c.effect.replace("_", " "), c.joint, c.axis) if part)
        digits = DIGITS[c.unit]
        value = TableCell(f"{c.value:.{digits}f}", "strong" if c.plain else "muted")
        rows.append([what, value, f"{c.low:.{digits}f} to {c.high:.{digits}f}", c.unit, "named" if c.named else ""])
    heads = [Column("what"), Column("change"), Column("95 %"), Column("unit"), Column("")]
    return PageTable(heads, rows, caption, 12)


def _frames(frames: Sequence[Pose]) -> PageTable:
    def widths(values: Any, digits: int) -> str:
        return "–" if values is None else ", ".join(f"{v:.{digits}f}" for v in values)

    def halves(values: Any, digits: int) -> str:
        return "–" if values is None else f"± {widths(values, digits)}"

    rows: list[Row] = []
    for f in frames:
        rows.append([
            f.name, widths(f.position, 3), halves(f.half_position, 3), widths(f.angles, 4), halves(f.half_angles, 4),
        ])  # fmt: skip
    heads = [Column("frame"), Column("x, y, z", "mm"), Column("95 %", "mm")]
    heads += [Column("A, B, C", "deg"), Column("95 %", "deg")]
    caption = (
        "Tool: TCP in the controller's flange frame. Base: robot base in the measurement frame. A, B, C turn about z, "
        "the new y and the new x; half widths are along and about the frame's own axes."
    )
    return PageTable(heads, rows, caption)


def _regions(regions: Sequence[Mapping[str, Any]]) -> PageTable:
    worst = sorted(regions, key=lambda entry: -float(entry["after_rms_mm"]))[:WORST_REGIONS]
    rows: list[Row] = []
    for e in worst:
        reach, height = (" to ".join(format_number(float(v), 4) for v in e[k]) for k in ("reach_mm", "height_mm"))
        rows.append([reach, height, int(e["rows"]), float(e["rms_mm"]), float(e["after_rms_mm"])])
    heads = [Column("reach", "mm"), Column("height", "mm"), Column("rows"), Column("before", "mm", 3)]
    return PageTable([*heads, Column("after", "mm", 3)], rows, "Worst regions, rms of the fitted rows.")


def _poses(assessment: Assessment, joints: Sequence[str]) -> PageTable:
    rows: list[Row] = []
    for pose in assessment.worst:
        rows.append([pose.row, ", ".join(f"{v:.1f}" for v in pose.joints), 1e3 * pose.distance])
    names = f"{joints[0]} … {joints[-1]}" if len(joints) > 1 else str(joints[0])
    heads = [Column("row"), Column(names, "deg or mm"), Column("not in the fit", "mm", 3)]
    return PageTable(heads, rows, "Worst poses.")
