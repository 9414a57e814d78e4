"""The 95 % band: on touched-off parts, on arms in motion, and after further measurements."""

from __future__ import annotations

import json

import numpy as np

from benchmarks.coverage.table import list_coverage, list_verdicts
from benchmarks.coverage.touched import list_jobs
from benchmarks.ladder import AIM as NEAR
from benchmarks.ladder import RUNGS, find_steps, list_rungs
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = 'Coverage: is a part that "keeps" its tolerance within it?'
QUESTION = (
    'Does the 95 % band hold the tip, how wide is it, is "keeps" ever wrong, and does the ladder predict the band '
    "after a further measurement?"
)
METHOD = (
    "`python -m benchmarks coverage.touched` lets drawn arms at rest touch three corners of a part to 20 um and run "
    "shipped jobs in three sizes; `python -m benchmarks ladder` compares the ladder of a plan with plans of virtual "
    "shops after each measurement (force log and touch-off: as the job states them). "
    "`python -m benchmarks coverage` draws short jobs on shipped robots and lets true arms run `joints.csv` in a "
    "second engine: compliances, masses, frequencies and damping of each arm are drawn from the uncertainty "
    "that the folder states."
)
CHART = Chart("tips within the 95 % band, %", {"held": ("held, %", 0)})
LIMITS = (
    "The controller of the moving arm is ideal: its servos follow joints.csv. A real one lags and blends.",
    "Runs of the moving arm begin at rest; ringing after rapid moves is not part of the band.",
)
JOBS, FIRST, ARMS, SHOPS = 20, 100, 200, 12
#: Share of tips that the band should hold [%], and what it may be over the true 95 % point.
AIM, WIDE = (93.0, 97.0), 1.4


def measure(settings: Settings) -> Findings:
    """Run touched-off parts, arms in motion, and virtual shops; all in the work folder is kept as it is."""
    folder, loop, touch = (settings.work / name for name in ("coverage", "loop", "touched"))
    run_benchmark("benchmarks.coverage.touched", "--out", touch, "--arms", ARMS)
    parts = [json.loads(file.read_text("utf-8")) for file in sorted(touch.glob("*.json"))]
    touched = list_jobs(parts)
    ratios = [float(row[4]) for row in touched]
    held = np.mean([np.mean(np.array(one["away_mm"]) <= np.array(one["band_mm"])) for one in parts])
    run_benchmark("benchmarks.loop", "--shops", settings.shops or SHOPS, "--out", loop)
    steps = find_steps(loop)
    run_benchmark("benchmarks.coverage", "--out", folder, "--jobs", JOBS, "--seed", FIRST)
    jobs = [json.loads((folder / f"seed_{seed}.json").read_text("utf-8")) for seed in range(FIRST, FIRST + JOBS)]
    solved = [job for job in jobs if job["status"] == "solved"]
    coverage, verdicts = list_coverage(solved), list_verdicts(solved)
    wrong = next((row[2] for row in verdicts if row[0] == "keeps"), "0.0")
    return Findings(
        (
            f"On {len(parts)} touched-off parts with {ARMS} arms each, the band holds {100 * held:.1f} % of tips; it "
            f"is {np.median(ratios):.2f} times the true 95 % point in the median, {max(ratios):.2f} at most.",
            f"The ladder's band is within {NEAR:.0%} of the later one in "
            + ", ".join(f"{row[4]} ({row[0]})" for row in list_rungs(steps))
            + " shops.",
            f"{len(solved)} of {JOBS} drawn jobs are solved.",
            "On arms in motion the 95 % band holds "
            + ", ".join(f"{row[3]} % ({row[0]})" for row in coverage)
            + " of the tips.",
            f'"keeps" was wrong on {wrong} % of the drawn arms.',
        ),
        (
            "Touched-off parts: the band and the true 95 % point where they are widest\n\n"
            + draw_table(("job, scale", "band, mm", "true, mm", "held, %", "band / true, median"), touched),
            "The band of the whole path after each measurement of the ladder alone\n\n"
            + draw_table(("rung", "before, mm", "after, mm", "predicted / after (range)", "within 25 %"),
                         list_rungs(steps)),
            "The 95 % band on arms in motion, by speed of the cut\n\n"
            + draw_table(("speed", "mm/s", "jobs", "held, %", "+-", "true 95 % point / band"), coverage),
        ),
        (
            *(f"Touched-off {row[0]}: the band holds {row[3]} % of the tips, {row[4]} times the true 95 % point."
              for row in touched if not AIM[0] <= float(row[3]) <= AIM[1] or float(row[4]) > WIDE),
            *(f"Ladder, {rung}: more than {NEAR:.0%} off in shops {', '.join(far)}." for rung in RUNGS
              if (far := [s.shop[-2:] for s in steps if s.rung == rung and abs(s.ratio - 1.0) > NEAR])),
            *(
                f"The band holds {row[3]} % of {row[0]} tips (aim {AIM[0]:.0f} to {AIM[1]:.0f} %)."
                for row in coverage
                if not AIM[0] <= float(row[3]) <= AIM[1]
            ),
            *(f"Not solved: {job['robot']} (seed {job['seed']}), {_shorten(job['said'])}" for job in jobs
              if job not in solved),
        ),
    )  # fmt: skip


def _shorten(said: str) -> str:
    """Return what an error line says, without the file that it names."""
    return said.split(".toml: ")[-1].removeprefix("error: ").split("; ")[0][:160]
