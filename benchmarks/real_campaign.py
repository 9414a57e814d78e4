"""A real campaign cut into parts: whole, mirrored, halves and thinned, one stretch of poses kept for the check.

    python -m benchmarks.diagnosis_report --real DIR --out OUT      everybody's answers to the parts, on one page

Every eighth block of BLOCK consecutive rows is never given to anybody; it is the later campaign of each part.
Mirrored: every deviation from the registered nominal robot is negated, the common mistake of sign.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.contestants import write_whole
from benchmarks.rival.chain import load_chain, read_chain
from benchmarks.rival.greedy import fit_frames
from benchmarks.rival.log import read_log

BLOCK, KEPT = 50, 8
THINNED = (15, 25, 50, 100, 200)
#: The mirrored campaign has as many poses as the one that the mistake was first seen on.
MIRRORED, SEED = 500, 20261122
Rows = list[dict[str, str]]


def cut_campaign(source: Path, suite: Path) -> list[str]:
    """Write the parts of a real campaign as cases of a suite; those that are there already stay.

    Args:
        source: Folder with robot/ and measurements.csv.
        suite: Folder to write.

    Returns:
        Names of the parts.
    """
    with (source / "measurements.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    block = np.arange(len(rows)) // BLOCK
    fresh = np.flatnonzero(block % KEPT == KEPT // 2)
    given = np.flatnonzero(block % KEPT != KEPT // 2)
    rng = np.random.default_rng(SEED)
    parts = {"whole": given}
    parts |= {f"half_{name}": given[block[given] % 2 == k] for k, name in enumerate("ab")}
    parts |= {f"thin_{n:03d}": np.sort(rng.choice(given, n, replace=False)) for n in THINNED}
    parts |= {"mirror": np.sort(rng.choice(given, MIRRORED, replace=False))}
    parts |= {"mirror_control": parts["mirror"]}
    for name, chosen in parts.items():
        if not (suite / name / "truth.json").is_file():
            turn = _mirror(source, rows) if name == "mirror" else _same
            _write_case(
                suite / name, source, turn([rows[k] for k in chosen], chosen), turn([rows[k] for k in fresh], fresh)
            )
    return list(parts)


def _same(rows: Rows, _: np.ndarray) -> Rows:
    return rows


def _mirror(source: Path, rows: Rows) -> Callable[[Rows, np.ndarray], Rows]:
    """Return a map that negates the deviations from the nominal robot, registered on all rows."""
    chain = read_chain(source / "robot")
    log = read_log(source / "measurements.csv", chain)
    gravity = chain.gravity if chain.has_gravity else np.zeros(3)
    posed = load_chain(chain, log.q, log.wrench, gravity)
    frames = fit_frames(log, posed.tip, posed.attitude, ("base", "tool"))
    target = posed.tip + np.einsum("nij,nj->ni", posed.attitude, frames.of_targets(log))
    position = 2.0 * (target @ frames.turn.T + frames.shift) - log.position
    vector = None
    if log.attitude is not None:
        model = frames.turn @ posed.attitude @ frames.tool
        vector = Rotation.from_matrix(model @ log.attitude.transpose(0, 2, 1) @ model).as_rotvec(degrees=True)

    def turn(chosen: Rows, numbers: np.ndarray) -> Rows:
        out = []
        for row, k in zip(chosen, numbers, strict=True):
            new = dict(row)
            new |= {f"{a}_mm": f"{1e3 * position[k, i]:.5f}" for i, a in enumerate("xyz")}
            if vector is not None:
                new |= {f"r{a}_deg": f"{vector[k, i]:.6f}" for i, a in enumerate("xyz")}
            out.append(new)
        return out

    return turn


def _write_case(folder: Path, source: Path, given: Rows, fresh: Rows) -> None:
    shutil.copytree(source / "robot", folder / "robot", dirs_exist_ok=True)
    for name, rows in (("measurements", given), ("fresh", fresh)):
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    truth = {"kind": "real", "effects": [], "background": [], "register": {"given": "not known"}}
    write_whole(folder / "truth.json", json.dumps(truth) + "\n")


def repeat_claims(halves: list[list[dict[str, Any]]], least: float) -> tuple[int, int]:
    """Count claims of two halves stated at least so surely that the other half claims as well, and all of them."""
    places = [{(e["effect"], e["joint"], e["axis"]) for e in half} for half in halves]
    found = [
        (e["effect"], e["joint"], e["axis"]) in places[1 - k]
        for k, half in enumerate(halves)
        for e in half
        if e["probability"] >= least
    ]
    return sum(found), len(found)
