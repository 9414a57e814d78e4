"""Set claim beside truth: in what a plan that says "solved" is not, and whether the answer can be trusted."""

from __future__ import annotations

from benchmarks.plan_check.run import Outcome

#: A figure may exceed what is claimed by this much. [mm]
CLAIM_ROOM = 0.01
#: ... between waypoints by this share of the tolerance: splines differ in how they begin and end.
SPLINE_ROOM = 0.2
#: Shares by which limits may be overrun: rounding of joints.csv.
ROUNDING = 1.001
#: What the tool axis may lean by beside what the job allows. [deg]
MOST_LEAN = 0.5
#: A mean feed below this share of the programmed one has to be told.
SILENT_FEED = 0.9


def list_breaches(job_table: dict, found: dict, plan: dict) -> list[str]:
    """Say in a few words each what does not hold on the robot."""
    table = job_table.get("plan", {})
    tolerance = table.get("tolerance_mm", 0.1)
    rounded = 0.25 * tolerance if isinstance(job_table.get("toolpath"), str) else 0.0
    on_path = tolerance + job_table.get("feed", {}).get("corner_tolerance_mm", rounded)
    breaches = []

    def beyond(name: str, value: float, most: float, unit: str = "mm") -> None:
        if not value <= most:
            breaches.append(f"{name} {value:.3g} {unit} (at most {most:.3g})")

    at = found["at_with_inertia_mm"] if found["inertia_planned"] else found["at_mm"]
    beyond("at waypoints", at, tolerance)
    for way in ("joint", "cartesian", "spline"):
        beyond(f"between, {way}", found[f"between_{way}_mm"], on_path)
    if found["unsettled"]:
        breaches.append(f"no rest at {found['unsettled']} rows")
    claim = (plan.get("error_after_mm") or {}).get("max")
    if claim is not None:
        beyond("at waypoints beyond the claim by", at - claim, CLAIM_ROOM)
    claim = (plan.get("between_waypoints_mm") or {}).get("max")
    if claim is None:
        breaches.append("no between_waypoints_mm")
    else:
        worst = max(found[f"between_{way}_mm"] for way in ("joint", "cartesian", "spline"))
        # corners that the job allows to be rounded are off the CAM path, and on the path that the claim speaks of
        asked = min(found["wanted_off_path_mm"], on_path - tolerance)
        beyond("between beyond the claim by", worst - claim - asked, max(CLAIM_ROOM, SPLINE_ROOM * tolerance))
    beyond("force off the law by", found["force_off_N"], 0.01 * found["force_greatest_N"] + 0.1, "N")
    notes = " ".join(plan.get("notes", [])).lower()
    if found["feed_mean_share"] < SILENT_FEED and "feed" not in notes:
        breaches.append(f"feed lowered to {found['feed_mean_share']:.2f} of the programmed one on average, no note")
    beyond("correction", found["correction_mm"], found["most_correction_mm"] * ROUNDING)
    beyond("velocity", found["velocity_ratio"], ROUNDING, "of the limit")
    beyond("acceleration", found["acceleration_ratio"], ROUNDING, "of the limit")
    if found["position_room_deg"] < -1e-6:
        breaches.append(f"joint limit passed by {-found['position_room_deg']:.3g} deg")
    if found["time_runs_back"]:
        breaches.append("time runs back")
    beyond("effort", found["effort_ratio"], ROUNDING, f"of the limit of {found['effort_ratio_joint']}")
    beyond("a rapid ends inside the part by", found["rapid_inside_mm"], tolerance)
    beyond("wanted tip off the CAM path", found["wanted_off_path_mm"], on_path)
    posture = job_table.get("posture", {})
    leaning = posture.get("lead_deg", 0.0) + posture.get("lean_deg", 0.0)
    beyond("wanted axis off the CAM path's", found["axis_off_path_deg"], MOST_LEAN + leaning, "deg")
    beyond("tool axis", found["tilt_deg"], MOST_LEAN, "deg")
    beyond("CAM vertex missed by", found["vertex_missed_mm"], on_path)
    beyond("end of the path missed by", found["end_reached_mm"], on_path)
    if found.get("tool_weight_mm", 0.0) > 0.01 and not found["tool_weight_counted"] and not found["tool_weight_noted"]:
        breaches.append(f"weight of the tool not counted ({found['tool_weight_mm']:.3g} mm), no note")
    clearance = found.get("clearance")
    if clearance:
        wanted = job_table["collision"].get("clearance_mm", 5.0)
        least, pair = clearance["least_mm"], " to ".join(clearance["between"])
        if least < wanted:
            breaches.append(f"clearance {least:.3g} mm ({pair}), {wanted:g} asked")
    return breaches


def judge_answer(
    expected: str, outcome: Outcome, breaches: list[str], found: dict | None, *, planted: bool = False
) -> str:
    """Return "trusted", "honest" (no promise, though a solution was expected) or "FAILS: why".

    Args:
        expected: "solved", "refused" or "any".
        outcome: What the command left.
        breaches: What does not hold.
        found: What was measured, or None.
        planted: Whether a mistake was planted: what is written then need not keep the correction limit.
    """
    if outcome.status is None:
        return "FAILS: no answer in time"
    if outcome.status not in (0, 2, 3):
        return f"FAILS: exit status {outcome.status}"
    if outcome.status == 2 or outcome.plan is None:
        one_line = outcome.said.startswith("error: ") and outcome.lines == 1
        right = expected == "refused" and (outcome.status == 3 or one_line)
        return "trusted" if right else f"FAILS: exit status {outcome.status}"
    held = planted or "reach of the arm" in outcome.said  # no command stands near a place out of reach
    if not held and found is not None and found["correction_mm"] > found["most_correction_mm"] * ROUNDING:
        return "FAILS: correction limit broken"
    if outcome.plan["status"] != "solved":
        return "honest" if expected == "solved" else "trusted"
    if expected == "refused":
        return "FAILS: says solved"
    if breaches:
        return f"FAILS: {len(breaches)} breach" + "es" * (len(breaches) > 1)
    return "trusted"
