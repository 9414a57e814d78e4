"""Mutation testing: small mistakes are planted in the code, one at a time; how many do the tests see?

    python -m benchmarks.mutation statics effects --sample 150 --seed 1 --out mutation.json

The mistakes are mutmut's (a sign, a comparison, a number, an index, a default). From each room a sample is drawn by the
seed, and for each of them only the tests run that pass through the mutated function. The share that is killed is
printed with its 95 % Wilson interval, and every survivor with its difference, to be answered by a test, or to be listed
with a reason where it changes nothing. Texts of messages are not mutated.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.answer_scores import wilson

ROOT = Path(__file__).parent.parent
DATA = ("robots", "paths", "benchmarks", "examples", "notebooks", "docs", "README.md", "CONTRIBUTING.md")
#: Lines that say something to people (a changed letter there is no mistake of physics), and `strict=True`, which guards
#: against lengths that never differ: without it nothing changes.
WORDS = [
    r"raise ", r"Error\(", r"message", r'f"', r"^\s*\"", r"^\s*'", "'''", '"""', r"note", r"announce", r"say\(",
    r"^\s*(name|measures|commands|title|label)=", r"strict=True",
]  # fmt: skip
#: What mutmut's exit codes mean for a mutant: seen by the tests, or not.
KILLED, SURVIVED, UNTESTED = {1, 3, 36, 24, -24, 152, 255, -9, -11}, {0}, {5, 33}

#: A mutant runs in a fork of a process that has run the tests already: what they keep in functools caches is forgotten,
#: or a mistake in what made it would pass unseen.
FORGET = """
import sys

def pytest_sessionstart(session):
    for module in list(sys.modules.values()):
        if "/mutants/" in (getattr(module, "__file__", None) or ""):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()
"""


@dataclass(frozen=True)
class Room:
    """A part of the product and the tests that answer for it."""

    code: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = {
    "statics": Room(
        ("statics/*",),
        (
            "chain",
            "elastic",
            "elastic_mujoco",
            "statics_outside",
            "stiffness",
            "encoders",
            "ik",
            "kinematics",
            "quality",
        ),
    ),
    "effects": Room(
        ("effects/*",),
        (
            "effects_signatures",
            "effects_offers",
            "effects_conditions",
            "uncertainty",
            "promise",
            "outside_truth",
            "conventions_by_hand",
            "registries",
            "predict",
            "diagnose_traps",
        ),
    ),
    "strategies": Room(
        ("plan/strategies/*", "plan/nlp.py", "plan/path_problem.py"),
        ("strategies", "strategies_online", "limits", "nlp", "plan", "compare", "evaluate"),
    ),
    "programs": Room(
        ("program/*",),
        (
            "golden_programs",
            "post_programs",
            "controller",
            "program_text",
            "program_events",
            "program_lines",
            "program_notes",
        ),
    ),
    "timing": Room(("plan/timing.py", "plan/feed.py"), ("timing", "timing_stops", "feed", "plan")),
    "process": Room(("path/process.py",), ("process", "plan")),
    "diagnose": Room(
        ("diagnose/*", "measure/*"),
        (
            "cholesky",
            "diagnose_engine",
            "diagnose_traps",
            "diagnose_unmodelled",
            "diagnosis_page",
            "few_rows",
            "imitation",
            "many_rows",
            "measurements",
            "next_measurement",
            "noise",
            "predict",
            "questions",
            "wave_sums",
            "where",
        ),  # test_threshold_extremes moves defaults of arguments, which mutmut hides: it fails before any mistake
    ),
}


def prepare_tree(folder: Path, room: Room) -> None:
    """Copy the checkout and tell mutmut what to mutate and which tests to run."""
    for name in ("compplan", "tests", "pyproject.toml", *DATA):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.is_file():
            shutil.copy(source, folder / name)
    (folder / "tests" / "conftest.py").write_text(FORGET)
    settings = {
        "source_paths": ["compplan"],
        "only_mutate": [f"compplan/{pattern}" for pattern in room.code],
        "do_not_mutate_patterns": WORDS,
        "also_copy": list(DATA),
        "pytest_add_cli_args": ["-q", "-x", "-p", "no:cacheprovider"],
        "pytest_add_cli_args_test_selection": [
            f"tests/test_{name}.py" for name in room.tests if (folder / f"tests/test_{name}.py").is_file()
        ],
        "use_git_change_detection": False,
        "track_dependencies": False,
    }
    text = (folder / "pyproject.toml").read_text()
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    (folder / "pyproject.toml").write_text(text + "\n[tool.mutmut]\n" + "\n".join(lines) + "\n")


def run_mutmut(folder: Path, *arguments: str, workers: int) -> str:
    """Run mutmut in the tree."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONPATH", None)
    command = [sys.executable, "-m", "mutmut", *arguments]
    if arguments[0] == "run":
        command[4:4] = ["--max-children", str(workers)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def read_results(folder: Path) -> dict[str, int | None]:
    """Read what became of every mutant: mutmut's exit code, None where it has not run."""
    found: dict[str, int | None] = {}
    for file in sorted((folder / "mutants").rglob("*.meta")):
        found |= json.loads(file.read_text())["exit_code_by_key"]
    return found


def test_room(name: str, sample: int, seed: int, workers: int) -> dict[str, object]:
    """Plant a sample of mistakes in a room and count those that the tests see."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "tree"
        folder.mkdir()
        prepare_tree(folder, ROOMS[name])
        said = run_mutmut(folder, "run", "no.such.mutant", workers=workers)
        mutants = sorted(read_results(folder))
        if not mutants:
            raise SystemExit(f"error: no mutants in {name}; mutmut said:\n{said[-3000:]}")
        drawn = random.Random(f"{seed} {name}").sample(mutants, min(sample, len(mutants)))
        said = run_mutmut(folder, "run", *drawn, workers=workers)
        results = read_results(folder)
        codes = {mutant: results.get(mutant) for mutant in drawn}
        survivors = [m for m, code in codes.items() if code in SURVIVED | UNTESTED]
        killed = sum(code in KILLED for code in codes.values())
        shown = {m: run_mutmut(folder, "show", m, workers=workers) for m in survivors}
    judged = killed + len(survivors)
    if not judged:  # tests that fail without a mistake see nothing of one
        raise SystemExit(f"error: no mutant of {name} was judged; mutmut said:\n{said[-3000:]}")
    low, high = wilson(killed, judged)
    return {
        "room": name, "mutants": len(mutants), "drawn": len(drawn), "judged": judged, "killed": killed,
        "share": killed / max(judged, 1), "interval": [low, high],
        "untested": sum(codes[m] in UNTESTED for m in survivors), "survivors": shown,
        "other": {m: code for m, code in codes.items() if code not in KILLED | SURVIVED | UNTESTED},
    }  # fmt: skip


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", nargs="+", choices=ROOMS)
    parser.add_argument("--sample", type=int, default=150, help="mutants drawn from each room (150)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="JSON with every survivor")
    options = parser.parse_args()
    found = []
    for name in options.rooms:
        row = test_room(name, options.sample, options.seed, options.workers)
        low, high = row["interval"]  # type: ignore[misc]
        print(
            f"{name}: killed {row['killed']} of {row['judged']} ({100 * row['share']:.0f} %, 95 % {100 * low:.0f}-"  # type: ignore[operator]
            f"{100 * high:.0f}), drawn from {row['mutants']}; {row['untested']} in code that no test passes through",
            flush=True,
        )
        found.append(row)
        if options.out:
            options.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
