"""What `compplan identify` writes: identify.json, report.html, the updated robot folder, or poses to measure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from compplan.files.columns import to_unit
from compplan.files.tables import write_table, write_text
from compplan.identify.campaign import Identification
from compplan.identify.plan_campaign import CampaignPlan
from compplan.identify.summary import SHOWN, summarise_identification
from compplan.measure.registration import write_registration
from compplan.report.identify_page import write_identification_page
from compplan.robot.folder import write_robot_folder


def write_identification(result: Identification, out: Path) -> dict[str, Any]:
    """Write identify.json, report.html and the updated robot folder, and return the summary.

    Args:
        result: The identification.
        out: Folder to write into; made if needed.
    """
    summary = summarise_identification(result)
    out.mkdir(parents=True, exist_ok=True)
    folder = out / "robot"
    write_robot_folder(result.robot, folder)
    if result.geometry != "none" and not (folder / "controller.urdf").is_file():
        # The controller goes on believing the geometry from before.
        write_text(folder / "controller.urdf", result.nominal.urdf)
    if result.registration.parts:
        write_registration(result.registration, folder / "registration.toml")
    write_text(out / "identify.json", json.dumps(summary, indent=1) + "\n")
    write_identification_page(summary, out / "report.html")
    return summary



def write_campaign_plan(plan: CampaignPlan, out: Path) -> dict[str, Any]:
    """Write poses.csv (columns of a measurement log that is yet to be measured) and poses.json.

    Args:
        plan: The plan.
        out: Folder to write into; made if needed.
    """
    out.mkdir(parents=True, exist_ok=True)
    columns: dict[str, object] = {"run": np.array(["static_1"] * len(plan.poses))}
    for k, slides in enumerate(plan.robot.prismatic, 1):
        header = f"q{k}_mm" if slides else f"q{k}_deg"
        columns[header] = to_unit(plan.poses.q[:, k - 1], header)
    for k, header in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        columns[header] = plan.poses.wrench[:, k]
    write_table(out / "poses.csv", columns, decimals=6)
    entries = []
    for parameter, promised, random in zip(plan.information.parameters, plan.promised, plan.random, strict=True):
        unit, factor = SHOWN[parameter.unit]
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
    }
    write_text(out / "poses.json", json.dumps(summary, indent=1) + "\n")
    return summary

