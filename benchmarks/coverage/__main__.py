"""Claim beside truth on arms in motion: share of true tips in the band by speed, `keeps` that were wrong, share solved.

    python -m benchmarks coverage --out DIR [--jobs 60] [--arms 20] [--seed 0] [--limit 150] [--no-inertia]

Jobs are short, within reach, of any shipped robot (half of them graded as identified, with narrow widths), at feeds
from 6 to 350 mm/s (`benchmarks.coverage.job`). The controller is ideal: drives go through the rows of joints.csv at
their times. Runs begin at rest, since the ringing after rapid moves is not part of the band. One file a seed in DIR: a
second call goes on where the first one stopped (delete DIR after a change of the product). About 20 s of processor
time a job.
"""

from __future__ import annotations

import argparse
import json
import time
import tomllib
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.coverage.draw import draw_truth
from benchmarks.coverage.job import write_job
from benchmarks.coverage.swing import Swing
from benchmarks.coverage.table import describe_job, describe_table
from benchmarks.simulated_robot.job import ROBOTS, Rows, read_job, read_joints
from benchmarks.simulated_robot.robot import Arm, Array
from benchmarks.simulated_robot.run import run_plan

#: Rows of the cut that are looked at in every run, evenly in time.
ROWS = 200


def read_band(file: Path) -> Array:
    """Return the band at the rows of joints.csv, NaN where none is promised. Shape (n,). [m]"""
    head, *lines = file.read_text(encoding="utf-8").splitlines()
    column = head.split(",").index("error_band_mm")
    words = [line.split(",")[column] for line in lines]
    return np.array([1e-3 * float(word) if word else np.nan for word in words])


def measure_job(file: Path, folder: Path, arms: int, seed: int) -> dict:
    """Let drawn true arms run a planned program; return feed and band of some rows, and where each arm's tip is."""
    job = read_job(file)
    rows, band = read_joints(folder / "joints.csv", job.arm), read_band(folder / "deviation.csv")
    fed = ~np.isin(rows.move, ("rapid", "approach", "retract"))
    steps = np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1)
    feed = np.r_[0.0, steps / np.maximum(np.diff(rows.time), 1e-9)]
    seen = np.flatnonzero(np.isfinite(band) & fed)
    few = seen[np.unique(np.searchsorted(rows.time[seen], np.linspace(*rows.time[seen[[0, -1]]], ROWS)))]
    robot = next(p for p in (file.parent / job.table["robot"], ROBOTS / job.table["robot"]) if p.is_dir())
    away = np.array([_swing_arm(job.arm, robot, rows, fed, [seed, n, 7]) for n in range(arms)])
    return {
        "feed_mm_s": (1e3 * feed[few]).round(3).tolist(),
        "band_mm": (1e3 * band[few]).round(6).tolist(),
        "away_mm": (1e3 * away[:, few]).round(6).tolist(),
        "greatest_mm": (1e3 * away[:, seen].max(axis=1)).round(6).tolist(),
    }


def _swing_arm(arm: Arm, robot: Path, rows: Rows, fed: np.ndarray, seed: list[int]) -> Array:
    """Return how far the tip of one drawn arm is from the wanted one at the rows of the cut. Shape (n,). [m]"""
    swing = Swing(draw_truth(arm, robot, np.random.default_rng(seed)))
    edge = np.flatnonzero(np.diff(np.r_[0, fed.astype(int), 0]))
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1))]
    tip = np.full((len(rows), 3), np.nan)
    for first, last in zip(edge[::2], edge[1::2], strict=True):
        run = slice(max(first - 1, 0), last)
        tip[run] = swing.run(rows.time[run], rows.q[run], rows.wrench[run], length[run])
    return np.asarray(np.linalg.norm(tip - rows.wanted, axis=1))


def run_job(folder: Path, seed: int, arms: int, *, inertia: bool, limit_s: float) -> dict:
    """Plan one drawn job and let true arms run it."""
    file = write_job(folder / "jobs", seed, inertia=inertia)
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    outcome, clock = run_plan(file, folder / "plans" / file.stem, limit_s=limit_s, by_clock=False), time.process_time()
    plan = outcome.plan or {}
    verdict, solved = plan.get("verdict") or {}, plan.get("status") == "solved"
    found = measure_job(file, outcome.folder, arms, seed) if solved and plan.get("error_band_mm") else None
    return {
        "seed": seed, "robot": table["robot"], "tolerance_mm": table["plan"]["tolerance_mm"],
        "status": plan.get("status"), "said": outcome.said, "verdict": verdict.get("word"),
        "band_mm": verdict.get("band_mm"), "cause": verdict.get("largest_cause"), "found": found,
        "plan_s": outcome.cpu_s, "swing_s": time.process_time() - clock,
    }  # fmt: skip


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks coverage", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=60)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=150.0, help="Seconds of processor time that a plan may take.")
    parser.add_argument("--no-inertia", action="store_true")
    wish = parser.parse_args()
    wish.out.mkdir(parents=True, exist_ok=True)
    results = []
    with Progress() as progress:
        for seed in progress.track(range(wish.seed, wish.seed + wish.jobs), description="jobs"):
            file = wish.out / f"seed_{seed}.json"
            if not file.is_file():
                found = run_job(wish.out, seed, wish.arms, inertia=not wish.no_inertia, limit_s=wish.limit)
                file.write_text(json.dumps(found), encoding="utf-8")
            results.append(json.loads(file.read_text(encoding="utf-8")))
            progress.console.print(describe_job(results[-1]), highlight=False, soft_wrap=True)
    print(describe_table(results))


if __name__ == "__main__":
    main()
