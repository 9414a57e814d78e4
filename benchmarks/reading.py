"""What both readers make of the programs of tests/truth: a table, docs/what_is_read.md.

python -m benchmarks reading [--check]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "what_is_read.md"
sys.path.insert(0, str(ROOT / "tests" / "support"))

from truth_cases import Case, find_difference_from, find_wrong_move, list_cases  # noqa: E402

from tests.oracles.cam.cam import read_moves  # noqa: E402
from tests.oracles.cam.moves import CannotTellError  # noqa: E402

HEAD = """# What is read

Programs in the exact form of common posts, heads and ends included (`tests/truth`). Every move, rapid end and arc of a
reading is compared with the moves that the standards ask for, worked out by hand. The first reader makes plans, the
second one (`tests/oracles/cam`) shares nothing with it and serves tests alone. Written by
`python -m benchmarks reading`.

"""


def judge_first(case: Case) -> str:
    """Return what the first reader makes of a program, in a word."""
    difference = find_difference_from(case)
    return "as it is" if not difference else "refused" if difference.startswith("refused") else "otherwise"


def judge_second(case: Case) -> str:
    """Return what the second reader makes of a program, in a word."""
    try:
        return "otherwise" if find_wrong_move(read_moves(case.file, dict(case.options)), case.moves) else "as it is"
    except CannotTellError:
        return "cannot tell"


def write_page() -> str:
    """Return the text of the table."""
    rows = [(case, judge_first(case), judge_second(case)) for case in list_cases()]
    counts = [
        f"{len(rows)} programs, {sum(len(case.moves) for case, *_ in rows)} moves: the first reader reads "
        f"{sum(first == 'as it is' for _, first, _ in rows)} as they are, refuses "
        f"{sum(first == 'refused' for _, first, _ in rows)}, and reads "
        f"{sum(first == 'otherwise' for _, first, _ in rows)} otherwise; the second reads "
        f"{sum(second == 'as it is' for *_, second in rows)} and cannot tell "
        f"{sum(second == 'cannot tell' for *_, second in rows)}.\n\n"
    ]
    table = ["| program | form | moves | first reader | second reader |\n", "|---|---|---|---|---|\n"]
    table += [f"| {c.file.name} | {c.form} | {len(c.moves)} | {a} | {b} |\n" for c, a, b in rows]
    return "".join([HEAD, *counts, *table])


def main() -> int:
    """Write the page, or tell whether it is as it would be written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="Write nothing; 1 if the page is not as it would be.")
    if parser.parse_args().check:
        return int(PAGE.read_text(encoding="utf-8") != write_page())
    PAGE.write_text(write_page(), encoding="utf-8")
    for case in list_cases():
        if difference := find_difference_from(case):
            print(f"{case.file.name}: {difference}")
    print(PAGE.read_text(encoding="utf-8").splitlines()[8])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
