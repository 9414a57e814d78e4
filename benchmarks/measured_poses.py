"""Designed poses beside random ones on a measured campaign: what is left of paths that nobody measured.

    python -m benchmarks.measured_poses DIR --draws 20 --out OUT       DIR holds robot/ and measurements.csv

Every eighth stretch of the campaign is kept. A path is a kept pose and the kept poses nearest to it in joint space; for
each path `compplan campaign`'s criterion picks twelve poses of the others, by the nominal folder's assumed widths, base
and tool unknown. The product diagnoses these, and random ones. The error is the rms distance of the path's measured
poses from what the delivered folder predicts, base and tool registered to all kept poses, alike for everybody.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_campaign import BLOCK, KEPT
from compplan.cell.predict import predict_campaign
from compplan.effects import attain_scene
from compplan.known.assumed import UNEXPLAINED, known_uncertainty
from compplan.known.slopes import measure_slopes, take_rows
from compplan.known.vary import stage_robot
from compplan.loop.candidates import Candidates
from compplan.loop.design import Design, choose_measurements
from compplan.measure.campaign import Campaign
from compplan.measure.reading import read_campaign
from compplan.promise.band import Slopes
from compplan.robot import Array, Robot, load_robot

FRAMES = ("base", "tool")
#: Poses of a path, of a design, of a random campaign, and of the pool that the design picks from.
PATH, FEW, MANY, POOL = 40, 12, 50, 1000
#: Standard deviation of the instrument per axis (median of the campaign's other series). [m]
SIGMA = 1e-5
Rows = NDArray[np.int_]


def split_rows(n: int) -> tuple[Rows, Rows]:
    """Return the rows that may be measured and those that are kept."""
    block = np.arange(n) // BLOCK
    kept = block % KEPT == KEPT // 2
    return np.flatnonzero(~kept), np.flatnonzero(kept)


def choose_paths(campaign: Campaign, kept: Rows, count: int, random: np.random.Generator) -> list[Rows]:
    """Choose paths: a kept pose each, and those nearest to it in joint space."""
    found = []
    for start in random.choice(kept, count, replace=False):
        apart = np.linalg.norm(campaign.q[kept] - campaign.q[start], axis=1)
        found.append(kept[np.argsort(apart)[:PATH]])
    return found


def stage_rows(robot: Robot, campaign: Campaign, rows: Rows) -> Candidates:
    """Differentiate what would be measured at some rows of the campaign by what is unknown."""
    scene = stage_robot(robot, campaign)
    attained = attain_scene(take_rows(scene, rows))
    slopes = measure_slopes(scene, known_uncertainty(robot).unknowns, rows)
    m, nothing = len(rows), np.zeros((len(rows), 3))
    return Candidates(
        campaign.q[rows], np.ones(m, int), campaign.wrench[rows], np.zeros(m), nothing, attained.position,
        attained.rotation, slopes,
    )  # fmt: skip


def design_rows(robot: Robot, pool: Candidates, path: Candidates, count: int, unexplained: float) -> Rows:
    """Pick the measurements of a pool that make the promise on a path smallest; return their numbers in the pool."""
    known = replace(known_uncertainty(robot), unexplained=unexplained)
    none = np.zeros((len(path), 3, 4))
    slopes = Slopes(np.arange(len(path)), path.tip, path.slopes, none, none[:, :, :1])
    design = Design(known, slopes, SIGMA, FRAMES)
    return np.asarray(choose_measurements(design, pool, count).rows)


def diagnose_rows(source: Path, lines: list[dict[str, str]], rows: Rows, out: Path) -> Robot:
    """Let the product diagnose some rows of the campaign, unless it has; return the delivered robot."""
    if (out / "d" / "robot").is_dir():
        return load_robot(out / "d" / "robot")
    out.mkdir(parents=True, exist_ok=True)
    with (out / "log.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(lines[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows([lines[k] for k in np.sort(rows)])
    words = ["diagnose", out / "log.csv", "--robot", source / "robot", "--register", ",".join(FRAMES), "--assume-ok"]
    line = [sys.executable, "-m", "compplan", *map(str, words), "--out", str(out / "d")]
    subprocess.run(line, capture_output=True, check=True)
    return load_robot(out / "d" / "robot")


def miss_rows(robot: Robot, kept: Campaign) -> Array:
    """Return the distance of every kept pose from what a robot predicts, frames registered to them. Shape (n,). [m]"""
    predicted = predict_campaign(robot, kept, register=FRAMES).position
    return np.asarray(np.linalg.norm(kept.position - predicted, axis=1))


def rms(values: Array) -> float:
    """Return the root mean square in millimetres."""
    return 1e3 * float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print one line a path: nominal, designed, random."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--draws", type=int, default=20, help="random campaigns of fifty; half as many of twelve")
    parser.add_argument("--paths", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--unexplained-mm", type=float, default=1e3 * UNEXPLAINED, help="what the design takes for it")
    parser.add_argument("--out", type=Path, required=True)
    words = parser.parse_args()
    robot = load_robot(words.source / "robot")
    campaign = read_campaign(words.source / "measurements.csv", robot)
    with (words.source / "measurements.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    random = np.random.default_rng(words.seed)
    given, kept = split_rows(len(campaign))
    later = campaign.take(kept)
    pool = np.sort(random.choice(given, min(POOL, len(given)), replace=False))
    offered = stage_rows(robot, campaign, pool)
    paths = choose_paths(campaign, kept, words.paths, random)
    at = [np.searchsorted(kept, path) for path in paths]
    errors: dict[str, list[Array]] = {}
    for name, count, draws in (("few", FEW, words.draws // 2), ("many", MANY, words.draws)):
        for draw in range(draws):
            rows = random.choice(pool, count, replace=False)
            found = diagnose_rows(words.source, lines, rows, words.out / f"{name}_{draw:02d}")
            errors.setdefault(name, []).append(miss_rows(found, later))
    nominal, table = miss_rows(robot, later), []
    print(f"rms mm on the path:  nominal   {FEW} designed   {FEW} random (median)   {MANY} random (median)   ratio")
    for number, path in enumerate(paths):
        rows = pool[design_rows(robot, offered, stage_rows(robot, campaign, path), FEW, words.unexplained_mm * 1e-3)]
        folder = words.out / f"design_{number}_{words.unexplained_mm:g}"
        designed = miss_rows(diagnose_rows(words.source, lines, rows, folder), later)
        few, many = (float(np.median([rms(e[at[number]]) for e in errors[name]])) for name in ("few", "many"))
        line = (rms(nominal[at[number]]), rms(designed[at[number]]), few, many)
        table.append(line)
        print(f"path {number} {line[0]:>20.3f}{line[1]:>14.3f}{few:>16.3f}{many:>20.3f}{line[1] / many:>12.2f}")
    (words.out / "table.json").write_text(json.dumps(table), encoding="utf-8")
    print(f"median ratio to {MANY} random: {np.median([line[1] / line[3] for line in table]):.2f}")


if __name__ == "__main__":
    main()
