"""Planted mistakes: which of them does a default test see?

    python -m benchmarks planted [--list FILE ..] [--only WORD] [--tests PATH ..] [--out FILE]

A list is a TOML file of [[mistake]] tables: name, area, file (in compplan/), old, new (text of that file, old replaced
once), and perhaps tests (paths below tests/ that are run before the folder of the package). Each is put into a copy of
the project, and tests run until one fails. planted.toml is by the author of the checks, planted_blind.toml by someone
who had not read them, planted_more.toml holds kinds that stand in neither,
planted_small.toml units, signs, ends and dropped terms.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
LISTS = [
    Path(__file__).with_name(f"{name}.toml") for name in ("planted", "planted_blind", "planted_more", "planted_small")
]
#: Longest time of the tests of one mistake. [s]
LONGEST = 600


def copy_project(folder: Path) -> None:
    """Copy what mistakes and tests may change, and link to the rest."""
    for name in ("compplan", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for other in ROOT.iterdir():
        if other.name not in ("compplan", "tests", ".git"):
            (folder / other.name).symlink_to(other)


def choose_tests(mistake: dict[str, Any]) -> list[list[str]]:
    """Return the paths below tests/ that are run one after the other: those of the entry, then the package's folder."""
    package = Path(mistake["file"]).parts[0]
    return [[path] for path in mistake.get("tests", [])] + [[package]] * (ROOT / "tests" / package).is_dir()


def find_test(folder: Path, paths: Sequence[str]) -> str:
    """Run tests until one fails; return its name, "" if none does."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=no"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run([*words, *(f"tests/{path}" for path in paths)], cwd=folder, env=environment,
                              capture_output=True, text=True, timeout=LONGEST, check=False)  # fmt: skip
    except subprocess.TimeoutExpired:
        return "too long"
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" - ")[0].partition(" ")[2] if failed else "" if done.returncode in (0, 5) else "collection"


def plant_mistake(folder: Path, mistake: dict[str, Any], tests: Sequence[str]) -> dict[str, Any]:
    """Put a mistake into the copy and tell which test sees it."""
    file = folder / "compplan" / mistake["file"]
    text = file.read_text(encoding="utf-8")
    if mistake["old"] not in text:
        return {**mistake, "seen": "not planted"}
    file.write_text(text.replace(mistake["old"], mistake["new"], 1), encoding="utf-8")
    try:
        runs = [list(tests)] if tests else choose_tests(mistake)
        return {**mistake, "seen": next(filter(None, (find_test(folder, paths) for paths in runs)), "")}
    finally:
        file.write_text(text, encoding="utf-8")


def main() -> int:
    """Print which test sees each mistake; 1 if one is seen by none."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", type=Path, nargs="+", default=LISTS, help="TOML files of mistakes.")
    parser.add_argument("--only", default="", help="Those whose name or area has this word.")
    parser.add_argument("--tests", nargs="+", default=[], help="Paths below tests/ instead of the package's folder.")
    parser.add_argument("--out", type=Path, help="JSON file of what came of them.")
    asked = parser.parse_args()
    mistakes = [entry for file in asked.list for entry in tomllib.loads(file.read_text(encoding="utf-8"))["mistake"]]
    found = []
    with tempfile.TemporaryDirectory() as place:
        copy_project(Path(place))
        for mistake in mistakes:
            if asked.only in f"{mistake['name']} {mistake['area']}":
                found.append(plant_mistake(Path(place), mistake, asked.tests))
                print(f"{mistake['area']:12} {mistake['name']:50} {found[-1]['seen'] or 'UNSEEN'}", flush=True)
    unseen = [row["name"] for row in found if row["seen"] in ("", "not planted")]
    print(f"{len(found)} planted: {len(found) - len(unseen)} seen")
    if asked.out is not None:
        asked.out.write_text(json.dumps(found, indent=2), encoding="utf-8")
    return int(bool(unseen))


if __name__ == "__main__":
    raise SystemExit(main())
