"""Read public programs and programs in the form of common posts; write the table of docs/cam_files.md.

python -m benchmarks reading [FOLDER ..] [--unit mm] [--check]

Programs of tests/public_programs, tests/posts, tests/truth, paths, examples, and of folders that are named. Those of
tests/truth have the moves that the standards ask for: a program is read right where every move is the expected one.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers import CamTable, find_reader, read_cam, refuse_idle

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "cam_files.md"
sys.path.insert(0, str(ROOT / "tests" / "support"))

from truth_cases import Case, find_difference_from, list_cases  # noqa: E402

FOLDERS = ("tests/public_programs", "tests/posts", "tests/truth", "paths", "examples")
NO_PROGRAMS = {".csv", ".json", ".md", ".moves", ".ply", ".py", ".stl", ".toml", ".txt"}


def list_rows() -> list[str]:
    """Return the rows of the table, one a dialect."""
    by_dialect: dict[str, list[Case]] = defaultdict(list)
    for case in list_cases():
        reader = find_reader(case.file, case.file.read_text(encoding="latin-1"))
        by_dialect["none" if reader is None else reader.name].append(case)
    rows = []
    for dialect, cases in sorted(by_dialect.items()):
        faults = [find_difference_from(case) for case in cases]
        refused = sum(fault.startswith("refused") for fault in faults)
        posts = sorted({re.split("[,:]", case.form)[0].strip() for case in cases if ":" in case.form})
        counts = (len(cases), sum(len(case.moves) for case in cases), faults.count(""), refused)
        cells = [dialect, ", ".join(posts), *map(str, counts), str(len(cases) - counts[2] - refused)]
        rows.append(f"| {' | '.join(cells)} |\n")
    return rows


def fill_page(text: str) -> str:
    """Return the text of the page with its table replaced."""
    head, rule, _ = text.rpartition("|---|---|---|---|---|---|---|\n")
    return "".join([head, rule, *list_rows()])


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
    """Print the table and fill the page, or check that the page holds it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="Further folders of programs.")
    parser.add_argument("--unit", choices=("mm", "inch"), help="Unit of programs that state none.")
    parser.add_argument("--check", action="store_true", help="Write nothing; 1 if the page is not as it would be.")
    asked = parser.parse_args()
    if asked.check:
        return int(PAGE.read_text(encoding="utf-8") != fill_page(PAGE.read_text(encoding="utf-8")))
    PAGE.write_text(fill_page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print_table([*(ROOT / name for name in FOLDERS), *asked.folders], asked.unit)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
