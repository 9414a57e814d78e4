"""What `compplan diagnose` writes: diagnosis.json, report.html and the updated robot folders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compplan.diagnose import Diagnosis
from compplan.diagnose.answer.assessment import Assessment
from compplan.diagnose.answer.where import Split
from compplan.files.origin import describe_origin
from compplan.files.tables import write_json
from compplan.files.transaction import replace_folder
from compplan.measure.registration import write_registration
from compplan.outputs.cell import write_gap
from compplan.report.diagnosis_page import write_diagnosis_page
from compplan.robot.folder import write_robot_folder


def write_diagnosis(
    diagnosis: Diagnosis, split: Split, assessment: Assessment, table: Mapping[str, Any], out: Path
) -> dict[str, Any]:
    """Write diagnosis.json, report.html and the updated robot folders; return what diagnosis.json holds.

    Args:
        diagnosis: The diagnosis.
        split: Where the gap lies.
        assessment: What it is worth to the one who calibrates.
        table: What `Diagnosis.to_table` gave.
        out: The folder.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    table = {**table, "made_by": describe_origin()}
    with replace_folder(out, "diagnose") as part:
        for number, delivery in enumerate(diagnosis.deliveries):
            folder = part / delivery.folder(number)
            write_robot_folder(diagnosis.robot_of(delivery), folder)
            if delivery.state.registration is not None:
                write_registration(delivery.state.registration, folder / "registration.toml")
        write_diagnosis_page(diagnosis, part / "report.html", split, assessment, table)
        write_gap(diagnosis, split.shares, part)
        write_json(part / "diagnosis.json", table, indent=2)
    return table
