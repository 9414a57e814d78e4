"""A real campaign cut into parts: whole, mirrored, halves and thinned, one stretch of poses kept for the check.

    python -m benchmarks.diagnosis_report --real DIR --out OUT      everybody's answers to the parts, on one page

Halves and thinned parts come in pairs that share no row. Rows of DIR/fresh.csv are never given to anybody; without that
file it is every eighth block of BLOCK consecutive rows. They are the later campaign of each part.
Mirrored: every deviation from the registered nominal robot is negated, the common mistake of sign.
"""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
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
PAIR = "ab"
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
    rows = _read_rows(source / "measurements.csv")
    block = np.arange(len(rows)) // BLOCK
    if (source / "fresh.csv").is_file():
        kept, given = _read_rows(source / "fresh.csv"), np.arange(len(rows))
        rows, fresh = rows + kept, len(rows) + np.arange(len(kept))
    else:
        fresh = np.flatnonzero(block % KEPT == KEPT // 2)
        given = np.flatnonzero(block % KEPT != KEPT // 2)
    rng = np.random.default_rng(SEED)
    parts = {"whole": given}
    parts |= {f"half_{name}": given[block[given] % 2 == k] for k, name in enumerate(PAIR)}
    for n in THINNED:
        if 2 * n <= len(given):
            drawn = rng.choice(given, 2 * n, replace=False)
            parts |= {f"thin_{n:03d}_{name}": np.sort(drawn[k::2]) for k, name in enumerate(PAIR)}
    parts |= {"mirror": np.sort(rng.choice(given, min(MIRRORED, len(given)), replace=False))}
    parts |= {"mirror_control": parts["mirror"]}
    for name, chosen in parts.items():
        if not (suite / name / "truth.json").is_file():
            turn = _mirror(source, rows) if name == "mirror" else _same
            _write_case(
                suite / name, source, turn([rows[k] for k in chosen], chosen), turn([rows[k] for k in fresh], fresh)
            )
    return list(parts)


def other_part(name: str) -> str | None:
    """Return the part of a pair that shares no row with another one, None where there is none."""
    if name[-2:] not in {f"_{letter}" for letter in PAIR}:
        return None
    return name[:-1] + PAIR[1 - PAIR.index(name[-1])]


def _read_rows(file: Path) -> Rows:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _same(rows: Rows, _: np.ndarray) -> Rows:
    return rows


def _mirror(source: Path, rows: Rows) -> Callable[[Rows, np.ndarray], Rows]:
    """Return a map that negates the deviations from the nominal robot, registered on all rows."""
    chain = read_chain(source / "robot")
    with tempfile.TemporaryDirectory() as folder:
        _write_rows(Path(folder) / "rows.csv", rows)
        log = read_log(Path(folder) / "rows.csv", chain)
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
        _write_rows(folder / f"{name}.csv", rows)
    truth: dict[str, Any] = {"kind": "real", "effects": [], "background": [], "register": {"given": "not known"}}
    other = other_part(folder.name)
    truth["disjoint"] = [] if other is None else [other]
    write_whole(folder / "truth.json", json.dumps(truth) + "\n")


def _write_rows(file: Path, rows: Rows) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


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
