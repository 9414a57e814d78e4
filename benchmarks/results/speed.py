"""Time and memory of whole commands and of the solver."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

from benchmarks.results.findings import ROOT, Findings, Settings, draw_table, run_benchmark, time_command

TITLE = "Speed: how long does a plan take?"
QUESTION = "What does a whole command cost in processor time and memory, and the solver a waypoint?"
METHOD = (
    "Whole commands as a user runs them, user and system time of the process, one thread for linear algebra. "
    "The first job ran once before, so that Python had its modules compiled. `two_rails` is the shipped arm on a rail "
    "with a second rail across under it, along a wave of 237 points, which the plan divides. "
    "`python -m benchmarks planner` times the solver at two lengths of one path, beside a plain solution of the same "
    "equations by `scipy.optimize.least_squares` in the same run."
)
LIMITS = (
    "One machine. Processor time on shared cores grows with the load of others, up to twice where all cores are taken.",
)
JOBS = ("circle_10mm", "isf_cone", "isf_cone_50k")
#: Aims: processor time of a job, user and system [s]; memory of the longest [GB].
AIMS, MEMORY = {"circle_10mm": 2.5, "isf_cone_50k": 18.0, "two_rails": 6.0}, 0.8
#: A second rail under the shipped arm on a rail, and a job for it: a wave of so many points.
CROSS_RAIL = """  <joint name="joint_1" type="prismatic">
    <parent link="base_link"/><child link="link_1"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="2" velocity="1.5" effort="20000"/>
  </joint>
  <link name="link_1"><inertial><mass value="500"/>
    <inertia ixx="100" ixy="0" ixz="0" iyy="100" iyz="0" izz="100"/></inertial></link>
"""
POINTS = 237
WAVE = """schema = 1
robot = "two_rails"
toolpath = "wave.csv"
[part]
position_mm = [1800.0, 2000.0, 600.0]
[process]
model = "constant"
force_N = [-300.0, 200.0, 400.0]
frame = "path"
"""


def write_two_rails(folder: Path) -> Path:
    """Write an arm on two rails across each other, and a job for it."""
    robot = folder / "two_rails"
    shutil.copytree(ROOT / "robots" / "kuka_kr240_rail", robot)
    (robot / "controller.toml").unlink()
    urdf, elasticity = ((robot / name).read_text("utf-8") for name in ("robot.urdf", "elasticity.toml"))
    urdf, elasticity = (
        re.sub(r'"(joint|link)_(\d)"', lambda m: f'"{m[1]}_{int(m[2]) + 1}"', text) for text in (urdf, elasticity)
    )
    urdf = urdf.replace('<parent link="base_link"/>', '<parent link="link_1"/>')
    urdf = urdf.replace('  <joint name="joint_2"', CROSS_RAIL + '  <joint name="joint_2"', 1)
    drive = '[[spring]]\njoint      = "joint_1"\naxis       = "own"\ncompliance = 5.0e-9\n\n[[spring]]'
    elasticity = elasticity.replace("[[spring]]", drive, 1)
    elasticity = elasticity.replace("acceleration_limits = [1.0,", "acceleration_limits = [1.0, 1.0,")
    (robot / "robot.urdf").write_text(urdf, encoding="utf-8")
    (robot / "elasticity.toml").write_text(elasticity, encoding="utf-8")
    lines = ["x_mm,y_mm,z_mm,feed_mm_s"]
    for row in range(POINTS):
        s = row / (POINTS - 1)
        lines.append(f"{150 * s:.4f},{37.5 * math.sin(2 * math.pi * s):.4f},{5 * math.cos(3 * math.pi * s):.4f},60")
    (folder / "wave.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    job = folder / "two_rails.toml"
    job.write_text(WAVE, encoding="utf-8")
    return job


def measure(settings: Settings) -> Findings:
    """Time commands and solver."""
    rows, jobs = [], {name: ROOT / "paths" / f"{name}.toml" for name in JOBS}
    time_command("plan", jobs[JOBS[0]], "--out", settings.work / "first")
    for name, job in {**jobs, "two_rails": write_two_rails(settings.work)}.items():
        spent, memory = time_command("plan", job, "--out", settings.work / "out" / name)
        count = json.loads((settings.work / "out" / name / "plan.json").read_text("utf-8"))["waypoints"]
        rows.append((name, count, spent, memory))
    run_benchmark("benchmarks.planner", "--json", settings.work / "planner.json", "--plain", 100, "--sizes", 500, 5000)
    solver = json.loads((settings.work / "planner.json").read_text("utf-8"))
    program = solver["program"]
    found = {row[0]: row for row in rows}
    cone, long, rails = (found[name] for name in ("isf_cone", "isf_cone_50k", "two_rails"))
    losses = [f"`{name}` takes {found[name][2]:.1f} s, the aim is {aim:g}." for name, aim in AIMS.items()
              if found[name][2] > aim]  # fmt: skip
    losses += [f"{long[1]:,} waypoints take {long[3]:.2f} GB, the aim is {MEMORY:g}."] if long[3] > MEMORY else []
    return Findings(
        (
            f"A job of {found['circle_10mm'][1]:,} waypoints: {found['circle_10mm'][2]:.1f} s of processor time for the"
            f" whole command; the shipped cone ({cone[1]:,} waypoints): {cone[2]:.0f} s.",
            f"{long[1]:,} waypoints: {long[2]:.0f} s and {long[3]:.2f} GB.",
            f"An arm on two rails ({rails[1]:,} waypoints): {rails[2]:.1f} s.",
            f"The solver takes {min(r['solver_ms'] for r in program):.2f} to {max(r['solver_ms'] for r in program):.2f}"
            f" ms a waypoint; a plain least-squares solution takes {solver['plain']['plain_ms']:.0f} ms.",
        ),
        (
            draw_table(("command `plan`", "waypoints", "CPU, s", "aim, s", "memory, GB"),
                       [(f"`{a}`", f"{b:,}", f"{c:.1f}", f"{AIMS[a]:g}" if a in AIMS else "", f"{d:.2f}")
                        for a, b, c, d in rows]),
            draw_table(("waypoints", "solver, ms a waypoint", "strategy, ms a waypoint", "plain / solver"),
                       [(f"{r['waypoints']:,}", f"{r['solver_ms']:.3f}", f"{r['strategy_ms']:.3f}",
                         f"{r['plain_over_solver']:.0f}") for r in program]),
        ),
        tuple(losses),
    )  # fmt: skip
