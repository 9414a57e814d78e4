"""The 95 % band on arms in motion."""

from __future__ import annotations

import json

from benchmarks.coverage.table import list_coverage, list_verdicts
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = 'Coverage: is a part that "keeps" its tolerance within it?'
QUESTION = 'Does the 95 % band hold the tip of an arm in motion, and is "keeps" ever wrong?'
METHOD = (
    "`python -m benchmarks coverage` draws short jobs on shipped robots and lets true arms run `joints.csv` in a "
    "second engine: compliances, masses, frequencies and damping of each arm are drawn from what the folder says of "
    "them."
)
CHART = Chart("tips within the 95 % band, %", {"held": ("held, %", 0)})
LIMITS = (
    "The controller of the moving arm is ideal: its servos follow joints.csv. A real one lags and blends.",
    "Damping and widths of the drawn arms are the assumed ones of the robot folders.",
    "Runs of the moving arm begin at rest; ringing after rapid moves is no part of the band.",
)
JOBS, FIRST = 60, 100
#: Share of tips that the band should hold. [%]
AIM = (93.0, 97.0)


def measure(settings: Settings) -> Findings:
    """Run arms in motion."""
    folder = settings.work / "coverage"
    run_benchmark("benchmarks.coverage", "--out", folder, "--jobs", JOBS, "--seed", FIRST)
    jobs = [json.loads((folder / f"seed_{seed}.json").read_text("utf-8")) for seed in range(FIRST, FIRST + JOBS)]
    solved = [job for job in jobs if job["status"] == "solved"]
    coverage, words = list_coverage(solved), list_verdicts(solved)
    wrong = next((row[2] for row in words if row[0] == "keeps"), "0.0")
    return Findings(
        (
            f"{len(solved)} of {JOBS} drawn jobs are solved.",
            "On arms in motion the 95 % band holds "
            + ", ".join(f"{row[3]} % ({row[0]})" for row in coverage)
            + " of the tips.",
            f'"keeps" was wrong on {wrong} % of the drawn arms.',
        ),
        (
            "The 95 % band on arms in motion, by speed of the cut\n\n"
            + draw_table(("speed", "mm/s", "jobs", "held, %", "+-", "true 95 % point / band"), coverage),
            "The verdict and the drawn arms\n\n"
            + draw_table(("verdict", "jobs", "arms beyond the tolerance, %", "worst job, %"), words),
        ),
        (
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
