"""The plans of a job of several tools, one an operation, seen as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from compplan.io.provenance import describe_origin
from compplan.planning.result import Plan, summarise_plan

#: Words from the best to the worst.
STATUSES = ("solved", "not_confirmed", "infeasible")
VERDICTS = ("keeps", "not_known", "may_not_keep")


def worst_status(plans: Sequence[Plan]) -> str:
    """Return the status of several plans as one: the worst."""
    return max((plan.status for plan in plans), key=STATUSES.index)


def summarise_operations(plans: Sequence[Plan], name: str) -> dict[str, Any]:
    """Return what plan.json says of all operations together: the worst of each figure, and each operation's own.

    Root mean squares and means go over the waypoints of all cuts.
    """
    parts = [summarise_plan(plan) for plan in plans]
    cuts = np.array([np.count_nonzero(plan.task.cut) for plan in plans], float)
    share, first = cuts / max(cuts.sum(), 1.0), parts[0]
    verdicts = [part["verdict"] for part in parts]
    beyond = [verdict.get("beyond_share") for verdict in verdicts]  # of all cuts; None where one does not know it

    def join_errors(key: str) -> dict[str, float]:
        rms, mean, most = (np.array([part[key][name] for part in parts]) for name in ("rms", "mean", "max"))
        return {"rms": float(np.sqrt(share @ rms**2)), "mean": float(share @ mean), "max": float(most.max())}

    whole: dict[str, Any] = {
        "schema": 1,
        "status": worst_status(plans),
        "strategy": first["strategy"],
        "verdict": {
            **max(verdicts, key=lambda verdict: VERDICTS.index(verdict["word"])),
            "beyond_share": None if None in beyond else float(share @ np.array(beyond, float)),
        },
        "name": name,
        "robot": first["robot"],
        "robot_grade": first["robot_grade"],
        "waypoints": sum(part["waypoints"] for part in parts),
        "configuration": first["configuration"],
        "solve_time_s": round(sum(part["solve_time_s"] for part in parts), 4),
        **{key: join_errors(key) for key in ("error_before_mm", "error_after_mm")},
        "between_waypoints_mm": {"max": max(part["between_waypoints_mm"]["max"] for part in parts)},
        "correction_mm": {"max": max(part["correction_mm"]["max"] for part in parts)},
        "margins": {
            "position_limit_deg": min(part["margins"]["position_limit_deg"] for part in parts),
            **{key: max(part["margins"][key] for part in parts) for key in ("velocity_ratio", "acceleration_ratio")},
        },
        "duration_s": sum(part["duration_s"] for part in parts),
        "judge": first["judge"],
        "notes": list(dict.fromkeys(note for plan in plans for note in _lead_notes(plan))),
        "tools": [_summarise_operation(plan, part) for plan, part in zip(plans, parts, strict=True)],
        "made_by": describe_origin(),
    }
    if all("error_band_mm" in part for part in parts):
        whole["error_band_mm"] = {"p95_max": max(part["error_band_mm"]["p95_max"] for part in parts)}
    failing = [(plan, part["failure"]) for plan, part in zip(plans, parts, strict=True) if "failure" in part]
    if failing:
        whole["failure"] = "; ".join(f"{_label(plan)}: {said}" for plan, said in failing)
    return whole


def _summarise_operation(plan: Plan, part: dict[str, Any]) -> dict[str, Any]:
    """Return one entry of `tools` in plan.json: which tool, in which folder, and its figures."""
    kept = ("status", "verdict", "waypoints", "error_before_mm", "error_after_mm", "correction_mm", "duration_s")
    tip = plan.robot.joints[-1].placement
    tool = {"operation": None if plan.job is None else plan.job.cam.operation, "label": _label(plan)}
    return {
        **tool, "folder": _label(plan), "length_mm": round(1e3 * float(np.linalg.norm(tip[:3, 3])), 6),
        **{key: part[key] for key in (*kept, "error_band_mm") if key in part},
    }  # fmt: skip


def _lead_notes(plan: Plan) -> list[str]:
    """Return the notes of an operation, each led by its tool; those about the whole file as they are."""
    return [
        note if note in plan.task.nominal.notes else type(note)(f"{_label(plan)}: {note}")
        for note in (*plan.reasons, *plan.notes)
    ]


def _label(plan: Plan) -> str:
    return "" if plan.job is None else plan.job.label
