"""What `compplan certificate` writes: one page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compplan.io.origin import describe_origin
from compplan.io.transaction import replace_file
from compplan.learning.certificate import Certificate
from compplan.reporting.certificate_page import write_certificate_page


def write_certificate(certificate: Certificate, file: Path) -> dict[str, Any]:
    """Write the page and return a summary of it.

    Args:
        certificate: The certificate.
        file: The HTML file.

    Raises:
        InputError: If the file cannot be written.
    """
    with replace_file(file) as part:
        write_certificate_page(certificate, part)
    return summarise_certificate(certificate)


def summarise_certificate(certificate: Certificate) -> dict[str, Any]:
    """Return what the certificate says, ready for JSON; a rigid joint has no stiffness."""
    accuracy = certificate.accuracy
    summary: dict[str, Any] = {
        "schema": 1,
        "robot": certificate.robot.name,
        "known": {"grade": certificate.known.grade, "source": certificate.known.source},
        "stiffness_Nm_per_rad": {
            entry.joint: {
                "value": _finite(entry.value), "interval_95": [_finite(entry.low), _finite(entry.high)],
                "literature": _finite(entry.literature), "older": _finite(entry.older),
                "change_in_standard_deviations": entry.change,
            }
            for entry in certificate.stiffness
        },
        "lost_motion_urad": {drive.joint: drive.play * 1e6 for drive in certificate.drives},
        "gear_error_urad": {drive.joint: drive.gear * 1e6 for drive in certificate.drives},
        "references": [
            {
                "name": reference.name,
                "any_point_p95_mm": None if reference.promise is None else reference.promise.greatest * 1e3,
                "whole_path_p95_mm": None if reference.promise is None else reference.promise.whole * 1e3,
                "reason": reference.reason or None,
            }
            for reference in certificate.references
        ],
        "drift_mm": [{"name": name, "rms": rms * 1e3, "max": most * 1e3} for name, rms, most in certificate.moved],
        "held_against": None if certificate.older is None else {
            "robot": certificate.older.name, "measured": certificate.drifts},
        "changed_beyond_chance": list(certificate.changed),
        "diagnosis": [
            {"effect": f.effect, "joint": f.joint, "axis": f.axis, "probability": f.probability,
             "change_percent": None if f.percent is None else list(f.percent)}
            for f in certificate.findings
        ],
        "next": list(certificate.next_steps),
        "made_by": describe_origin(),
    }  # fmt: skip
    if accuracy is not None:
        summary["accuracy"] = {
            "poses": accuracy.poses,
            "accuracy_max_mm": float(accuracy.accuracy.max()) * 1e3,
            "rms_mm": accuracy.rms * 1e3,
            "poses_met_again": accuracy.again,
            "accuracy_raw_max_mm": float(accuracy.raw.max()) * 1e3,
            "accuracy_unseen_max_mm": float(accuracy.unseen.max()) * 1e3 if len(accuracy.unseen) else None,
            "fitted_numbers": accuracy.fitted,
            "repeatability_mm": accuracy.pooled * 1e3 if accuracy.again else None,
            "repeatability_ci95_mm": [1e3 * v for v in accuracy.pooled_interval] if accuracy.again else None,
            "visits_beyond_first": accuracy.freedom,
            "instrument_mm": accuracy.instrument * 1e3,
        }
    return summary


def _finite(value: float | None) -> float | None:
    return None if value is None or value in (float("inf"), float("-inf")) else value
