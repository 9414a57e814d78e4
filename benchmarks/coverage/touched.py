"""Claim beside truth on parts that the arm itself touched off: share of drawn arms' tips in the band, and its width.

    python -m benchmarks coverage.touched --out DIR [--arms 100] [--seed 0]

Shipped jobs in three sizes each. Geometry, compliance, masses, gears and force of an arm are drawn; at rest it touches
three corners of the part's box to 20 um, with gears at one side of their play; the part stands where these points fit
best. MuJoCo brings the arm to rest at rows of joints.csv. One file a job in DIR; those that are there are kept.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from benchmarks.coverage.__main__ import read_band
from benchmarks.coverage.draw import Truth, draw_truth
from benchmarks.simulated_robot.cell import Kinematics, SimulatedRobot
from benchmarks.simulated_robot.job import ROBOTS, Rows, read_job, read_joints
from benchmarks.simulated_robot.robot import Array
from benchmarks.simulated_robot.run import ROOT, run_plan

JOBS = ("circle_10mm", "circle_500mm", "isf_cone", "spiral")
#: Sizes of the part beside the shipped one.
SIZES = (0.4, 0.7, 1.0)
#: Lengths of a toolpath table, which grow with the part.
LENGTHS = ("radius_mm", "diameter_mm", "depth_mm", "outer_radius_mm", "length_mm")
#: Standard deviation of a touched coordinate [m], and a rate that puts gears at one side of their play. [rad/s]
TOUCH, APPROACH = 2e-5, 0.1
#: Rows of the cut that are looked at, evenly.
ROWS = 60


def write_job(folder: Path, name: str, size: float) -> Path:
    """Write a shipped job with a part of another size, touched off."""
    table = tomllib.loads((ROOT / "paths" / f"{name}.toml").read_text(encoding="utf-8"))
    for key in LENGTHS & table["toolpath"].keys():
        table["toolpath"][key] *= size
    table["part"]["touched_off"] = True
    table["output"] = {"programs": []}
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}_{size:g}.toml"
    file.write_text(tomli_w.dumps(table), encoding="utf-8")
    return file


def pick_corners(points: Array) -> Array:
    """Return the corner of least x and y and greatest z, and those along the two longest sides. Shape (3, 3). [m]"""
    low, high = points.min(axis=0), points.max(axis=0)
    corners = np.tile([low[0], low[1], high[2]], (3, 1))
    for row, axis in enumerate(np.argsort(low - high, kind="stable")[:2], start=1):
        corners[row, axis] = low[axis] if axis == 2 else high[axis]
    return corners


def fit_motion(shown: Array, found: Array) -> tuple[Array, Array]:
    """Return the rotation and the shift of the rigid motion that brings points where they were found. [m]"""
    middle = shown.mean(axis=0), found.mean(axis=0)
    turn = Rotation.align_vectors(found - middle[1], shown - middle[0])[0].as_matrix()
    return turn, middle[1] - turn @ middle[0]


def measure_job(file: Path, folder: Path, arms: int, seed: int) -> dict:
    """Let drawn arms touch the part and run the program; return band, and how far each arm's tip is off. [mm]"""
    job = read_job(file)
    rows, band = read_joints(folder / "joints.csv", job.arm), read_band(folder / "deviation.csv")
    cut = np.flatnonzero(np.isfinite(band) & (rows.move == "cut"))
    kinematics = Kinematics(job.arm)
    corners = pick_corners(rows.wanted[cut])
    near = cut[np.linalg.norm(rows.wanted[cut] - corners[:, None], axis=2).argmin(axis=1)]
    poses = kinematics.tip(rows.q[near])
    poses[:, :3, 3] = corners
    touching, left = kinematics.reach(rows.q[near], poses)
    if left.max() > 1e-6:
        raise ValueError(f"{file.stem}: a corner of the part is out of reach")
    few = cut[np.unique(np.linspace(0, len(cut) - 1, ROWS).astype(int))]
    away = []
    for arm in range(arms):
        rng = np.random.default_rng([seed, arm, *file.stem.encode()])  # arms of its own for every job
        away.append(_cut_part(draw_truth(job.arm, ROBOTS / job.table["robot"], rng), rows, few, corners, touching, rng))
    return {
        "job": file.stem, "box_mm": (1e3 * np.ptp(rows.wanted[cut], axis=0)).round(1).tolist(),
        "band_mm": (1e3 * band[few]).tolist(), "away_mm": (1e3 * np.array(away)).tolist(),
    }  # fmt: skip


def _cut_part(truth: Truth, rows: Rows, few: Array, corners: Array, touching: Array, rng: np.random.Generator) -> Array:
    """Return how far the tip of an arm is from the path on the part that it touched. Shape (n,). [m]"""
    cell = SimulatedRobot(truth.arm)
    side = APPROACH * rng.choice([-1.0, 1.0], touching.shape[1])
    found = cell.rest(truth.joints(touching, side), np.zeros((len(touching), 6))).position
    found = found + truth.shift(found) - truth.place + TOUCH * rng.standard_normal(found.shape)
    turn, shift = fit_motion(corners, found)
    rate = np.gradient(rows.q, axis=0) / np.maximum(np.gradient(rows.time), 1e-9)[:, None]
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1))]
    tip = cell.rest(truth.joints(rows.q, rate)[few], truth.force(rows.wrench, length)[few]).position
    tip = tip + truth.shift(tip)
    return np.asarray(np.linalg.norm((tip - shift) @ turn - rows.wanted[few], axis=1))


def list_jobs(found: list[dict]) -> list[tuple[str, str, str, str, str]]:
    """Return name and scale, widest band and true 95 % point [mm], share held [%] and median ratio of each job."""
    rows = []
    for one in found:
        band, away = np.array(one["band_mm"]), np.array(one["away_mm"])
        point = np.quantile(away, 0.95, axis=0)
        rows.append((one["job"], f"{band.max():.3f}", f"{point.max():.3f}", f"{100 * np.mean(away <= band):.1f}",
                     f"{np.median(band / point):.2f}"))  # fmt: skip
    return rows


def main() -> None:
    """Print a line a job."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks coverage.touched", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    words = parser.parse_args()
    for name in JOBS:
        for size in SIZES:
            job = write_job(words.out, name, size)
            file = job.with_suffix(".json")
            if not file.is_file():
                outcome = run_plan(job, words.out / "plans" / job.stem)
                if outcome.plan is None:
                    print(f"{job.stem}: {outcome.said}", flush=True)
                    continue
                file.write_text(json.dumps(measure_job(job, outcome.folder, words.arms, words.seed)), encoding="utf-8")
            print("  ".join(list_jobs([json.loads(file.read_text(encoding="utf-8"))])[0]), flush=True)


if __name__ == "__main__":
    main()
