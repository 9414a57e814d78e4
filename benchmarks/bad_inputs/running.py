"""Run compplan on a bad input in a process of its own, bounded in time and memory, and judge the answer."""

from __future__ import annotations

import codecs
import os
import re
import resource
import shlex
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

from benchmarks.bad_inputs.making import make_workspace
from benchmarks.bad_inputs.tables import BadInput

#: What a case may take: processor and wall time [s], and memory [bytes]; the address space bounds the machine's risk.
SECONDS, WALL, MEMORY, ADDRESSES = 60, 300, 2 * 2**30, 8 * 2**30
NOBODY = 65534
TRACEBACK, HUNG, KILLED = -1, -2, -3


@dataclass(frozen=True)
class Answer:
    """What compplan left with: exit status (or TRACEBACK, HUNG, KILLED), what it printed, what it wrote."""

    status: int
    out: str
    err: str
    seconds: float
    memory: int
    wrote: tuple[str, ...]
    results: str

    def judge(self, case: BadInput) -> str:
        """Return "" where the answer is what the case deserves, and the fault else."""
        lines = self.err.strip().splitlines()
        if self.status in (TRACEBACK, KILLED) or "Traceback" in self.err:
            return "traceback"
        if self.status == HUNG or self.seconds > SECONDS:
            return "too long"
        if self.memory > MEMORY:
            return "too much memory"
        if "internal fault" in self.err:
            return "internal fault"
        if self.status == 1:
            return "status 1"
        if self.status not in case.status:
            return "accepted" if self.status == 0 else f"status {self.status}"
        if self.status in (2, 3) and (len(lines) != 1 or not lines[0].startswith("error: ")):
            return "not one line"
        if self.status == 2 and self.wrote:
            return "left files"
        if self.status == 0 and not self.out.strip() and not self.wrote:
            return "silent"
        said = self.err if self.status in (2, 3) else self.out + self.err + self.results
        return "" if re.search(case.says, said, re.IGNORECASE) else "another line"


def load_commands() -> None:
    """Import everything once, so that each case starts from a warm copy of this process."""
    import importlib

    from compplan.cli import COMMANDS, load_command

    for name in COMMANDS:
        load_command(name)
    heavy = (
        "cli.doctor",
        "diagnosis",
        "identification.campaign",
        "learning.part",
        "planning.plan",
        "reporting.page",
        "toolpath.readers",
    )
    others = ("matplotlib.pyplot", "rich.table", "casadi", "eaik", "scipy.signal", "concurrent.futures.process")
    for module in (*(f"compplan.{name}" for name in heavy), *others, "multiprocessing.forkserver"):
        importlib.import_module(module)
    for encoding in ("utf-8-sig", "utf-16", "latin-1", "unicode-escape"):
        codecs.lookup(encoding)


def run_case(case: BadInput) -> Answer:
    """Make a bad input in a temporary folder and run its command there."""
    with tempfile.TemporaryDirectory(prefix="bad-") as name:
        work = Path(name) / "work"
        make_workspace(case, work)
        before = _list_files(work)
        started = time.monotonic()
        child = os.fork()
        if child == 0:
            _run_child(case, work, Path(name))
        status, seconds, memory = _wait(child, started)
        wrote = tuple(sorted(path for path, stamp in _list_files(work).items() if before.get(path) != stamp))
        out, err = ((Path(name) / stream).read_text(errors="replace") for stream in ("out", "err"))
        results = "".join((work / path).read_text() for path in wrote if path.endswith(".json"))
        return Answer(status, out, err, seconds, memory, wrote, results)


def _wait(child: int, started: float) -> tuple[int, float, int]:
    """Wait for a process, end it past its wall time; return status, processor time [s] and memory [bytes]."""
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            seconds = usage.ru_utime + usage.ru_stime
            code = os.waitstatus_to_exitcode(status)
            if code == -signal.SIGXCPU or code == -signal.SIGKILL:
                return HUNG, seconds, usage.ru_maxrss * 1024
            return (TRACEBACK if code == 70 else code if code >= 0 else KILLED), seconds, usage.ru_maxrss * 1024
        if time.monotonic() - started > WALL:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.005)


def _become_nobody(folder: Path) -> None:
    """Give up root, to whom every file is open: own the folder as nobody."""
    if os.geteuid() == 0:
        for path in [folder, *folder.rglob("*")]:
            os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)


def _run_child(case: BadInput, work: Path, streams: Path) -> None:
    """Run the command line in this (forked) process and leave with its status, 70 for an exception that got out."""
    status = 70
    try:
        os.setpgid(0, 0)
        os.chdir(work)
        if "mode" in case.edit:
            _become_nobody(streams)
        for number, stream in ((1, "out"), (2, "err")):
            handle = os.open(streams / stream, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, number)
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 2, SECONDS + 4))
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        if "disk" in case.edit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.edit["disk"], case.edit["disk"]))
        sys.argv = ["compplan", *shlex.split(case.command)]
        from compplan.cli import main

        main()
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(status)


def _list_files(folder: Path) -> dict[str, tuple[int, int]]:
    files = {}
    for path in folder.rglob("*"):
        stat = path.lstat()
        size = stat.st_size if path.is_file() else 0
        files[str(path.relative_to(folder))] = (size, stat.st_mtime_ns if path.is_file() else 0)
    return files
