"""What is read of public programs and of those in the form of common posts, by dialect; docs/what_is_read.md.

python -m benchmarks reading [FOLDER ..] [--unit mm] [--check]

Programs of tests/public_programs, tests/posts, tests/truth, paths, examples, and of folders that are named. Those of
tests/truth have the moves that the standards ask for: a reading is right where every move is the one expected.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers import CamTable, find_reader, read_cam, refuse_idle

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "what_is_read.md"
sys.path.insert(0, str(ROOT / "tests" / "support"))

from truth_cases import Case, find_difference_from, list_cases  # noqa: E402

FOLDERS = ("tests/public_programs", "tests/posts", "tests/truth", "paths", "examples")
NO_PROGRAMS = {".csv", ".json", ".md", ".moves", ".ply", ".py", ".stl", ".toml", ".txt"}
HEAD = """# What is read

Programs in the exact form of common posts, heads and ends included (`tests/truth`). Every move, rapid end and arc is
compared with the moves that the standards ask for, worked out by hand. Written by `python -m benchmarks reading`.

"""


def judge(case: Case) -> str:
    """Return what the reader makes of a program, in a word."""
    difference = find_difference_from(case)
    return "as it is" if not difference else "refused" if difference.startswith("refused") else "otherwise"


def write_page() -> str:
    """Return the text of the page."""
    rows = [(case, judge(case)) for case in list_cases()]
    count = {word: sum(said == word for _, said in rows) for word in ("as it is", "refused", "otherwise")}
    told = (
        f"{len(rows)} programs, {sum(len(case.moves) for case, _ in rows)} moves: {count['as it is']} are read as they "
        f"are, {count['refused']} are refused, {count['otherwise']} are read otherwise.\n\n"
    )
    table = ["| program | form | moves | read |\n", "|---|---|---|---|\n"]
    table += [f"| {case.file.name} | {case.form} | {len(case.moves)} | {said} |\n" for case, said in rows]
    return "".join([HEAD, told, *table])


def list_programs(folders: list[Path]) -> Iterator[tuple[Path, str]]:
    """Yield the programs of folders, and the dialect of each."""
    for folder in folders:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            text = "" if file.suffix.lower() in NO_PROGRAMS else file.read_text(encoding="latin-1")
            reader = find_reader(file, text) if text and "\0" not in text else None
            if reader is not None:
                yield file, reader.name


def print_table(folders: list[Path], unit: str | None) -> None:
    """Print how many programs are read by dialect, what is refused and why, and what is read otherwise."""
    expected = {case.file.resolve(): case for case in list_cases()}
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    told: list[str] = []
    for file, dialect in list_programs(folders):
        row, case = counts[dialect], expected.get(file.resolve())
        row[0] += 1
        try:
            refuse_idle(read_cam(file, CamTable.model_validate({"unit": unit, **(case.options if case else {})})))
        except InputError as fault:
            told.append(f"{dialect}: {file.name}: refused, line {fault.where}: {fault.message}")
            continue
        difference = "" if case is None else find_difference_from(case)
        row[1] += 1
        row[2] += case is not None
        row[3] += case is not None and not difference
        told += [f"{dialect}: {file.name}: read otherwise: {difference}"] if difference else []
    print(f"{'dialect':<12}{'programs':>9}{'read':>6}{'refused':>9}{'moves known':>13}{'right':>7}")
    for name, (programs, read, known, right) in sorted(counts.items()):
        print(f"{name:<12}{programs:>9}{read:>6}{programs - read:>9}{known:>13}{right:>7}")
    print(*told, sep="\n")


def main() -> int:
    """Print the table and write the page, or tell whether the page is as it would be written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="Further folders of programs.")
    parser.add_argument("--unit", choices=("mm", "inch"), help="Unit of programs that state none.")
    parser.add_argument("--check", action="store_true", help="Write nothing; 1 if the page is not as it would be.")
    asked = parser.parse_args()
    if asked.check:
        return int(PAGE.read_text(encoding="utf-8") != write_page())
    PAGE.write_text(write_page(), encoding="utf-8")
    print_table([*(ROOT / name for name in FOLDERS), *asked.folders], asked.unit)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
