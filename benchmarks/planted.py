"""Planted mistakes: is a plan that rests on one called solved?

python -m benchmarks planted [--list FILE ..] [--only WORD] [--out FILE]

Without --list all three lists are planted. A list is a TOML file of [[mistake]] tables: name, area, file (in
compplan/), old, new (text of that file, old replaced once), job (one of JOBS, or of the list's own [[job]] tables:
name, path, text, job). Each is put into a copy of the package, the job is planned with it, and the status is read.
planted.toml is by the author of the votes, planted_blind.toml by someone who had not read them, planted_more.toml holds
kinds that stand in neither.

What comes of a mistake: a vote sees it (not_confirmed, infeasible), the command refuses the job (status 2), it ends in
an internal fault, the plan is solved with a path that one reader alone has read (and says so), or it is called solved.
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
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
LISTS = [Path(__file__).with_name(f"{name}.toml") for name in ("planted", "planted_blind", "planted_more")]
#: What may come of a mistake, the good first.
OUTCOMES = ("seen", "refused", "internal fault", "called solved", "not planted")
#: Longest time of a plan. [s]
LONGEST = 400
PROGRAMS = '["krl", "val3", "fanuc_ls", "rapid", "urscript", "sinumerik", "inform", "kawasaki_as", "csv"]'
PART_NC = """G21 G90 G17
G0 X0 Y0 Z20
G1 Z0 F600
X20
G3 X30 Y10 I0 J10
G2 X35 Y15 R5
G91 G1 X-10 Y5
G90 G1 Y30
G0 Z20
"""
INCH_NC = "G20 G90 G17\nG0 X0 Y0 Z1\nG1 Z0 F20\nX1\nG2 X1.5 Y-.5 I0 J-.5\nG0 Z1\n"
TILTED_CSV = """x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid
0,0,30,0.1,0.2,0.97467943,0,1
0,0,0,0.1,0.2,0.97467943,10,0
30,5,0,0.15,0.2,0.96824584,10,0
30,30,2,0.2,0.2,0.95916630,10,0
30,30,30,0.2,0.2,0.95916630,0,1
"""
JOB = """schema = 1
robot = "{robot}"
toolpath = "{path}"
[part]
position_mm = [{place}]
rotation_deg = [10.0, 5.0, 20.0]
[process]
model = "constant"
force_N = [40.0, 10.0, 90.0]
[tool]
position_mm = [200.0, 10.0, 30.0]
rotation_deg = [0.0, 80.0, 0.0]
mass_kg = 12.0
centre_of_mass_mm = [90.0, 0.0, 40.0]
[plan]
inertia = {inertia}
{plan}
[output]
any_brand = true
programs = {programs}
"""
#: Jobs: path, its text, and what the job says.
JOBS: dict[str, tuple[str, str, dict[str, str]]] = {
    "mill": ("part.nc", PART_NC, {}),
    "inch": ("part.nc", INCH_NC, {"programs": "[]"}),
    "fast": ("part.nc", PART_NC.replace("F600", "F6000"), {"programs": '["krl"]', "inertia": "true"}),
    "tilted": ("part.csv", TILTED_CSV, {"programs": '["krl"]', "plan": "rotate_about_tool_axis = false"}),
    "rail": ("part.nc", PART_NC, {"robot": "kuka_kr240_rail", "programs": '["krl", "csv"]'}),
    "fanuc": (
        "part.nc",
        PART_NC,
        {"robot": "fanuc_m20ib25", "programs": '["fanuc_ls"]', "place": "1100.0, 100.0, 500.0"},
    ),
    "small": ("part.nc", PART_NC, {"programs": "[]", "plan": "max_correction_mm = 1.0"}),
}


def write_job(folder: Path, name: str, own: dict[str, dict[str, str]]) -> Path:
    """Write a job and its path file: one of the list's own, else of JOBS."""
    folder.mkdir(parents=True, exist_ok=True)
    job = folder / f"{name}.toml"
    if name in own:
        (folder / own[name]["path"]).write_text(own[name]["text"])
        job.write_text(own[name]["job"])
        return job
    path, text, words = JOBS[name]
    (folder / path).write_text(text)
    said = {"robot": "kuka_kr240", "place": "1800.0, 100.0, 700.0", "inertia": "false", "plan": "",
            "programs": PROGRAMS, "path": path, **words}  # fmt: skip
    job.write_text(JOB.format(**said))
    return job


def plan_with(package: Path, job: Path) -> tuple[str, str]:
    """Plan a job with a package; return its status, or how the command ended, and its last word."""
    environment = {**os.environ, "PYTHONPATH": str(package.parent), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "compplan", "plan", str(job), "--out", str(job.parent / "out"), "--json"]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LONGEST, cwd=job.parent)
    except subprocess.TimeoutExpired:
        return "too long", ""
    said = (done.stderr.strip().splitlines() or [""])[-1]
    try:
        return str(json.loads(done.stdout)["status"]), said
    except (json.JSONDecodeError, KeyError):
        return f"exit {done.returncode}", said


def tell_outcome(status: str) -> str:
    """Return which of `OUTCOMES` a status is."""
    if status in ("not_confirmed", "infeasible", "exit 3"):
        return "seen"
    named = {"exit 2": "refused", "solved": "called solved", "not planted": status}
    return named.get(status, "internal fault")


def write_counts(rows: list[dict[str, Any]], by: str = "area") -> str:
    """Return a table: an area (or a list) a line, how many of its mistakes came to what."""
    lines = [f"| {by} | mistakes | " + " | ".join(OUTCOMES) + " |", "|---" * (len(OUTCOMES) + 2) + "|"]
    for kind in [*dict.fromkeys(row[by] for row in rows), "all"]:
        found = [tell_outcome(row["status"]) for row in rows if kind in (row[by], "all")]
        lines.append(f"| {kind} | {len(found)} | " + " | ".join(str(found.count(name)) for name in OUTCOMES) + " |")
    return "\n".join(lines)


def run_mistakes(mistakes: list[dict[str, Any]], own: dict[str, dict[str, str]]) -> Iterator[dict[str, Any]]:
    """Plan with every mistake; the plan without any comes first."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        shutil.copytree(ROOT / "compplan", folder / "compplan", ignore=shutil.ignore_patterns("__pycache__"))
        (folder / "robots").symlink_to(ROOT / "robots")
        for name in sorted({str(mistake["job"]) for mistake in mistakes}):
            status, said = plan_with(folder / "compplan", write_job(folder / "clean" / name, name, own))
            yield {"name": f"without a mistake, {name}", "area": "", "status": status, "said": said}
        for number, mistake in enumerate(mistakes):
            file = folder / "compplan" / mistake["file"]
            text = file.read_text(encoding="utf-8")
            if mistake["old"] not in text:
                yield {**mistake, "status": "not planted", "said": "the text is not in the file"}
                continue
            file.write_text(text.replace(mistake["old"], mistake["new"], 1), encoding="utf-8")
            try:
                status, said = plan_with(folder / "compplan", write_job(folder / str(number), mistake["job"], own))
            finally:
                file.write_text(text, encoding="utf-8")
            yield {**mistake, "status": status, "said": said}


def main() -> int:
    """Print what came of every mistake; 1 if one was called solved, or could not be planted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", type=Path, nargs="+", default=LISTS, help="TOML files of mistakes.")
    parser.add_argument("--only", default="", help="Those whose name or area has this word.")
    parser.add_argument("--out", type=Path, help="JSON file of what came of them.")
    asked = parser.parse_args()
    found = []
    for file in asked.list:
        listed = tomllib.loads(file.read_text(encoding="utf-8"))
        mistakes = [entry for entry in listed["mistake"] if asked.only in f"{entry['name']} {entry['area']}"]
        for row in run_mistakes(mistakes, {job["name"]: job for job in listed.get("job", [])}):
            found.append({**row, "list": file.stem, "outcome": tell_outcome(row["status"])})
            print(f"{row['area']:12} {row['name']:45} {row['status']:14} {row['said'][:160]}", flush=True)
    planted = [row for row in found if row["area"]]
    clean = [row for row in found if not row["area"]]
    print(f"\n{write_counts(planted)}\n")
    count = {name: sum(row["outcome"] == name for row in planted) for name in OUTCOMES}
    print(f"{len(planted)} planted: " + ", ".join(f"{number} {name}" for name, number in count.items()))
    print(f"{len(clean)} jobs without a mistake: {sum(row['status'] == 'solved' for row in clean)} solved")
    if asked.out is not None:
        asked.out.write_text(json.dumps(found, indent=2), encoding="utf-8")
    return int(count["called solved"] + count["not planted"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
