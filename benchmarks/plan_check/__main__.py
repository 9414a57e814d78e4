"""Plan all shipped jobs and the own ones, judge them in the cell, and print claim beside truth.

    python -m benchmarks plan_check --out DIR [--jobs NAME ...] [--drawn N [--seed S]] [--keep] [--limit SECONDS]

Writes DIR/plan_check.json and DIR/plan_check.md. Exit status 1 where an answer cannot be trusted.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path

from benchmarks.plan_check.drawn import write_drawn
from benchmarks.plan_check.job import read_job, read_joints
from benchmarks.plan_check.measure import examine
from benchmarks.plan_check.mistakes import MISTAKES, mistake_of
from benchmarks.plan_check.paths import leave_inertia, write_jobs
from benchmarks.plan_check.run import ROOT, Outcome, run_plan
from benchmarks.plan_check.table import print_table, write_markdown
from benchmarks.plan_check.verdict import judge_answer, list_breaches

#: What a sound planner answers where that is not "solved".
EXPECTED = {
    "limits_reach": "refused", "overload": "refused", "correction_limit": "refused", "absurd_springs": "refused",
    "slab": "refused", "singularity": "any", "contact_without_ramp": "any",
    "heavy_fanuc_m10ia": "any",
    **{name: "refused" for name in MISTAKES if name != "mistake_none"},
}  # fmt: skip


def check(name: str, file: Path, folder: Path, *, keep: bool = False, limit_s: float = 900.0) -> dict:
    """Plan one job (or take what is there) and judge it."""
    expected = EXPECTED.get(name, "any" if name.startswith("drawn_") else "solved")
    outcome = _kept(folder) if keep else None
    if outcome is None:
        outcome = run_plan(file, folder, mistake=mistake_of(name), limit_s=limit_s)
        note = {"status": outcome.status, "said": outcome.said, "lines": outcome.lines, "cpu_s": outcome.cpu_s}
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "outcome.json").write_text(json.dumps(note), encoding="utf-8")
    job, found, breaches = read_job(file), None, []
    clock = time.monotonic()
    if outcome.plan is not None and (folder / "joints.csv").is_file():
        found = examine(job, outcome.plan, read_joints(folder / "joints.csv", job.arm))
        breaches = list_breaches(job.table, found, outcome.plan)
    return {
        "job": name,
        "expected": expected,
        "exit_status": outcome.status,
        "said": outcome.said,
        "cpu_s": outcome.cpu_s,
        "check_s": time.monotonic() - clock,
        "claim": _claim(outcome.plan),
        "truth": found,
        "tolerance_mm": job.tolerance * 1e3,
        "breaches": breaches,
        "verdict": judge_answer(expected, outcome, breaches, found, planted=bool(mistake_of(name))),
    }


def _claim(plan: dict | None) -> dict | None:
    if plan is None:
        return None
    return {
        "status": plan["status"],
        "after_mm": (plan.get("error_after_mm") or {}).get("max"),
        "between_mm": (plan.get("between_waypoints_mm") or {}).get("max"),
        "correction_mm": (plan.get("correction_mm") or {}).get("max"),
        "clearance_mm": (plan.get("clearance") or {}).get("least_mm"),
        "waypoints": plan.get("waypoints"),
        "notes": plan.get("notes", []),
    }


def _kept(folder: Path) -> Outcome | None:
    file = folder / "outcome.json"
    if not file.is_file():
        return None
    note = json.loads(file.read_text(encoding="utf-8"))
    plan = folder / "plan.json"
    known = json.loads(plan.read_text(encoding="utf-8")) if plan.is_file() else None
    return Outcome(note["status"], note["said"], note["cpu_s"], known, folder, note.get("lines", 1))


def main() -> None:
    """Run the check."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks plan_check", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--jobs", nargs="+", help="names of jobs; default: all")
    parser.add_argument("--keep", action="store_true", help="judge plans that an earlier run left in DIR")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds that a plan may take")
    parser.add_argument("--drawn", type=int, default=0, help="plan this many drawn jobs in place of the written ones")
    parser.add_argument("--seed", type=int, default=0, help="first seed of the drawn jobs")
    wish = parser.parse_args()
    shipped = shutil.copytree(ROOT / "paths", wish.out / "shipped", dirs_exist_ok=True)
    jobs = {file.stem: file for file in sorted(shipped.glob("*.toml"))} | write_jobs(wish.out / "jobs")
    if wish.drawn:
        files = (write_drawn(wish.out / "jobs", seed) for seed in range(wish.seed, wish.seed + wish.drawn))
        jobs = {file.stem: file for file in files}
    unknown = sorted(set(wish.jobs or []) - set(jobs))
    if unknown:
        parser.error(f"no job {unknown[0]!r}, choose from {sorted(jobs)}")
    results = []
    jobs = {name: leave_inertia(file) for name, file in jobs.items()}
    for name in wish.jobs or jobs:
        results.append(check(name, jobs[name], wish.out / "plans" / name, keep=wish.keep, limit_s=wish.limit))
        print(f"{name}: {results[-1]['verdict']}", file=sys.stderr, flush=True)
        (wish.out / "plan_check.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    print_table(results)
    write_markdown(results, wish.out / "plan_check.md")
    sys.exit(any(result["verdict"].startswith("FAILS") for result in results))


if __name__ == "__main__":
    main()
