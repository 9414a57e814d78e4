"""Call `compplan plan` as a user does, or with a mistake planted in the planner, and gather what it says."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMMAND = "from compplan.cli import main; main()"


@dataclass(frozen=True)
class Outcome:
    """What a run of the command left: exit status (None: out of time), stderr's last line and lines, CPU time, plan."""

    status: int | None
    said: str
    cpu_s: float
    plan: dict | None
    folder: Path
    lines: int = 1


def run_plan(job: Path, folder: Path, *, mistake: str = "", limit_s: float = 900.0, by_clock: bool = True) -> Outcome:
    """Plan a job into a folder, within so many seconds by the clock, or else of processor time."""
    path = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH", ""), str(ROOT)]))
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-c", mistake + "\n" + COMMAND, "plan", str(job.resolve()), "--out", str(folder.resolve())]
    folder.parent.mkdir(parents=True, exist_ok=True)
    before, clock = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    try:
        done = subprocess.run(
            words, cwd=folder.parent, env=environment, capture_output=True, text=True, check=False,
            timeout=limit_s if by_clock else None, preexec_fn=None if by_clock else partial(_limit_processor, limit_s),
        )  # fmt: skip
        status, lines = done.returncode, done.stderr.strip().splitlines()
        if status < 0:
            status, lines = None, [f"no answer after {limit_s:.0f} s of processor time"]
    except subprocess.TimeoutExpired:
        status, lines = None, [f"no answer after {limit_s:.0f} s"]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    file = folder / "plan.json"
    plan = json.loads(file.read_text(encoding="utf-8")) if file.is_file() and status in (0, 3) else None
    said = lines[-1] if lines else ""
    return Outcome(status, said, cpu if status is not None else time.monotonic() - clock, plan, folder, len(lines))


def _limit_processor(seconds: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
