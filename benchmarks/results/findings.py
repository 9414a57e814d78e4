"""What a page shows, and how a benchmark is run for it."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Settings:
    """Where a page may work."""

    work: Path  #: Folder for what the benchmarks leave.
    real: Path | None = None  #: Folder of measured campaigns that are not part of the project, or None.
    figaroh: Path | None = None  #: Interpreter that has FIGAROH, or None.
    shops: int | None = None  #: How many simulated shops, or None: as many as a page takes.


@dataclass(frozen=True)
class Findings:
    """What was found."""

    short: tuple[str, ...]  #: Sentences that README and manual may quote.
    tables: tuple[str, ...]  #: Markdown, one block each.
    losses: tuple[str, ...]  #: Where the product is worse than a rival, than an aim or than before.
    data: str = ""  #: Table in markdown of every case, for the chart and NAME.csv; "": the chart shows the first table.


class MissingError(Exception):
    """What a page needs is not there; the old page stays."""


def run_benchmark(*words: object, faults: Sequence[int] = (0, 1)) -> str:
    """Run `python -m benchmarks.WORDS` and return what it prints."""
    line = [sys.executable, "-m", *map(str, words)]
    done = subprocess.run(line, cwd=ROOT, env=_environment(), capture_output=True, text=True, check=False)
    if done.returncode not in faults:
        raise RuntimeError(f"{' '.join(line)}: status {done.returncode}: {done.stderr.strip()[-2000:]}")
    return done.stdout


def time_command(*words: object) -> tuple[float, float]:
    """Run `compplan WORDS`; return CPU time, user and system [s], and peak memory [GB] of the whole command."""
    line = [sys.executable, "-m", "compplan", *map(str, words)]
    child = subprocess.Popen(line, cwd=ROOT, env=_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        raise RuntimeError(f"{' '.join(line)}: status {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, _gigabytes(used)


def _gigabytes(used: resource.struct_rusage) -> float:
    return used.ru_maxrss / 2**20


def _environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}  # as users have it
    return {**kept, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def draw_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return "\n".join(lines)
