"""Claim beside truth on arms in motion: share of true tips in the band by speed, `keeps` that were wrong, share solved.

    python -m benchmarks.moving --out DIR [--jobs 60] [--arms 4] [--seed 0] [--minutes 15] [--no-inertia]

Jobs are those of `benchmarks.plan_check --drawn` with a tolerance drawn about their band, so that every word is said.
The controller is ideal: drives go through the rows of joints.csv at their times. Runs begin at rest, since the ringing
after rapid moves is no part of the band. Writes DIR/moving.json; stops after so many minutes of processor time.
"""

from __future__ import annotations

import argparse
import json
import time
import tomllib
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.moving.draw import draw_truth
from benchmarks.moving.swing import LONGEST, Swing
from benchmarks.plan_check.drawn import write_drawn
from benchmarks.plan_check.job import ROBOTS, read_job, read_joints
from benchmarks.plan_check.run import run_plan

#: Rows of the cut that are looked at in every run.
ROWS = 300


def read_band(file: Path) -> np.ndarray:
    """Return the band at the rows of joints.csv, NaN where none is promised. Shape (n,). [m]"""
    head, *lines = file.read_text(encoding="utf-8").splitlines()
    column = head.split(",").index("promise_mm")
    words = [line.split(",")[column] for line in lines]
    return np.array([1e-3 * float(word) if word else np.nan for word in words])


def draw_job(folder: Path, seed: int, *, inertia: bool) -> Path:
    """Write a drawn job with a feed that moves the arm and a tolerance between a narrow and a wide one."""
    file = write_drawn(folder, seed)
    rng = np.random.default_rng([seed, 26])
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    table["plan"] = {"tolerance_mm": round(float(10 ** rng.uniform(-0.7, 0.7)), 3), "inertia": inertia}
    table["feed"] = {"constant_mm_s": round(float(10 ** rng.uniform(0.8, 2.3)), 2)}
    file.write_text(tomli_w.dumps(table), encoding="utf-8")
    return file


def swing_job(file: Path, folder: Path, arms: int, seed: int) -> list[dict]:
    """Let drawn true arms run a planned program; return feed, distance and band of rows of the cut, arm by arm."""
    job = read_job(file)
    rows, band = read_joints(folder / "joints.csv", job.arm), read_band(folder / "deviation.csv")
    rapid = np.isin(rows.move, ("rapid", "approach", "retract")) if rows.move is not None else np.isnan(band)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1))]
    fed = ~rapid
    edge = np.flatnonzero(np.diff(np.r_[0, fed.astype(int), 0]))
    runs = [(max(a - 1, 0), b) for a, b in zip(edge[::2], edge[1::2], strict=True)]
    step = np.maximum(np.diff(rows.time), 1e-9)
    feed = np.r_[0.0, np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1) / step]
    found = []
    for number in range(arms):
        rng = np.random.default_rng([seed, number, 7])
        swing = Swing(draw_truth(job.arm, ROBOTS / job.table["robot"], rng))
        tip, spent = np.full((len(rows.time), 3), np.nan), 0.0
        for first, last in runs:
            if spent > LONGEST:
                break
            run = slice(first, last)
            tip[run] = swing.run(rows.time[run], rows.q[run], rows.wrench[run], length[run])
            spent += rows.time[last - 1] - rows.time[first]
        away = np.linalg.norm(tip - rows.wanted, axis=1)
        seen = np.flatnonzero(np.isfinite(away) & np.isfinite(band) & fed)
        few = seen[np.unique(np.linspace(0, len(seen) - 1, ROWS).astype(int))]
        found.append({
            "greatest_mm": 1e3 * float(away[seen].max()),
            "feed_mm_s": (1e3 * feed[few]).round(3).tolist(),
            "away_mm": (1e3 * away[few]).round(6).tolist(),
            "band_mm": (1e3 * band[few]).round(6).tolist(),
        })  # fmt: skip
    return found


def tell(results: list[dict]) -> None:
    """Print the coverage by thirds of speed, the verdicts and the share of jobs solved."""
    solved = [one for one in results if one["status"] == "solved"]
    names = ("feed_mm_s", "away_mm", "band_mm")
    rows = [[np.array(arm[name]) for name in names] for one in solved for arm in one["arms"]]
    print(f"jobs {len(results)}, solved {len(solved)} ({100 * len(solved) / max(len(results), 1):.0f} %)")
    if rows:
        feed, away, band = (np.concatenate([row[k] for row in rows]) for k in range(3))
        edges = np.quantile(feed, [0.0, 1 / 3, 2 / 3, 1.0])
        for k, name in enumerate(("slow", "middle", "fast")):
            mine = (feed >= edges[k]) & (feed <= edges[k + 1])
            held, size = 100 * np.mean(away[mine] <= band[mine]), np.sqrt(np.mean((away[mine] / band[mine]) ** 2))
            print(f"{name:<7}{edges[k]:7.1f} to {edges[k + 1]:6.1f} mm/s   held {held:5.1f} % tip / band {size:.2f}")
    for word in ("keeps", "may_not_keep", "not_known"):
        own = [one for one in results if one["verdict"] == word and one["arms"]]
        arms = [a["greatest_mm"] > one["tolerance_mm"] for one in own for a in one["arms"]]
        if arms:
            print(f"{word:<14}{len(own):3} jobs, {len(arms)} arms, beyond the tolerance {100 * np.mean(arms):.1f} %")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.moving", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=60)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--no-inertia", action="store_true")
    wish = parser.parse_args()
    results, spent = [], 0.0
    for seed in range(wish.seed, wish.seed + wish.jobs):
        file = draw_job(wish.out / "jobs", seed, inertia=not wish.no_inertia)
        outcome = run_plan(file, wish.out / "plans" / file.stem, limit_s=300.0)
        plan, clock = outcome.plan or {}, time.process_time()
        arms = []
        if plan.get("status") == "solved":
            arms = swing_job(file, outcome.folder, wish.arms, seed)
        spent += outcome.cpu_s + time.process_time() - clock
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        results.append({
            "seed": seed, "robot": table["robot"], "status": plan.get("status"), "said": outcome.said,
            "verdict": (plan.get("verdict") or {}).get("word"), "tolerance_mm": table["plan"]["tolerance_mm"],
            "band_mm": (plan.get("verdict") or {}).get("band_mm"), "cpu_s": outcome.cpu_s, "arms": arms,
        })  # fmt: skip
        held = [np.mean(np.array(a["away_mm"]) <= np.array(a["band_mm"])) for a in arms]
        print(f"{seed:4} {table['robot']:<22}{results[-1]['status']!s:<14}{results[-1]['verdict']!s:<14}"
              f"tolerance {table['plan']['tolerance_mm']:7.3f}  held"
              f" {100 * np.mean(held) if held else float('nan'):5.1f} %  {spent:6.0f} s", flush=True)  # fmt: skip
        (wish.out / "moving.json").write_text(json.dumps(results), encoding="utf-8")
        if spent > 60.0 * wish.minutes:
            break
    tell(results)


if __name__ == "__main__":
    main()
