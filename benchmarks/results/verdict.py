"""The verdict: planted mistakes, and the band on arms in motion."""

from __future__ import annotations

import json

from benchmarks.moving.table import list_coverage, list_verdicts
from benchmarks.planted import LISTS, write_counts
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = 'Verdict: is a part that "keeps" its tolerance within it?'
QUESTION = (
    "Is a plan that rests on a mistake called solved; does the 95 % band hold the tip of an arm in motion; and is "
    '"keeps" ever wrong?'
)
METHOD = (
    "`python -m benchmarks planted` puts mistakes into a copy of the package, one at a time, and plans with it. "
    "`python -m benchmarks moving` draws short jobs on shipped robots and lets true arms run `joints.csv` in a second "
    "engine: compliances, masses, frequencies and damping of each arm are drawn from what the folder says of them."
)
LIMITS = (
    "The controller of the moving arm is ideal: its servos follow joints.csv. A real one lags and blends.",
    "Damping and widths of the drawn arms are the assumed ones of the robot folders.",
    "One list of mistakes is by the author of the checks; the others are by people who had not read them.",
    "Runs of the moving arm begin at rest; ringing after rapid moves is no part of the band.",
)
JOBS, FIRST = 60, 100
#: Share of tips that the band should hold. [%]
AIM = (93.0, 97.0)


def measure(settings: Settings) -> Findings:
    """Plant mistakes, run arms in motion."""
    planted = _plant(settings)
    moving = settings.work / "moving"
    run_benchmark("benchmarks.moving", "--out", moving, "--jobs", JOBS, "--seed", FIRST)
    jobs = [json.loads((moving / f"seed_{seed}.json").read_text("utf-8")) for seed in range(FIRST, FIRST + JOBS)]
    solved = [job for job in jobs if job["status"] == "solved"]
    coverage, words = list_coverage(solved), list_verdicts(solved)
    mistakes = [row for row in planted if row["area"]]
    clean = [row for row in planted if not row["area"]]
    called = [row for row in mistakes if row["outcome"] == "called solved"]
    wrong = next((row[2] for row in words if row[0] == "keeps"), "0.0")
    return Findings(
        (
            f"{len(mistakes)} planted mistakes: {len(called)} called solved. "
            f"{sum(row['status'] == 'solved' for row in clean)} of {len(clean)} jobs without a mistake are solved.",
            f"{len(solved)} of {JOBS} drawn jobs are solved.",
            "On arms in motion the 95 % band holds "
            + ", ".join(f"{row[3]} % ({row[0]})" for row in coverage)
            + " of the tips.",
            f'"keeps" was wrong on {wrong} % of the drawn arms.',
        ),
        (
            "Planted mistakes\n\n" + write_counts(mistakes, by="list"),
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
            *(f"Called solved: {row['name']} ({row['list']})." for row in called),
            *(f"Not solved: {job['robot']} (seed {job['seed']}), {_tell_fault(job['said'])}" for job in jobs
              if job not in solved),
        ),
    )  # fmt: skip


def _tell_fault(said: str) -> str:
    """Return what an error line says, without the file that it names."""
    return said.split(".toml: ")[-1].removeprefix("error: ").split("; ")[0][:160]


def _plant(settings: Settings) -> list[dict]:
    rows = []
    for file in LISTS:
        out = settings.work / f"{file.stem}.json"
        if not out.is_file():
            run_benchmark("benchmarks.planted", "--list", file, "--out", out)
        rows += json.loads(out.read_text("utf-8"))
    return rows
