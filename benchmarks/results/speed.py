"""Time and memory of whole commands and of the solver."""

from __future__ import annotations

import json

from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark, time_command

TITLE = "Speed: how long does a plan take?"
QUESTION = "What does a whole command cost in processor time and memory, and the solver a waypoint?"
METHOD = (
    "Whole commands as a user runs them, user and system time of the process, one thread for linear algebra. "
    "`python -m benchmarks.planner` times the solver at three lengths of one path, beside a plain solution of the same "
    "equations by `scipy.optimize.least_squares` in the same run."
)
LIMITS = ("One machine. Wall times are shorter where more cores are free, longer where they are not.",)
JOBS = ("circle_10mm", "circle_500mm", "isf_cone", "spiral", "gcode", "isf_cone_50k")


def measure(settings: Settings) -> Findings:
    """Time commands and solver."""
    rows = []
    for name in JOBS:
        spent, memory = time_command("plan", f"paths/{name}.toml", "--out", settings.work / name)
        count = json.loads((settings.work / name / "plan.json").read_text("utf-8"))["waypoints"]
        rows.append((f"`{name}`", count, spent, memory))
    run_benchmark("benchmarks.planner", "--json", settings.work / "planner.json", "--plain", 100)
    solver = json.loads((settings.work / "planner.json").read_text("utf-8"))
    program = solver["program"]
    return Findings(
        (
            f"The shipped cone ({rows[2][1]:,} waypoints): {rows[2][2]:.0f} s of processor time for the whole command.",
            f"{rows[-1][1]:,} waypoints: {rows[-1][2]:.0f} s and {rows[-1][3]:.2f} GB.",
            f"The solver takes {min(r['solver_ms'] for r in program):.2f} to {max(r['solver_ms'] for r in program):.2f}"
            f" ms a waypoint; a plain least-squares solution takes {solver['plain']['plain_ms']:.0f} ms.",
        ),
        (
            draw_table(("command `plan`", "waypoints", "CPU, s", "memory, GB"),
                       [(a, f"{b:,}", f"{c:.1f}", f"{d:.2f}") for a, b, c, d in rows]),
            draw_table(("waypoints", "solver, ms a waypoint", "strategy, ms a waypoint", "plain / solver"),
                       [(f"{r['waypoints']:,}", f"{r['solver_ms']:.3f}", f"{r['strategy_ms']:.3f}",
                         f"{r['plain_over_solver']:.0f}") for r in program]),
        ),
        (),
    )  # fmt: skip
