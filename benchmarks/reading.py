"""What of public programs and of those in the form of common posts is read, by dialect: `python -m benchmarks reading`.

Programs of tests/public_programs, tests/posts, tests/truth, paths, examples, and of folders that are named. Those of
tests/truth have the moves that the standards ask for; a reading counts as right where every move is the one expected.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers import CamTable, find_reader, read_cam, refuse_idle

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

from truth_cases import find_difference_from, list_cases  # noqa: E402

FOLDERS = ("tests/public_programs", "tests/posts", "tests/truth", "paths", "examples")
NO_PROGRAMS = {".csv", ".json", ".md", ".moves", ".ply", ".py", ".stl", ".toml", ".txt"}


def main() -> int:
    """Print the table, what is refused and why, and what is read otherwise than expected."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="Further folders of programs.")
    parser.add_argument("--unit", choices=("mm", "inch"), help="Unit of programs that state none.")
    asked = parser.parse_args()
    expected = {case.file.resolve(): case for case in list_cases()}
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    told: list[str] = []
    for folder in [*(ROOT / name for name in FOLDERS), *asked.folders]:
        for file in sorted(path for path in folder.rglob("*") if path.is_file()):
            text = "" if file.suffix.lower() in NO_PROGRAMS else file.read_text(encoding="latin-1")
            reader = find_reader(file, text) if text and "\0" not in text else None
            if reader is None:
                continue
            row, case = counts[reader.name], expected.get(file.resolve())
            row[0] += 1
            try:
                options = {"unit": asked.unit, **(case.options if case else {})}
                refuse_idle(read_cam(file, CamTable.model_validate(options)))
            except InputError as fault:
                told.append(f"{reader.name}: {file.name}: refused, line {fault.where}: {fault.message}")
                continue
            row[1] += 1
            if case is not None:
                row[2] += 1
                difference = find_difference_from(case)
                row[3] += not difference
                told += [f"{reader.name}: {file.name}: read otherwise: {difference}"] if difference else []
    print(f"{'dialect':<12}{'programs':>9}{'read':>6}{'refused':>9}{'moves known':>13}{'right':>7}")
    for name, (programs, read, known, right) in sorted(counts.items()):
        print(f"{name:<12}{programs:>9}{read:>6}{programs - read:>9}{known:>13}{right:>7}")
    print(*told, sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
