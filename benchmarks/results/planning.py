"""Plans of the shipped jobs and of drawn ones, judged in MuJoCo."""

from __future__ import annotations

import json

import numpy as np

from benchmarks.plan_check.mistakes import MISTAKES
from benchmarks.results.findings import ROOT, Findings, Settings, draw_table, run_benchmark

TITLE = "Planning: does the loaded tip follow the path?"
QUESTION = (
    "How far is the tool tip from the CAM path, before and after correction, by an engine that shares nothing with "
    "the planner; and is anything called solved that is not?"
)
METHOD = (
    "`python -m benchmarks plan_check` plans every shipped job by the command line and brings `joints.csv` to rest in "
    "a MuJoCo cell of its own, at the waypoints and between them (joint moves, straight moves, cubic spline). It reads "
    "robot, job and force law itself. Drawn jobs take robot, tool, place, path and force from a random draw. Planted "
    "mistakes are errors put into the planner on purpose."
)
LIMITS = (
    '"After, as modelled" says that the equations are solved. It says nothing about your robot.',
    "The arm is brought to rest, so these plans leave the inertia of the motion alone (`inertia = false`). Arms in "
    "motion: `python -m benchmarks moving`.",
    '"20 % softer" is a robot whose compliances are all 20 % larger than the model\'s. The 20 % are assumed.',
    "Robots are models from papers and data sheets. Nobody has cut a part with these programs and told us.",
)
JOBS = ("isf_cone", "circle_500mm", "circle_10mm", "circle_spindle_90", "gcode", "spiral", "freeform")
DRAWN, FIRST = 12, 400
#: Seconds that a drawn job may take; one that takes longer counts as not answered.
PATIENCE = 150


def measure(settings: Settings) -> Findings:
    """Plan and judge shipped jobs, planted mistakes and drawn jobs."""
    mistakes = [name for name in MISTAKES if name != "mistake_none"]
    written, drawn = settings.work / "written", settings.work / "drawn"
    run_benchmark("benchmarks.plan_check", "--out", written, "--jobs", *JOBS, *mistakes, "--keep")
    draw = ("--drawn", DRAWN, "--seed", FIRST, "--limit", PATIENCE)
    run_benchmark("benchmarks.plan_check", "--out", drawn, *draw, "--keep")
    found = {row["job"]: row for row in json.loads((written / "plan_check.json").read_text("utf-8"))}
    many = json.loads((drawn / "plan_check.json").read_text("utf-8"))
    rows, before, softer, at = [], [], [], []
    for name in JOBS:
        plan = json.loads((written / "plans" / name / "plan.json").read_text("utf-8"))
        truth, verdict = found[name]["truth"], plan.get("verdict") or {}
        before.append(plan["error_before_mm"]["max"])
        softer.append(_plan_softer(name))
        at.append(truth["at_mm"])
        between = [truth[f"between_{way}_mm"] for way in ("joint", "cartesian", "spline")]
        rows.append((
            f"`{name}`", plan["waypoints"], plan["status"], verdict.get("word", "not said"), f"{before[-1]:.2f}",
            f"{1e3 * at[-1]:.2g}", " / ".join(f"{1e3 * x:.1f}" for x in between), f"{softer[-1]:.2f}",
        ))  # fmt: skip
    solved = [row for row in many if (row["claim"] or {}).get("status") == "solved"]
    false = [row["job"] for row in [*found.values(), *many] if row["verdict"].startswith("FAILS")]
    caught = sum((found[name]["claim"] or {}).get("status") != "solved" for name in mistakes)
    head = ("job", "waypoints", "status", "verdict", "uncorrected, max mm", "after, as modelled, um",
            "between waypoints: joint / straight / spline, um", "after, 20 % softer, max mm")  # fmt: skip
    ratio = np.median(np.array(softer) / np.array(before))
    return Findings(
        (
            f"{len(JOBS)} shipped jobs: the uncorrected tip is off by {min(before):.2f} to {max(before):.2f} mm.",
            f"As modelled, at most {max(1.0, 1e3 * max(at)):.0f} um is left at the waypoints, by MuJoCo.",
            f"On a robot 20 % softer than its model, {100 * ratio:.0f} % of the uncorrected error is left (median).",
            f"{len(solved)} of {len(many)} drawn jobs are solved; {len(false)} answers are wrong.",
            f"{caught} of {len(mistakes)} planted mistakes are refused.",
        ),
        (draw_table(head, rows), (drawn / "plan_check.md").read_text("utf-8")),
        tuple(f"`{row['job']}`: {row['verdict']}" for row in [*found.values(), *many] if row["job"] in false)
        + tuple(
            f"`{row['job']}` (drawn): {row['said'] or row['claim']['status']}" for row in many if row not in solved
        ),
    )


def _plan_softer(name: str) -> float:
    """Return what a plan leaves in a cell whose compliances are 20 % larger than the robot's. [mm]"""
    import compplan.simulation.simulated_robot as cells
    from compplan.job.job import load_job
    from compplan.planning.evaluate import evaluate_run
    from compplan.planning.plan import plan_job

    plan = plan_job(load_job(ROOT / "paths" / f"{name}.toml"))
    cell = cells.build_simulated_robot(plan.robot.scale_compliance(1.2), "20 % softer")
    return 1e3 * evaluate_run(plan.task, plan.q, cell).max_deviation
