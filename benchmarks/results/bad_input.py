"""Bad inputs: one clear line, status 2, nothing written."""

from __future__ import annotations

import json
from collections import Counter

from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "Bad input: is every mistake answered in one line?"
QUESTION = "Wrong jobs, robots, logs, CAM files and command lines: is each refused in one line, with nothing written?"
METHOD = (
    "`python -m benchmarks bad_inputs` runs entries of `tests/bad_inputs/`, each one edit of a good workspace with the "
    "answer that it deserves; here every sixtieth entry. The rest: [trust](../trust.md)."
)
LIMITS = ("The tables hold mistakes that somebody thought of.",)
PART = "7/60"


def measure(settings: Settings) -> Findings:
    """Run a part of the tables."""
    file = settings.work / "answers.json"
    run_benchmark("benchmarks.bad_inputs", "--part", PART, "--out", file)
    answers = json.loads(file.read_text("utf-8"))
    faults = [answer for answer in answers if answer["fault"]]
    kinds = Counter(answer["fault"] for answer in faults)
    rows = [(answer["case"], answer["fault"], answer["status"], f"`{answer['line'][-120:]}`") for answer in faults]
    internal = sum("internal fault" in answer["line"] for answer in answers)
    return Findings(
        (f"{len(answers) - len(faults)} of {len(answers)} bad inputs are answered as they should be; {internal} end in "
         "an internal fault.",),
        (draw_table(("case", "fault", "status", "line"), rows or [("none", "", "", "")]),),
        tuple(f"{count} times: {kind}" for kind, count in kinds.items()),
    )  # fmt: skip
