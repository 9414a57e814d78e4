"""The nonlinear program beside another state of the project: status, exactness, cycle, band and CPU of shipped jobs.

    python -m benchmarks nlp [--beside CHECKOUT] [--jobs paths/circle_10mm.toml,...] [--out docs/results/nlp.md]

Every job is planned by the command line in a process of its own, here and in the other checkout, one after the other.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
JOBS = (
    "paths/circle_10mm.toml", "paths/spiral.toml", "paths/isf_cone.toml", "paths/limits_feed.toml",
    "paths/limits_reach.toml", "paths/circle_spindle_90.toml", "examples/rail/circle.toml",
    "examples/positioner/groove.toml", "paths/isf_cone_50k.toml",
)  # fmt: skip
#: First lines of the page.
HEAD = (
    "# The nonlinear program: exact, and at what cost?", "",
    "**Question.** How do band, cycle and CPU time of shipped jobs compare with an earlier version?", "",
    "Written by `python -m benchmarks nlp --beside CHECKOUT --out docs/results/nlp.md`. CPU is that of the whole",
    "command, both checkouts in one run. Each computes its own 95 % band.", "",
)  # fmt: skip


class Planned(NamedTuple):
    """What one checkout makes of a job; lengths in mm, times in s."""

    status: str
    waypoints: int
    deviation: float
    between: float
    cycle: float
    band: float | None
    cpu: float
    program: dict[str, object]


def plan_job(root: Path, job: str) -> Planned:
    """Plan a job by the command line of a checkout."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
        words = [sys.executable, "-m", "compplan", "plan", str(root / job), "--out", str(out)]
        subprocess.run(words, env=environment, cwd=root, capture_output=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        plan = json.loads((out / "plan.json").read_text(encoding="utf-8"))
        with (out / "joints.csv").open(encoding="utf-8") as file:
            cycle = float(list(csv.DictReader(file))[-1]["time_s"])
    band = plan.get("error_band_mm") or plan.get("promise_mm") or {}
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    deviation, between = (plan[name]["max"] for name in ("error_after_mm", "between_waypoints_mm"))
    return Planned(plan["status"], plan["waypoints"], deviation, between, cycle, band.get("p95_max"), cpu,
                   plan.get("nlp") or {})  # fmt: skip


def show(planned: Planned) -> str:
    """Show what was planned in cells of a table."""
    band = "-" if planned.band is None else f"{planned.band:.3f}"
    program = planned.program
    told = f"{program['stations']} / {program['iterations']} / {program['cpu_s']:.2f}" if program else "-"
    return (f"{planned.status} | {planned.waypoints} | {planned.deviation:.1e} | {planned.between:.1e} | "
            f"{planned.cycle:.3f} | {band} | {told} | {planned.cpu:.2f} |")  # fmt: skip


def list_cells(job: str, here: Planned, beside: Planned) -> str:
    """Return a row of the page: deviation here, then cycle, band and CPU of both."""
    bands = ["-" if planned.band is None else f"{planned.band:.3f}" for planned in (here, beside)]
    off = f"{here.deviation:.0e}/{here.between:.0e}" if here.status == "solved" else here.status
    return (f"| `{job}` | {off} | {here.cycle:.3f} ({beside.cycle:.3f}) | {bands[0]} ({bands[1]}) | "
            f"{here.cpu:.2f} ({beside.cpu:.2f}) |")  # fmt: skip


def compare(pairs: list[tuple[Planned, Planned]]) -> list[str]:
    """Say in a few lines what jobs come to here beside the other checkout."""
    cpu = [here.cpu / beside.cpu for here, beside in pairs]
    solved = [(here, beside) for here, beside in pairs if here.status == "solved"]
    cycle = max(here.cycle / beside.cycle for here, beside in solved)
    off, before = (max(planned.deviation for planned in side) for side in zip(*solved, strict=True))
    bands = [here.band / beside.band for here, beside in pairs if here.band and beside.band]
    alike = sum(here.status == beside.status for here, beside in pairs)
    return [
        "## In short", "",
        f"- CPU is {np.exp(np.mean(np.log(cpu))):.2f} of that beside in the geometric mean, {max(cpu):.2f} at worst.",
        f"- {alike} of {len(pairs)} jobs have the same status; the cycle is at most {cycle - 1.0:+.1%}.",
        f"- At waypoints the loaded tip is off by at most {off:.0e} mm (beside: {before:.0e}) in solved jobs.",
        f"- The widest 95 % band is {min(bands):.2f} to {max(bands):.2f} of that beside.", "",
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--beside", type=Path, help="another checkout, such as the state before a change")
    parser.add_argument("--jobs", default=",".join(JOBS))
    parser.add_argument("--out", type=Path, help="page to write the table to, with the commits of both checkouts")
    given = parser.parse_args()
    roots = {"here": ROOT} | ({} if given.beside is None else {"beside": given.beside})
    lines: list[str] = []

    def tell(text: str) -> None:
        lines.extend(text.split("\n"))
        print(text, flush=True)

    for name, root in roots.items():
        words = ["git", "-C", str(root), "log", "-1", "--format=%h"]
        commit = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
        tell(f"- *{name}*: commit {commit}")
    tell("")
    tell("| job | checkout | status | waypoints | at waypoints mm | between mm | cycle s | band mm | "
          "stations / iterations / CPU s of the program | CPU s |\n" + "|---" * 10 + "|")  # fmt: skip
    pairs = []
    for job in given.jobs.split(","):
        found = []
        for name, root in roots.items():
            found.append(plan_job(root, job))
            tell(f"| `{job}` | {name} | {show(found[-1])}")
        pairs.append((found[0], found[-1]))
    if given.out is not None:
        rows = [list_cells(job, *pair) for job, pair in zip(given.jobs.split(","), pairs, strict=True)]
        head = ["In brackets: beside.", "", "| job | off at/between mm | cycle s | band mm | CPU s |", "|---" * 5 + "|"]
        commits = lines[: len(roots) + 1]
        given.out.write_text("\n".join([*HEAD, *compare(pairs), *commits, *head, *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
