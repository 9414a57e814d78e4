"""truth.json: what a case was made of, and what may be asked of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from benchmarks.outsider.draw import Case
from benchmarks.outsider.observe import observe, sags
from benchmarks.outsider.weighing import register, rms

KNOWN_STATUS = ["explained", "partly_explained"]
STATUS: Mapping[str, list[str]] = {
    "single": KNOWN_STATUS,
    "double": KNOWN_STATUS,
    "triple": KNOWN_STATUS,
    "quadruple": KNOWN_STATUS,
    "mixed": ["partly_explained"],
    "unknown": ["unknown"],
    "none": ["none"],
    "background": ["none", "partly_explained", "unknown"],
}
EASY, MEDIUM = 40, 12  # standard deviations of the least visible cause


def describe_truth(
    case: Case,
    split: Mapping[str, Any],
    registration: Mapping[str, Any] | None,
    written: Mapping[str, float],
) -> dict[str, Any]:
    """Everything that truth.json holds.

    Args:
        case: The case.
        split: Facts of the given and of the later log.
        registration: Where base and target stand in each, None where they are known.
        written: Rates of outliers and missing rows, noise of the force sensor.
    """
    given, settings, instrument = case.given, case.settings, case.instrument
    kind = {3: "triple", 4: "quadruple"}[len(case.causes)] if case.kind == "multi" else case.kind
    gap = observe(case.robot, given, [], case.everyday).gap[:, :3]
    everyday = rms(register(gap, case.frames) if given.register else gap)
    by_gap = "gap_registered_rms_mm" if given.register else "gap_rms_mm"
    labels = sorted(case.labels, key=lambda label: -label[by_gap])
    sigma, floor = instrument.sigma_rms(given), instrument.floor(given)
    warm_up = asdict(settings.warm_up)
    return {
        "case": f"outside_{case.seed:05d}",
        "suite": "outside",
        "generator": "benchmarks.outsider",
        "seed": case.seed,
        "attempt": case.attempt,
        "robot": case.robot.name,
        "design": settings.design,
        "kind": kind,
        "difficulty": _difficulty(case),
        "expected_status": STATUS[kind],
        "effects": labels,
        "gap_over_sigma": [label["over_sigma"] for label in labels],
        "background": _everyday(case),
        "background_over_sigma": round(everyday / sigma, 3),
        "sigma_mm": sigma * 1e3,
        "repeatability_rms_mm": instrument.repeatability * 1e3,
        "noise_floor_rms_mm": floor * 1e3,
        "dominant_floor_rms_mm": float(np.hypot(floor, everyday)) * 1e3,
        "split": split,
        "nominal": _nominal(case),
        "warm_up": {
            "given": warm_up,
            "fresh": asdict(replace(settings.warm_up, start=settings.warm_up.fresh_start)),
        },
        "register": registration,
        "log": {**_log(case), **written},
    }


def _difficulty(case: Case) -> str:
    if not case.labels:
        return "none"
    least = min(label["visible"] for label in case.labels)
    return "easy" if least > EASY else "medium" if least > MEDIUM else "hard"


def _everyday(case: Case) -> list[dict[str, Any]]:
    return [
        dict(zip(("effect", "joint", "axis"), b.key, strict=True))
        | {"size": b.size, "sd": b.sd, "group": b.group, "params": b.params}
        for b in case.everyday
    ]


def _nominal(case: Case) -> dict[str, Any]:
    springs: list[dict[str, Any]] = [
        {"effect": "nominal_spring", "joint": s.joint, "axis": s.axis, "size": s.compliance, "params": {}}
        for s in case.robot.springs
        if s.axis != "own"
    ]
    return {"gravity": not sags(case.causes), "extra_springs": springs, "sag_compensated_by_controller": False}


def _log(case: Case) -> dict[str, Any]:
    settings, scattered = case.settings, case.instrument.scatter is not None
    return {
        "path_runs": settings.path,
        "orientation": settings.orientation,
        "link_encoders": settings.link_encoders,
        "temperature": settings.temperature,
        "time": settings.time,
        "wrench": settings.wrench,
        "registered": settings.register,
        "scatter": scattered,
        "repeatability_given": scattered and settings.repeatability_given,
        "calm": settings.calm,
        "sigma_column": settings.sigma_column,
        "si_units": settings.si_units,
        "poses": settings.style,
        "tracker_m": settings.tracker.tolist(),
        "sigma_orientation_deg": settings.sigma_deg if settings.orientation else None,
        "sigma_encoder": ".0003 deg or mm",
    }
