"""Plans of the shipped jobs, brought to rest in MuJoCo."""

from __future__ import annotations

import shutil
import tomllib

import numpy as np
import tomli_w

from benchmarks.results.chart import Chart
from benchmarks.results.findings import ROOT, Findings, Settings, draw_table
from benchmarks.simulated_robot.cell import SimulatedRobot
from benchmarks.simulated_robot.job import read_job, read_joints
from benchmarks.simulated_robot.run import run_plan

TITLE = "Planning: does the loaded tip follow the path?"
QUESTION = (
    "How far is the tool tip from the CAM path, before and after correction, by an engine that shares nothing with "
    "the planner?"
)
METHOD = (
    "Every shipped job is planned by the command line. Its `joints.csv` is brought to rest in MuJoCo under the wrench "
    "that the file states, by a reader of robot folders of its own. *20 % softer*: all compliances are 20 % larger."
)
CHART = Chart("greatest deviation of the tip, mm", {
    "uncorrected": ("uncorrected, max mm", 0), "corrected, 20 % softer robot": ("after, 20 % softer, max mm", 0)
}, log=True)  # fmt: skip
LIMITS = (
    '"After, as modelled" says that the equations are solved. It says nothing about your robot.',
    "The arm is at rest (`inertia = false`), the part frame absolute. Arms in motion: [coverage](coverage.md).",
    "The 20 % of the softer robot are assumed.",
    "Robots are models from papers and data sheets.",
)
JOBS = ("isf_cone", "circle_500mm", "circle_10mm", "circle_spindle_90", "gcode", "spiral", "freeform")
#: At most so many rows of the cut are brought to rest, evenly.
ROWS = 1000


def measure(settings: Settings) -> Findings:
    """Plan the shipped jobs and bring them to rest."""
    rows, before, at, softer = [], [], [], []
    paths = shutil.copytree(ROOT / "paths", settings.work / "paths")
    for name in JOBS:
        written = paths / f"{name}.toml"
        table = tomllib.loads(written.read_text(encoding="utf-8"))
        table.setdefault("plan", {})["inertia"] = False
        table.setdefault("part", {})["touched_off"] = False  # the cell holds the arm where the base frame has the part
        written.write_text(tomli_w.dumps(table), encoding="utf-8")
        outcome = run_plan(written, settings.work / "plans" / name)
        plan, job = outcome.plan or {}, read_job(written)
        cut = read_joints(outcome.folder / "joints.csv", job.arm)
        fed = np.flatnonzero(~np.isin(cut.move, ("rapid", "approach", "retract")))
        few = fed[np.unique(np.linspace(0, len(fed) - 1, ROWS).astype(int))]
        left = []
        for factor in (1.0, 1.2):
            cell = SimulatedRobot(job.arm)
            cell.compliance *= factor
            tip = cell.rest(cut.q[few], cut.wrench[few]).position
            left.append(1e3 * float(np.linalg.norm(tip - cut.wanted[few], axis=1).max()))
        before.append(plan["error_before_mm"]["max"])
        at.append(left[0])
        softer.append(left[1])
        rows.append((f"`{name}`", plan["waypoints"], plan["status"], plan["verdict"]["word"], f"{before[-1]:.2f}",
                     f"{1e3 * left[0]:.2g}", f"{left[1]:.2f}"))  # fmt: skip
    head = ("job", "waypoints", "status", "verdict", "uncorrected, max mm", "after, as modelled, um",
            "after, 20 % softer, max mm")  # fmt: skip
    ratio = np.median(np.array(softer) / np.array(before))
    return Findings(
        (
            f"{len(JOBS)} shipped jobs: the uncorrected tip is {min(before):.2f} to {max(before):.2f} mm off the path.",
            f"As modelled, at most {max(1.0, 1e3 * max(at)):.0f} um remains at the waypoints, by MuJoCo.",
            f"On a robot 20 % softer than its model, {100 * ratio:.0f} % of the uncorrected error remains (median).",
        ),
        (draw_table(head, rows),),
        tuple(f"{row[0]}: {row[2]}" for row in rows if row[2] != "solved"),
    )
