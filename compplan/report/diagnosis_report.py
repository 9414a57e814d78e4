"""From a diagnosis to its page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.unmodelled import describe_unmodelled
from compplan.report.diagnosis_page import DiagnosisView, write_diagnosis
from compplan.report.effect_words import name_effect
from compplan.report.style import format_length
from compplan.robot import Array

if TYPE_CHECKING:
    from compplan.diagnose.assessment import Assessment
    from compplan.diagnose.result import Diagnosis
    from compplan.diagnose.where import Split
    from compplan.measure.campaign import Campaign
    from compplan.measure.registration import Registration

#: Kinds of robot folders in words.
DELIVERED = {
    "nominal": "the nominal robot as it was",
    "causes": "the named causes alone",
    "calibrated": "all that a calibration finds, named or not",
}


def write_diagnosis_report(
    diagnosis: Diagnosis, out: str | Path, *, split: Split | None = None, assessment: Assessment | None = None,
    table: Mapping[str, Any] | None = None,
) -> Path:  # fmt: skip
    """Write the page of a diagnosis: report.html in a folder.

    Args:
        diagnosis: The diagnosis.
        out: The folder.
        split: Where the gap lies; computed if left out.
        assessment: What it is worth to the one who calibrates; computed if left out.
        table: What diagnosis.json holds, `next_measurement` included; made from the diagnosis if left out.

    Returns:
        The file written.

    Raises:
        InputError: If the folder cannot be written.
    """
    file = Path(out) / "report.html"
    write_diagnosis(view_diagnosis(diagnosis, split, assessment, table), file)
    return file


def view_diagnosis(
    diagnosis: Diagnosis, split: Split | None = None, assessment: Assessment | None = None,
    table: Mapping[str, Any] | None = None,
) -> DiagnosisView:  # fmt: skip
    """Collect what the page of a diagnosis shows; arguments as for `write_diagnosis_report`."""
    from compplan.diagnose.assessment import assess_diagnosis
    from compplan.diagnose.where import split_diagnosis

    campaign = diagnosis.fit.problem.campaign
    table = diagnosis.to_table() if table is None else table
    used = (
        campaign.usable & np.isfinite(diagnosis.residual_before).all(1) & np.isfinite(diagnosis.residual_after).all(1)
    )
    used[diagnosis.outliers] = False
    gap, named = diagnosis.gap, bool(diagnosis.verdict.findings)
    rivals = {"generic fit of zeros and lengths": gap.generic, "best effect that is not named, alone": gap.wrong}
    for number, delivery in enumerate(diagnosis.deliveries[1:], start=1):
        rivals = {f"{delivery.folder(number)}: {DELIVERED[delivery.kind]}": delivery.held.rms, **rivals}
    parts = diagnosis.fit.problem.register
    if parts:
        rivals = {f"registration only ({', '.join(parts)})": gap.registration_only, **rivals}
    return DiagnosisView(
        title=_title(campaign),
        robot=diagnosis.robot,
        campaign=campaign,
        verdict=table["verdict"],
        gap=table["gap"],
        candidates=table["candidates"],
        next_measurement=table["next_measurement"],
        split=split or split_diagnosis(diagnosis),
        assessment=assessment or assess_diagnosis(diagnosis),
        point=_to_base(campaign.position, diagnosis.registration),
        before=diagnosis.residual_before,
        after=diagnosis.residual_after,
        used=used,
        rivals=rivals,
        delivered=diagnosis.deliveries[0].kind,
        structure=_describe_structure(diagnosis, named),
        facts=[
            ("robot folder that is delivered", DELIVERED[diagnosis.deliveries[0].kind]),
            ("noise floor from", diagnosis.noise),
            ("frames fitted first", ", ".join(parts) or "none"),
            ("outliers", _list_rows(diagnosis.outliers)),
        ],
        notes=[
            f"Considered and not named: {name_effect(effect)} (probability {effect['probability']:.2f})."
            for effect in table["verdict"].get("doubtful", [])
        ],
    )


def _title(campaign: Campaign) -> str:
    if campaign.file is None:
        return "Measurement campaign"
    folder = campaign.file.resolve().parent.name
    return f"{campaign.file.stem}, {folder}" if folder else campaign.file.stem


def _to_base(position: Array, registration: Registration | None) -> Array:
    """Express measured points in the robot's base frame [m]. Shape (n, 3)."""
    if registration is None:
        return position
    return np.asarray((position - registration.base[:3, 3]) @ registration.base[:3, :3])


def _describe_structure(diagnosis: Diagnosis, named: bool) -> list[str]:
    """Say what is left that no effect explains."""
    structure = diagnosis.verdict.structure
    if not structure.left:
        return []
    # claims may move the target further than the gap, against small errors: they explain no more than there is
    explained = format_length(min(structure.explained, structure.gap))
    against = f", against {explained} that the named effects explain" if named else ""
    if structure.dependences:
        parts = [
            f"{format_length(d.explained)} rms is {describe_unmodelled(d.effect.joint, str(d.effect.axis))}"
            for d in structure.dependences
        ]
        return [f"An error that no effect of the vocabulary makes: {'; '.join(parts)}{against}."]
    return [
        f"An error of {format_length(structure.rms)} rms stays the same while the robot stands still and follows "
        f"no effect of the vocabulary{against}."
    ]


def _list_rows(rows: NDArray[np.int_]) -> str:
    if not len(rows):
        return "none"
    shown = ", ".join(str(int(row)) for row in rows[:20])
    return f"rows {shown}{', …' if len(rows) > 20 else ''} ({len(rows)}), counted from 0"
