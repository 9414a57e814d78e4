"""The section of a diagnosis for the one who calibrates: what to enter, how accurate, where worst."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from compplan.reporting import page

if TYPE_CHECKING:
    from compplan.diagnosis.results.assessment import Assessment, Correction, Pose

#: A change of less than this share of its half width is none: poses that see a parameter by noise alone give it more.
UNSEEN = 0.01
#: Digits behind the point, by unit.
DIGITS = {"mm": 3, "deg": 4}


def show_calibration(assessment: Assessment, joints: Sequence[str]) -> page.Section:
    """Show what a diagnosis is worth to the one who calibrates."""
    blocks: list[page.Block] = [_accuracy(assessment)]
    if assessment.corrections:
        zeros = [c for c in assessment.corrections if c.effect == "joint_offset"]
        others = [c for c in assessment.corrections if c.effect != "joint_offset"]
        blocks.append(_corrections(zeros, "Zeros: add to the position that the controller counts."))
        shown = [c for c in others if c.named or c.plain]
        if shown:
            blocks.append(_corrections(shown, "Lengths, directions, tool and base that differ from the model."))
        text = "Every length and direction; lengths in axes of the parent link, tool and base in their own"
        words = "Intervals hold 95 %. Parameters that these poses do not determine are left out."
        blocks.append(page.Fold(text, [_corrections(others, words)]))
    else:
        blocks.append("The nominal robot is delivered as it is: there is nothing to enter.")
    blocks.append(_frames(assessment.frames))
    blocks.append(_poses(assessment, joints))
    return page.Section("For the controller", blocks)


def _accuracy(assessment: Assessment) -> page.DataTable:
    rows: list[page.Row] = []
    for name, word in (("before", "nominal model"), ("after", "delivered model, not in the fit")):
        a = assessment.accuracy[name]
        rows.append([word, a.mean_mm, a.max_mm, a.mean_and_3_sigma_mm, a.rms_mm])
    poses = assessment.accuracy["before"].poses
    caption = f"Distance between command and mean attained position (AP of ISO 9283) over {poses} poses."
    return page.DataTable(
        ["pose accuracy", "mean [mm]", "largest [mm]", "mean + 3 sigma [mm]", "rms [mm]"], rows, caption
    )


def _corrections(corrections: Sequence[Correction], caption: str) -> page.DataTable:
    rows: list[page.Row] = []
    for c in corrections:
        if abs(c.value) < UNSEEN * (c.high - c.value):
            continue
        what = " ".join(part for part in (c.effect.replace("_", " "), c.joint, c.axis) if part)
        digits = DIGITS[c.unit]
        value = page.Cell(f"{c.value:.{digits}f}", "strong" if c.plain else "muted")
        rows.append([what, value, f"{c.low:.{digits}f} to {c.high:.{digits}f}", c.unit, "named" if c.named else ""])
    return page.DataTable(["what", "change", "95 %", "unit", ""], rows, caption, 12)


def _frames(frames: Sequence[Pose]) -> page.DataTable:
    def show(values: Any, digits: int, sign: str = "") -> str:
        return "–" if values is None else sign + ", ".join(f"{v:.{digits}f}" for v in values)

    rows: list[page.Row] = [
        [f.name, show(f.position, 3), show(f.half_position, 3, "± "), show(f.angles, 4), show(f.half_angles, 4, "± ")]
        for f in frames
    ]
    caption = (
        "Tool: TCP in the controller's flange frame. Base: robot base in the measurement frame. A, B, C turn about z, "
        "the new y and the new x; half widths are along and about the frame's own axes."
    )
    return page.DataTable(["frame", "x, y, z [mm]", "95 % [mm]", "A, B, C [deg]", "95 % [deg]"], rows, caption)


def _poses(assessment: Assessment, joints: Sequence[str]) -> page.DataTable:
    rows: list[page.Row] = [
        [pose["row"], ", ".join(f"{v:.1f}" for v in pose["joints_deg_or_mm"]), pose["held_out_mm"]]
        for pose in assessment.worst
    ]
    names = f"{joints[0]} … {joints[-1]}" if len(joints) > 1 else str(joints[0])
    return page.DataTable(["row", f"{names} [deg or mm]", "not in the fit [mm]"], rows, "Worst poses.")
