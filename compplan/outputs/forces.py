"""What `compplan forces` writes: forces.json, forces.csv and the page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from compplan.files.origin import describe_origin
from compplan.files.tables import write_json, write_table
from compplan.files.transaction import replace_folder
from compplan.job.force_prediction import ForcePrediction
from compplan.path.toolpath import WRENCH_HEADERS


def summarise_forces(found: ForcePrediction) -> dict[str, Any]:
    """Return what forces.json holds."""
    force = np.linalg.norm(found.wrench[:, :3], axis=1)
    acts = force > 0.0
    summary: dict[str, Any] = {
        "schema": 1, "name": found.job.name, "model": found.job.process.model, "waypoints": len(found.nominal),
        "waypoints_in_contact": int(acts.sum()),
        "force_N": {"max": float(force.max()), "mean_in_contact": float(force[acts].mean()) if acts.any() else 0.0},
        "moment_Nm": {"max": float(np.linalg.norm(found.wrench[:, 3:], axis=1).max())},
        "uncertainty": getattr(found.job.process, "uncertainty", None),
        "notes": found.notes,
    }  # fmt: skip
    if found.law.cutting is not None and found.ripple is not None:
        cut = found.law.cutting.engagement
        summary["engagement"] = {
            "axial_depth_mm": {"max": float(1e3 * cut.axial.max())},
            "radial_width_mm": {"max": float(1e3 * cut.radial.max())},
            "removed_mm3": float(1e9 * (cut.section[1:] * found.nominal.steps * ~found.nominal.rapid[1:]).sum()),
        }
        summary["ripple_N"] = {"max": float(np.linalg.norm(found.ripple, axis=1).max())}
        resistance = found.law.cutting.process.resistance
        summary["coefficients"] = {
            "cutting_N_mm2": list(resistance.cutting), "edge_N_mm": list(resistance.edge),
            "exponent": list(resistance.exponent), "source": resistance.source, "assumed": resistance.assumed,
        }  # fmt: skip
    if found.fit is not None:
        summary["log"] = {
            "rows": found.fit.rows, "rms_N": found.fit.level, "rms_before_N": found.fit.rms_before,
            "rms_after_N": found.fit.rms_after, "fitted": [asdict(number) for number in found.fit.numbers],
        }  # fmt: skip
    return summary


def write_forces(found: ForcePrediction, folder: Path) -> dict[str, Any]:
    """Write forces.json, forces.csv and report.html; return what forces.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.

    """
    from compplan.report.forces_page import write_forces_page

    summary = {**summarise_forces(found), "made_by": describe_origin()}
    with replace_folder(folder, "forces") as part:
        write_table(part / "forces.csv", _tabulate(found))
        write_forces_page(found, summary, part / "report.html")
        write_json(part / "forces.json", summary)
    return summary


def _tabulate(found: ForcePrediction) -> dict[str, object]:
    """Return the table against path length, one row a waypoint."""
    nominal = found.nominal
    columns: dict[str, object] = {"s_mm": 1e3 * nominal.arc_length, "rapid": nominal.rapid.astype(np.int64)}
    columns["feed_mm_s"] = 1e3 * nominal.feed
    if found.law.cutting is not None and found.ripple is not None:
        cut = found.law.cutting.engagement
        arc = np.nan_to_num(np.degrees(cut.arc))
        columns |= {
            "axial_depth_mm": 1e3 * cut.axial, "radial_width_mm": 1e3 * cut.radial, "section_mm2": 1e6 * cut.section,
            "first_angle_deg": arc[:, 0], "last_angle_deg": arc[:, 1],
        }  # fmt: skip
        columns |= {f"ripple_{name}_N": found.ripple[:, k] for k, name in enumerate(("travel", "left", "axis"))}
    columns |= {name: found.wrench[:, k] for k, name in enumerate(WRENCH_HEADERS)}
    return columns
