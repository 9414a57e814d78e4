"""Postures beside the CAM default and brute force."""

from __future__ import annotations

import json

from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "Posture: does the choice of spin and configuration pay?"
QUESTION = "How much deviation does the chosen posture leave, beside the CAM default and a brute-force optimum?"
METHOD = (
    "`python -m benchmarks posture` ([method](../../benchmarks/posture.md)): the 95 % value of what remains after "
    "compensation under 10 % error of each wrench component and each compliance (assumed), from Pinocchio's Jacobians. "
    "Brute force tries all configurations and rotations in steps of 1 degree and shares no cost code with the search. "
    "Joint motion is not priced here."
)
LIMITS = (
    "Six of the twelve jobs of the benchmark, chosen before they were run: every second one.",
    "By default the planner also prices joint motion, so a shipped plan may stand elsewhere.",
)
JOBS = (0, 2, 4, 6, 8, 10)


def measure(settings: Settings) -> Findings:
    """Run the benchmark."""
    file = settings.work / "posture.json"
    run_benchmark("benchmarks.posture", "--jobs", *JOBS, "--out", file)
    rows = json.loads(file.read_text("utf-8"))["rows"]
    ratios, optimum = [row["ratio"] for row in rows], [row["to_optimum"] for row in rows]
    table = draw_table(
        ("job", "CAM default, mm", "chosen, mm", "ratio", "rms to brute force", "graph, s"),
        [(r["job"], f"{r['cam_mm']:.3f}", f"{r['accurate_mm']:.3f}", f"{r['ratio']:.2f}", f"{r['to_optimum']:.3f}",
          f"{r['graph_s']:.1f}") for r in rows],
    )  # fmt: skip
    gain = sum(ratio <= 0.8 for ratio in ratios)
    return Findings(
        (
            f"The remaining deviation is {100 * (1 - max(ratios)):.0f} to {100 * (1 - min(ratios)):.0f} % smaller "
            "than in the CAM default.",
            f"It lies within {100 * (max(optimum) - 1):.0f} % of the brute-force optimum on all {len(rows)} jobs.",
        ),
        (table,),
        (f"Only {gain} of {len(rows)} jobs gain 20 % or more: on the others the CAM default already stands well.",),
    )
