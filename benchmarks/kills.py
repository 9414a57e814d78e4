"""Kill commands at random moments: `python -m benchmarks.kills [--kills 200] [--seed 1] [--only TEXT] [--out FILE]`.

Every command first writes its result for one input, then runs on another input into the same folder and is killed
(SIGKILL) at a random moment, of the whole run and of its end in turn. The folder must then hold the first result or
the second one, whole, beside the user's own file; no process may live on; finished chunks of a study stay. Where the
dead run left anything behind, and after every fifth kill in any case, the command runs once more: it must succeed, and
no hidden file may be left.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import json
import os
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.bad_inputs.making import set_key
from benchmarks.bad_inputs.running import load_commands
from benchmarks.bad_inputs.tables import GOOD
from compplan.cli import main as run_command

#: Command lines: the first makes the old result, the second is killed. {out} is a folder, or a file for some.
LINES = {
    "plan": ("plan job.toml --out out", "plan other.toml --out out"),
    "compare": ("compare job.toml --out out", "compare other.toml --out out"),
    "montecarlo": ("montecarlo job.toml {mc} --workers 1", "montecarlo job.toml {mc} --workers 1"),
    "montecarlo, 2 workers": ("montecarlo job.toml {mc} --workers 2", "montecarlo job.toml {mc} --workers 2"),
    "map": ("map robot --points 5 --out out", "map robot --points 5 --height-mm 700 --out out"),
    "identify": ("identify log.csv --robot robot --out out", "identify other.csv --robot robot --out out"),
    "diagnose": ("diagnose log.csv --robot robot --out out", "diagnose other.csv --robot robot --out out"),
    "predict": ("predict log.csv --robot robot --out out/p.csv", "predict other.csv --robot robot --out out/p.csv"),
    "convert": ("convert part.gcode --out out/p.csv", "convert part.apt --out out/p.csv"),
    "place": ("place job.toml --out out", "place other.toml --out out"),
    "campaign": ("campaign job.toml --poses 3 --out out", "campaign other.toml --poses 2 --out out"),
    "learn": (
        "learn job.toml measured.csv --robot robot --out out", "learn other.toml measured.csv --robot robot --out out",
    ),
    "forces": ("forces mill.toml --out out", "forces mill.toml --log cutting.csv --out out"),
    "post": ("post part.gcode {post} --program krl", "post part.gcode {post} --program sinumerik --program csv"),
    "reproduce": ("reproduce dumas2011 --out out", "reproduce klimchik2018 --out out"),
    "init": ("", "init out/job.toml"),
    "init robot": ("", "init robot robot/robot.urdf --out out/arm"),
    "init log": ("", "init log --robot robot --out out/log.csv"),
}  # fmt: skip
MC = "--samples 512 --replicates 4 --strategies none,mirror --no-sensitivity --out out"
POST = "--robot robot --part 1600,0,900 --out out"
#: When a command is killed, in shares of the time that it takes: at any moment, or while it writes.
ANY, WRITING = (0.0, 1.1), (0.85, 1.05)
OWN = "my_notes.txt"
STDERR = "stderr.txt"
#: Jobs that are killed are small, so that many are: their keys, lines of the CAM file, waypoints and rows of the log.
LIGHT = {
    "plan.rotate_about_tool_axis": "false", "place.x_mm": "[1650.0, 1750.0]", "place.y_mm": "[0.0, 0.0]",
    "place.z_mm": "[900.0, 900.0]",
}  # fmt: skip
CUT, WAYPOINTS, ROWS = "G21 G90 G17 G94\nG0 X0 Y0 Z5\nG1 Z-1 F300\nG1 X10 Y0 F600\nG0 Z5\nM30\n", 8, 16


@dataclass
class Setup:
    """One command in its workspace: seconds of its second run, old result, files of the new one, those in both."""

    name: str
    work: Path
    seconds: float
    old: dict[str, str]
    new: set[str]
    alike: set[str]


def main() -> None:
    """Kill, look, count; leave with 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    rng, faults, outcomes, done = random.Random(given.seed), collections.Counter(), collections.Counter(), []
    names = [name for name in LINES if given.only in name]
    load_commands()
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        setups = [prepare(name, Path(folder)) for name in names]
        for number in range(given.kills):
            setup = setups[number % len(setups)]
            moment = rng.uniform(*(ANY if number // len(setups) % 2 else WRITING)) * setup.seconds
            found, state = kill_once(setup, moment, Path(folder) / "trial", again=number % 5 == 0)
            faults.update(found)
            outcomes[state] += 1
            done.append({"command": setup.name, "at_s": round(moment, 3), "state": state, "faults": found})
            if found:
                print(f"{setup.name}: killed after {moment:.2f} s: {'; '.join(found)}", flush=True)
            if (number + 1) % len(setups) == 0:
                print(f"after {number + 1} kills: {sum(faults.values())} faults, {dict(outcomes)}", flush=True)
    print(f"{given.kills} kills over {len(names)} commands: " + ", ".join(f"{n} {s}" for s, n in outcomes.items()))
    print(f"{sum(bool(entry['faults']) for entry in done)} kills with a fault: {dict(faults)}")
    if given.out:
        given.out.write_text(json.dumps(done, indent=1))
    sys.exit(int(bool(faults)))


def prepare(name: str, folder: Path) -> Setup:
    """Make the workspace of a command: inputs, the user's own file, the old result; time the second run."""
    work = folder / name.replace(" ", "_")
    make_inputs(work)
    (work / "out").mkdir()
    (work / "out" / OWN).write_text("keep me\n")
    first, second = LINES[name]
    if first and (said := run(first, work)):
        raise RuntimeError(f"{first}: {said}")
    old = read_folder(work / "out")
    again = work.with_name(work.name + "_again")
    shutil.copytree(work, again)
    drop_samples(name, again)
    started = time.monotonic()
    process = start(second, again)
    if status := os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]):
        raise RuntimeError(f"{second}: status {status}")
    seconds, new = time.monotonic() - started, read_folder(again / "out")
    return Setup(name, work, seconds, old, set(new), {file for file in new if old.get(file) == new[file]})


def make_inputs(work: Path) -> None:
    """Copy the good workspace, make its job and log small, and put another job and log beside them."""
    shutil.copytree(GOOD, work)
    job = (work / "job.toml").read_text()
    for key, raw in LIGHT.items():
        job = set_key(job, key, raw)
    (work / "job.toml").write_text(job)
    other = set_key(set_key(job, "name", '"other line"'), "part.position_mm", "[1690.0, 0.0, 900.0]")
    (work / "other.toml").write_text(other.replace("krl", "sinumerik"))
    (work / "part.gcode").write_text(CUT)
    for source, file, rows in (("path.csv", "path.csv", WAYPOINTS), ("log.csv", "log.csv", ROWS),
                               ("log.csv", "other.csv", ROWS - 2)):  # fmt: skip
        (work / file).write_text("\n".join((work / source).read_text().splitlines()[: rows + 1]) + "\n")


def kill_once(setup: Setup, moment: float, trial: Path, *, again: bool) -> tuple[list[str], str]:
    """Run the second line on a copy of the workspace, kill it, and list what is wrong; say what the folder holds."""
    shutil.rmtree(trial, ignore_errors=True)
    shutil.copytree(setup.work, trial)
    drop_samples(setup.name, trial)
    process = start(LINES[setup.name][1], trial)
    time.sleep(moment)
    chunks = list_chunks(trial)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    found = ["a process lives on"] if outlives(process) else []
    state, wrong = judge_folder(setup, trial / "out")
    found += wrong
    if lost := chunks - list_chunks(trial):
        found.append(f"{len(lost)} finished chunks lost")
    if setup.name.startswith("init") and state == "new":
        return found, state  # init replaces nothing
    if not (again or list_hidden(trial)):
        return found, state
    if said := run(LINES[setup.name][1], trial):
        found.append(f"the next run fails: {said}")
    elif judge_folder(setup, trial / "out")[0] != "new" and set(setup.old) != setup.new:
        found.append("the next run does not complete the result")
    if hidden := list_hidden(trial):
        found.append(f"hidden files stay: {hidden[:3]}")
    return found, state


def list_hidden(trial: Path) -> list[str]:
    """List what a run leaves behind while it is not done."""
    return sorted(str(p.relative_to(trial)) for p in trial.rglob(".*") if p.is_dir() or p.suffix == ".part")


def list_chunks(trial: Path) -> set[str]:
    """List the finished chunks of a study."""
    return {path.name for path in (trial / "out" / "samples").glob("*") if path.name[0] != "."}


def judge_folder(setup: Setup, out: Path) -> tuple[str, list[str]]:
    """Say whether a folder holds the old result, the new one, or a mixture."""
    now, wrong = read_folder(out), []
    if not (out / OWN).is_file():
        wrong.append("the user's own file is gone")
    for path in out.rglob("*.json"):
        if "samples" not in path.parts:
            try:
                json.loads(path.read_text(), parse_constant=lambda word: 1 / 0)
            except (ValueError, ZeroDivisionError):
                wrong.append(f"{path.name} is half written")
    if now == setup.old:
        return "old", wrong
    changed = {name for name, digest in now.items() if setup.old.get(name) != digest}
    stays = set(now) - changed
    if set(now) == setup.new and stays <= setup.alike:
        return "new", wrong
    detail = f"new {sorted(changed)[:3]}, old {sorted(stays)[:3]}, gone {sorted(set(setup.old) - set(now))[:3]}"
    return "a mixture", [*wrong, f"a mixture: {detail}"]


def read_folder(folder: Path) -> dict[str, str]:
    """Return the digest of every file of a result: the user's own, the chunks and hidden files aside."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    kept = [p.relative_to(folder) for p in files]
    kept = [p for p in kept if p.name not in (OWN, "manifest.json") and "samples" not in p.parts]
    kept = [p for p in kept if not p.parts[0].startswith(".")]
    return {str(p): hashlib.sha256((folder / p).read_bytes()).hexdigest() for p in kept}


def drop_samples(name: str, work: Path) -> None:
    """Take the finished chunks away, so that the second run of a study has something to compute."""
    if name.startswith("montecarlo"):
        shutil.rmtree(work / "out" / "samples", ignore_errors=True)


def outlives(session: int) -> bool:
    """Tell whether a process of the killed command's session is there after five seconds."""
    for _ in range(50):
        if not any(read_session(path) == session for path in Path("/proc").glob("[0-9]*/stat")):
            return False
        time.sleep(0.1)
    return True


def read_session(path: Path) -> int:
    """Return the session of a process, 0 if it is gone."""
    try:
        return int(path.read_text().rpartition(")")[2].split()[3])
    except OSError:
        return 0


def start(line: str, work: Path) -> int:
    """Start a command line in a workspace, from a warm copy of this process; return its number and its session's."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setsid()
            os.chdir(work)
            nowhere = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1):
                os.dup2(nowhere, number)
            os.dup2(os.open(STDERR, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
            run_command(shlex.split(line.format(mc=MC, post=POST)))
        except SystemExit as leaving:
            status = int(leaving.code or 0)
        finally:
            sys.stderr.flush()
            os._exit(status)
    return child


def run(line: str, work: Path) -> str:
    """Run a command line in a workspace to its end; return "" or what it fails with."""
    status = os.waitstatus_to_exitcode(os.waitpid(start(line, work), 0)[1])
    return f"status {status} {(work / STDERR).read_text().strip()[-200:]}" if status else ""


if __name__ == "__main__":
    main()
