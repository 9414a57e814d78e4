"""What the reader makes of the programs of tests/truth: a table, docs/what_is_read.md.

python -m benchmarks reading [--check]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "what_is_read.md"
sys.path.insert(0, str(ROOT / "tests" / "support"))

from truth_cases import Case, find_difference_from, list_cases  # noqa: E402

HEAD = """# What is read

Programs in the exact form of common posts, heads and ends included (`tests/truth`). Every move, rapid end and arc is
compared with the moves that the standards ask for, worked out by hand. Written by `python -m benchmarks reading`.

"""


def judge(case: Case) -> str:
    """Return what the reader makes of a program, in a word."""
    difference = find_difference_from(case)
    return "as it is" if not difference else "refused" if difference.startswith("refused") else "otherwise"


def write_page() -> str:
    """Return the text of the table."""
    rows = [(case, judge(case)) for case in list_cases()]
    count = {word: sum(said == word for _, said in rows) for word in ("as it is", "refused", "otherwise")}
    told = (
        f"{len(rows)} programs, {sum(len(case.moves) for case, _ in rows)} moves: {count['as it is']} are read as they "
        f"are, {count['refused']} are refused, {count['otherwise']} are read otherwise.\n\n"
    )
    table = ["| program | form | moves | read |\n", "|---|---|---|---|\n"]
    table += [f"| {case.file.name} | {case.form} | {len(case.moves)} | {said} |\n" for case, said in rows]
    return "".join([HEAD, told, *table])


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
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
