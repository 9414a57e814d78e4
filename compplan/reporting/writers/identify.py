"""What `compplan identify` writes: identify.json, report.html and the updated robot folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compplan.identification.campaign import Identification
from compplan.identification.estimate import Estimate
from compplan.identification.parameters import Parameter
from compplan.identification.refine import RefinementRound, RoundCandidate
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_json
from compplan.io.transaction import replace_folder
from compplan.measurement.fit.rows import SIGMA_ENCODER
from compplan.measurement.registration import write_registration
from compplan.reporting.identify_page import write_identification_page
from compplan.reporting.writers.robot_folder import deliver_robot_folder

#: Unit in which a parameter is shown, and factor from SI.
SHOWN = {
    "rad/(N m)": ("urad/(N m)", 1e6),
    "m/N": ("um/N", 1e6),
    "rad/N": ("urad/N", 1e6),
    "m": ("mm", 1e3),
    "rad": ("deg", 180 / np.pi),
    "1": ("1", 1.0),
}


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
        deliver_robot_folder(result.robot, folder, result.nominal)
        if result.registration.parts:
            write_registration(result.registration, folder / "registration.toml")
        write_json(part / "identify.json", summary)
        write_identification_page(summary, part / "report.html")
    return summary


def summarise_identification(result: Identification) -> dict[str, Any]:
    """Say what came out, ready for JSON."""
    kept = set(result.kept.free_names)
    parameters = [_describe(result.kept, name, kept=True) for name in _listed(result.kept)]
    parameters += [_describe(result.estimate, n, kept=False) for n in _listed(result.estimate) if n not in kept]
    noise, rows = result.estimate.noise, result.rows
    scatter = {"position_mm": _number(noise[0] * np.median(rows.deviation[:, 0]) * 1e3)}
    if rows.turned:
        scatter["orientation_deg"] = _number(np.rad2deg(noise[1] * np.median(rows.deviation[:, 3])))
    if rows.encoder is not None:
        scatter["encoder_difference_deg"] = _number(np.rad2deg(noise[2] * SIGMA_ENCODER))
    frames = result.registration
    return {
        "schema": 1,
        "robot": result.nominal.name,
        "rows": len(rows),
        "poses": rows.poses,
        "reference": rows.reference,
        "geometry": result.geometry,
        "parameters": parameters,
        "unidentifiable": [
            {"parameter": h.held, "together_with": list(h.together_with), "reason": h.reason}
            for h in result.estimate.held
        ],
        "condition_number": _number(result.estimate.condition),
        "intervals_from": "groups of neighbouring poses" if result.estimate.clustered else "residuals",
        "residual_per_axis": scatter,
        "gap": {
            key: _number(None if value is None else value * 1e3)
            for key, value in (
                ("before_rms_mm", result.gap.before),
                ("after_rms_mm", result.gap.after),
                ("held_out_before_rms_mm", result.gap.held_out_before),
                ("held_out_after_rms_mm", result.gap.held_out_after),
                ("under_load_before_rms_mm", result.gap.under_load_before),
                ("under_load_after_rms_mm", result.gap.under_load_after),
            )
        },
        "structure": [_describe_round(entry, result) for entry in result.refinement.rounds],
        "registration": {
            "fitted": list(frames.parts),
            "base_position_mm": [_number(v * 1e3) for v in frames.base[:3, 3]],
            "tool_position_mm": [[_number(v * 1e3) for v in tool[:3, 3]] for tool in frames.tool],
        },
        "outlier_rows": list(result.outliers),
        "notes": list(result.notes),
    }


def describe_identification(summary: dict[str, Any]) -> list[str]:
    """Say what came out in lines for people."""
    gap = summary["gap"]
    lines = [
        f"{summary['robot']}: {summary['rows']} rows at {summary['poses']} poses, {summary['reference']} positions,"
        f" geometry fitted: {summary['geometry']}",
        f"{'parameter':<26}{'unit':<12}{'before':>10}{'value':>10}{'95 % interval':>24}",
    ]
    for entry in summary["parameters"]:
        if entry["kind"] in ("geometry", "base", "tool", "contact"):
            continue
        interval = "[{:.4g}, {:.4g}]".format(*entry["interval_95"])
        verdict = "" if entry["written"] else "  not written"
        lines.append(
            f"{entry['name']:<26}{entry['unit']:<12}{entry['before']:>10.4g}{entry['value']:>10.4g}{interval:>24}{verdict}"
        )
    for entry in summary["unidentifiable"]:
        if not _about_geometry(entry["parameter"]):
            mates = f" apart from {' and '.join(entry['together_with'])}" if entry["together_with"] else ""
            lines.append(f"cannot be determined{mates}: {entry['parameter']}; {entry['reason']}")
    lines.append(
        f"gap rms {gap['before_rms_mm']:.4g} -> {gap['after_rms_mm']:.4g} mm,"
        f" on poses not in the fit {gap['held_out_before_rms_mm']:.4g} -> {gap['held_out_after_rms_mm']:.4g} mm"
    )
    if gap["under_load_before_rms_mm"] is not None:
        lines.append(
            f"under load, pose by pose: {gap['under_load_before_rms_mm']:.4g} ->"
            f" {gap['under_load_after_rms_mm']:.4g} mm on poses not in the fit"
        )
    lines.append(f"intervals from {summary['intervals_from']}; {len(summary['outlier_rows'])} gross outliers left out")
    return lines + [f"note: {note}" for note in summary["notes"]]


def _listed(estimate: Estimate) -> list[str]:
    """List the free parameters of a fit, frames left out: those stand in the registration."""
    return [p.name for p in estimate.structure.parameters if p.name in estimate.free_names]


def _describe(estimate: Estimate, name: str, *, kept: bool) -> dict[str, Any]:
    k = estimate.names.index(name)
    parameter: Parameter = estimate.parameters[k]
    unit, factor = SHOWN.get(parameter.unit, (parameter.unit, 1.0))
    return {
        "name": name,
        "kind": parameter.kind,
        "unit": unit,
        "before": _number(parameter.nominal * factor),
        "value": _number(estimate.values[k] * factor),
        "standard_error": _number(estimate.standard_errors[k] * factor),
        "interval_95": [_number(v * factor) for v in estimate.intervals()[k]],
        "written": kept,
    }


def _describe_round(entry: RefinementRound, result: Identification) -> dict[str, Any]:
    units = {p.name: SHOWN.get(p.unit, (p.unit, 1.0)) for p in (*result.estimate.parameters, *result.kept.parameters)}

    def describe(candidate: RoundCandidate) -> dict[str, Any]:
        unit, factor = units.get(candidate.name, ("urad/(N m)", 1e6))
        return {
            "name": candidate.name,
            "told": candidate.told,
            "value": _number(candidate.value * factor),
            "standard_error": _number(candidate.standard_error * factor),
            "unit": unit,
            "held_out_rms_mm": _number(candidate.held_out_rms * 1e3),
            "gain_in_standard_errors": _number(candidate.gain),
        }

    return {
        "held_out_rms_mm": _number(entry.held_out_rms * 1e3),
        "added": entry.added or None,
        "candidates": [describe(candidate) for candidate in entry.candidates],
    }


def _about_geometry(name: str) -> bool:
    return name.endswith(".offset") or ".end." in name or name.startswith(("base.", "tool", "contact("))


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")
