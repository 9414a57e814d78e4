"""Run every bad input: `python -m benchmarks bad_inputs [--table NAME] [--only TEXT] [--part K/N] [--out FILE]`.

With `--mutate N --seed S [--first K] [--target NAME]` it runs N mutants of robots, logs, jobs and other files instead,
under the same watchdog.
"""

from __future__ import annotations

import argparse
import collections
import json
import re
import sys
import time
from pathlib import Path

from benchmarks.bad_inputs.making import make_workspace
from benchmarks.bad_inputs.mutating import TARGETS, draw_mutants
from benchmarks.bad_inputs.running import Answer, load_commands, run_case
from benchmarks.bad_inputs.tables import BadInput, read_tables


def main() -> None:
    """Print how many answers are wrong and which, and leave with 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks bad_inputs", description=__doc__)
    parser.add_argument("--table", help="only this table")
    parser.add_argument("--only", default="", help="only cases whose name holds this")
    parser.add_argument("--part", default="1/1", help="share of the cases: 2/5 is the second of five parts")
    parser.add_argument("--out", type=Path, help="JSON file for every answer")
    parser.add_argument("--show", action="store_true", help="show the line of every case")
    parser.add_argument("--mutate", type=int, metavar="N", help="N mutants instead of the tables")
    parser.add_argument("--seed", type=int, default=0, help="seed of the mutants")
    parser.add_argument("--target", action="append", default=[], choices=[*TARGETS], help="mutants of this target only")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--keep", type=Path, help="folder that the workspaces of wrong answers are kept in")
    parser.add_argument("--list", action="store_true", help="count the cases and leave")
    given = parser.parse_args()
    mutants = draw_mutants(given.mutate or 0, given.seed, first=given.first, targets=given.target)
    drawn = read_tables() if given.mutate is None else mutants
    cases = [case for case in drawn if given.table in (None, case.table) and given.only in case.name]
    part, parts = map(int, given.part.split("/"))
    cases = cases[part - 1 :: parts]
    tables = collections.Counter(case.table for case in cases)
    print(f"{len(cases)} bad inputs: " + ", ".join(f"{count} {name}" for name, count in tables.items()))
    if given.list:
        return
    load_commands()
    started, answers = time.monotonic(), []
    for case in cases:
        answer = run_case(case)
        answers.append((case, answer, answer.judge(case)))
        fault = answers[-1][2]
        if fault or given.show:
            last = (answer.err.strip() or answer.out.strip()).splitlines()[-1:] or [""]
            if fault and given.keep:
                make_workspace(case, given.keep / re.sub(r"\W+", "_", case.name)[:80])
            print(f"{fault or 'ok':<16} {case.name}\n{'':<16} {answer.status} {last[0][:220]}", flush=True)
    report(answers, time.monotonic() - started)
    if given.out:
        given.out.write_text(json.dumps([describe(*entry) for entry in answers], indent=1))
    sys.exit(int(any(fault for _, _, fault in answers)))


def report(answers: list[tuple[BadInput, Answer, str]], seconds: float) -> None:
    """Print the counts of a run."""
    faults = collections.Counter(fault for _, _, fault in answers if fault)
    slowest = max(answers, key=lambda entry: entry[1].seconds)
    largest = max(answers, key=lambda entry: entry[1].memory)
    right = sum(not fault for _, _, fault in answers)
    rest = "".join(f", {count} {fault}" for fault, count in faults.most_common())
    print(f"\n{right} of {len(answers)} answered as they should be{rest}")
    print(f"slowest {slowest[1].seconds:.1f} s ({slowest[0].name})")
    print(f"most memory {largest[1].memory / 2**20:.0f} MB ({largest[0].name}); {seconds:.0f} s in all")


def describe(case: BadInput, answer: Answer, fault: str) -> dict[str, object]:
    """Return one answer for the JSON file."""
    return {
        "case": case.name, "command": case.command, "fault": fault, "status": answer.status,
        "line": answer.err.strip()[-400:], "seconds": round(answer.seconds, 2), "wrote": list(answer.wrote),
    }  # fmt: skip


if __name__ == "__main__":
    main()
