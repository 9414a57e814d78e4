"""What `compplan forces` writes: forces.json, forces.csv and the page."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.files.origin import describe_origin
from compplan.files.tables import Array, write_json, write_table
from compplan.files.transaction import replace_folder
from compplan.job.job import Job, load_path
from compplan.path.contact import path_axes
from compplan.path.force_law import ForceLaw
from compplan.path.forces.fit import ForceFit, fit_forces, read_force_log
from compplan.path.toolpath import WRENCH_HEADERS, Toolpath


@dataclass(frozen=True)
class ForcePrediction:
    """The force along a job's path.

    Attributes:
        job: The job.
        nominal: The path with its wrench, base frame.
        law: Its law.
        ripple: Half of the range of the force through a turn of a cutter, path axes, or None. Shape (n, 3). [N]
        fit: The comparison with a log, or None.

    """

    job: Job
    nominal: Toolpath
    law: ForceLaw
    ripple: Array | None
    fit: ForceFit | None

    @property
    def wrench(self) -> Array:
        """The wrench on the tool at its tip, base axes. Shape (n, 6). [N, N m]"""
        return np.zeros((len(self.nominal), 6)) if self.nominal.wrench is None else self.nominal.wrench

    @property
    def local(self) -> Array:
        """The force in path axes. Shape (n, 3). [N]"""
        return np.asarray(np.einsum("nji,nj->ni", path_axes(self.nominal), self.wrench[:, :3]))


def predict_forces(job: Job, log: Path | None = None) -> ForcePrediction:
    """Predict engagement and force along a job's path, and compare them with a log where there is one.

    Raises:
        InputError: If toolpath, process or log are not what they have to be.

    """
    nominal, law = load_path(job)
    ripple = None if law.cutting is None else law.cutting.ripple(nominal.feed)
    fit = None if log is None else fit_forces(read_force_log(log), law, nominal, log)
    return ForcePrediction(job, nominal, law, ripple, fit)


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
        "notes": [*found.nominal.notes, *([found.law.note] if found.law.note else [])],
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
    from compplan.report.forces_page import ForcesView, write_forces_page

    summary = {**summarise_forces(found), "made_by": describe_origin()}
    cut = None if found.law.cutting is None else found.law.cutting.engagement
    view = ForcesView(
        title=found.job.name or "Forces", model=found.job.process.model, nominal=found.nominal, wrench=found.wrench,
        local=found.local, ripple=found.ripple, engagement=cut, fit=found.fit, notes=tuple(summary["notes"]),
        summary=summary,
    )  # fmt: skip
    with replace_folder(folder, "forces") as part:
        write_table(part / "forces.csv", _tabulate(found))
        write_forces_page(view, part / "report.html")
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
