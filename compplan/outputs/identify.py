"""What `compplan identify` writes: identify.json, report.html, the updated robot folder, or poses to measure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compplan.files.origin import describe_origin
from compplan.files.tables import write_json, write_table, write_text
from compplan.files.transaction import replace_folder
from compplan.identify.campaign import Identification
from compplan.identify.plan_campaign import CampaignPlan
from compplan.identify.summary import SHOWN, summarise_identification
from compplan.measure.registration import write_registration
from compplan.report.identify_page import write_identification_page
from compplan.robot.folder import write_robot_folder


def write_identification(result: Identification, out: Path, log_notes: Sequence[str] = ()) -> dict[str, Any]:
    """Write identify.json, report.html and the updated robot folder, and return the summary.

    Args:
        result: The identification.
        out: Folder to write into; made if needed.
        log_notes: What the reading of the log noted.
    """
    said = {"log_notes": list(log_notes), "made_by": describe_origin()}
    summary = {**summarise_identification(result), **said}
    with replace_folder(out, "identify") as part:
        folder = part / "robot"
        write_robot_folder(result.robot, folder)
        if result.geometry != "none" and not (folder / "controller.urdf").is_file():
            # The controller goes on believing the geometry from before.
            write_text(folder / "controller.urdf", result.nominal.urdf)
        if result.registration.parts:
            write_registration(result.registration, folder / "registration.toml")
        write_json(part / "identify.json", summary)
        write_identification_page(summary, part / "report.html")
    return summary


def write_campaign_plan(plan: CampaignPlan, out: Path) -> dict[str, Any]:
    """Write poses.csv (columns of a measurement log that is yet to be measured) and poses.json.

    Args:
        plan: The plan.
        out: Folder to write into; made if needed.
    """
    columns: dict[str, object] = {"run": np.array(["static_1"] * len(plan.poses))}
    columns |= plan.robot.joint_columns(plan.poses.q)
    for k, header in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        columns[header] = plan.poses.wrench[:, k]
    entries = []
    for parameter, promised, random in zip(plan.information.parameters, plan.promised, plan.random, strict=True):
        unit, factor = SHOWN.get(parameter.unit, (parameter.unit, 1.0))
        entries.append(
            {
                "name": parameter.name,
                "unit": unit,
                "standard_error": float(f"{promised * factor:.6g}"),
                "standard_error_of_random_poses": float(f"{random * factor:.6g}"),
            }
        )
    ratio = float(np.exp(np.mean(np.log(plan.promised / plan.random))))
    summary = {
        "schema": 1,
        "robot": plan.robot.name,
        "poses": len(plan.poses),
        "ratio_to_random": float(f"{ratio:.4g}"),
        "parameters": entries,
        "assumed": "0.04 mm and 0.05 mrad standard deviation per axis of position and orientation",
        "made_by": describe_origin(),
    }
    with replace_folder(out, "identify --choose-poses") as part:
        write_table(part / "poses.csv", columns, decimals=6)
        write_json(part / "poses.json", summary)
    return summary
