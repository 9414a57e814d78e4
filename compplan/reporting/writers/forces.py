"""What `compplan forces` writes: forces.json, forces.csv and the page."""

from __future__ import annotations

import datetime
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import ValidationError

from compplan.errors import InputError
from compplan.io.notes import list_stops
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json, write_table, write_text
from compplan.io.transaction import replace_folder
from compplan.job.force_prediction import ForcePrediction
from compplan.process.cutting import CoefficientTable
from compplan.process.learned_force import (
    SCATTER,
    LearnedForce,
    LearnedPartTable,
    add_part,
    find_axes,
    read_learned_force,
    write_learned_force,
)
from compplan.process.wrench import Process
from compplan.toolpath.toolpath import WRENCH_HEADERS

#: Largest ratio of measured and predicted force that is learned.
MOST_LEVEL = 100.0
#: What is left of the stock: part frame, millimetres.
STOCK = "stock.stl"


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
        "uncertainty_stated": _states_uncertainty(found.job.process),
        "notes": found.notes,
    }  # fmt: skip
    summary["stops"] = list_stops(summary["notes"])
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
            "level": found.fit.ratio[0], "level_sigma": found.fit.ratio[1], "notes": list(found.fit.notes),
        }  # fmt: skip
    return summary


def _states_uncertainty(process: Process) -> bool:
    """Tell whether the job states the uncertainty of its force, in place of an assumed one."""
    return any("uncertainty" in table.model_fields_set for table in (process, getattr(process, "coefficients", None))
               if table is not None)  # fmt: skip


def write_forces(found: ForcePrediction, folder: Path) -> dict[str, Any]:
    """Write forces.json, forces.csv, report.html, and what a cutter leaves of its stock; return what forces.json holds.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.

    """
    from compplan.reporting.forces_page import write_forces_page

    summary = {**summarise_forces(found), "made_by": describe_origin()}
    with replace_folder(folder, "forces") as part:
        write_table(part / "forces.csv", _tabulate(found))
        write_forces_page(found, summary, part / "report.html")
        if found.law.cutting is not None:
            left = found.law.cutting.leave()
            left.apply_scale(1e3)
            (part / STOCK).write_bytes(left.export(file_type="stl"))
        write_json(part / "forces.json", summary)
    return summary


def write_coefficients(found: ForcePrediction, file: Path) -> None:
    """Write the fitted coefficients as a file of materials that holds `measured`.

    Raises:
        InputError: If the force model has no coefficients, or the file cannot be written.

    """
    fitted = None if found.fit is None else found.fit.coefficients
    if fitted is None:
        message = f"process.model is {found.job.process.model!r}, --write is for models with cutting coefficients"
        raise InputError(message, file=found.job.file, where="process.model")
    table = {
        "cutting_N_mm2": [float(f"{value:.5g}") for value in fitted.cutting],
        "edge_N_mm": [float(f"{value:.4g}") for value in fitted.edge], "exponent": list(fitted.exponent),
        "uncertainty": fitted.uncertainty, "source": fitted.source,
    }  # fmt: skip
    try:
        CoefficientTable.model_validate(table)
    except ValidationError as error:
        why = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise InputError(f"the fitted coefficients are no job's: {why}", file=file) from None
    text = (f'# A later job says under [process]: materials = "{file.name}" and material = "measured". uncertainty is\n'
            "# that of the force along the cut that was logged, one standard deviation; another tool, wear, another\n"
            "# cut add to it.\n" + tomli_w.dumps({"measured": table}))  # fmt: skip
    write_text(file, text)


def write_level(found: ForcePrediction, file: Path) -> None:
    """Enter the level of a measured force into process.toml of a robot folder, from where later plans take it.

    The level of the log is worth its own error and what differs from part to part; it is weighed against what is known:
    earlier parts, or the prediction with its uncertainty.

    Raises:
        InputError: If the file does not stand in a robot folder, or nothing was fitted.

    """
    if found.fit is None or not (file.parent / "robot.urdf").is_file():
        raise InputError("process.toml belongs into a robot folder, beside robot.urdf", file=file)
    process, (level, sigma) = found.job.process, found.fit.ratio
    if not 0.0 < level <= MOST_LEVEL:
        raise InputError(f"the log's force is {level:.3g} times the predicted one, above 0 is allowed", file=file)
    known = read_learned_force(file.parent, process)
    scatter = SCATTER if known is None else known.scatter
    before, width = (1.0, getattr(process, "uncertainty", np.inf)) if known is None else (
        known.level, known.common * known.level
    )  # fmt: skip
    own = sigma**2 + (scatter * level) ** 2
    share = 1.0 if not np.isfinite(width) else width**2 / max(width**2 + own, 1e-300)
    force = LearnedForce(
        before + share * (level - before), float(np.sqrt(share * own)), np.zeros(3), None, scatter,
        () if known is None or not known.same else known.parts, find_axes(process),
    )  # fmt: skip
    if known is not None and known.same and known.turn_sigma is not None:
        force = replace(force, turn=known.turn, turn_sigma=known.turn_sigma)
    today = datetime.datetime.now(tz=datetime.UTC).date()
    part = LearnedPartTable(date=today, job=found.job.name or found.job.file.stem, level=level, sigma=sigma)
    write_learned_force(add_part(force, part), process, file.parent, file.parent)


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
