"""What `compplan diagnose` writes: diagnosis.json, report.html and the updated robot folders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compplan.diagnosis import Diagnosis
from compplan.diagnosis.results.accuracy import Assessment, assess_diagnosis
from compplan.diagnosis.results.delivery import Delivery
from compplan.diagnosis.results.next_measurement import propose_measurements
from compplan.diagnosis.results.where import Split, split_diagnosis
from compplan.errors import InputError
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json
from compplan.io.transaction import replace_folder
from compplan.measurement.registration import write_registration
from compplan.reporting.diagnosis_page import write_diagnosis_page
from compplan.reporting.writers.recording import write_gap
from compplan.reporting.writers.robot_folder import deliver_robot_folder
from compplan.robot import Robot
from compplan.simulation.predict import predict_campaign

#: A written robot reproduces the predictions in memory to this (theory: rounding of the solved equilibrium). [m]
SAME_POSITION = 1e-9


def deliver_diagnosis(
    diagnosis: Diagnosis, out: Path, progress: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, Any], Assessment]:
    """Ask where the gap lies, what the folders are worth and what to measure next; write all of it.

    Args:
        diagnosis: The diagnosis.
        out: The folder.
        progress: Told what is being done.

    Returns:
        What diagnosis.json holds, and what the folders are worth.

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
    return write_diagnosis(diagnosis, split, assessment, table, out), assessment


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
            read = deliver_robot_folder(diagnosis.robot_of(delivery), folder, diagnosis.robot)
            after = measure_gap(diagnosis, read, delivery, folder)
            if number == 0:
                table["gap"] = {**table["gap"], "after_rms_mm": round(1e3 * after, 5)}
            if delivery.state.registration is not None:
                write_registration(delivery.state.registration, folder / "registration.toml")
        write_diagnosis_page(diagnosis, part / "report.html", split, assessment, table)
        write_gap(diagnosis, split.shares, part)
        write_json(part / "diagnosis.json", table, indent=2)
    return table


def measure_gap(diagnosis: Diagnosis, robot: Robot, delivery: Delivery, folder: Path) -> float:
    """Return the root mean square gap of a robot as read from its folder over the rows that are no outliers. [m]

    Raises:
        InputError: If the folder predicts other positions than the model that was judged.
    """
    campaign = diagnosis.fit.problem.campaign
    registration = delivery.state.registration
    gap = predict_campaign(robot, campaign, registration=registration, later=False).gap
    expected = delivery.residual
    if registration is not None and registration.contacts:  # the places of contacts are fitted anew by a prediction
        in_memory = diagnosis.robot_of(delivery)
        expected = predict_campaign(in_memory, campaign, registration=registration, later=False).gap
    good = campaign.usable.copy()
    alike = good
    if any(effect.name == "backlash" for effect in delivery.state.effects):
        alike = good & ~campaign.first_visit  # their approach is fitted, no folder holds it
    off = float(np.abs(gap[alike] - expected[alike]).max(initial=0.0))
    if off > SAME_POSITION:
        raise InputError(f"the robot as read differs by {1e3 * off:.3g} mm from the validated one", file=folder)
    good[diagnosis.outliers] = False
    return float(np.sqrt(np.mean(np.sum(gap[good] ** 2, axis=1))))
