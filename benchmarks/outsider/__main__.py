"""Draw campaigns from outside: `python -m benchmarks outsider --seeds 0:60 --out DIR`, one folder a seed."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.outsider.draw import SHIPPED, Case, draw_case
from benchmarks.outsider.world import Array, World, observe
from benchmarks.simulated_robot.robot import rotation_vector

STATUS: Mapping[str, list[str]] = {
    "mixed": ["partly_explained"], "unknown": ["unknown"], "none": ["none"],
    "background": ["none", "partly_explained", "unknown"],
}  # fmt: skip
FILES = {"given": "measurements.csv", "fresh": "fresh.csv"}


def write_case(case: Case, out: Path) -> Path:
    """Write the folder of a case: robot/, measurements.csv, fresh.csv, truth.json; return the folder."""
    folder, rng = out / f"outside_{case.seed:05d}", case.rng
    shutil.copytree(SHIPPED / case.robot, folder / "robot", dirs_exist_ok=True)
    file = folder / "robot" / "elasticity.toml"
    text = re.sub(r"(?m)^gravity\s*=.*\n", "", file.read_text(encoding="utf-8"))
    if case.gravity:
        text = re.sub(r"(?m)^(schema\s*=.*\n)", r"\1gravity = [0.0, 0.0, -9.81]\n", text)
    file.write_text(text, encoding="utf-8")
    outliers = float(rng.choice([0.0, 0.0, 0.0, 0.01]))
    target = rng.normal(size=3) * 0.02
    split = {}
    for name, world in (("given", case.given), ("fresh", case.fresh)):
        text, split[name] = _write_log(case, world, outliers, target)
        split[name]["file"] = FILES[name]
        (folder / FILES[name]).write_text(text, encoding="utf-8")
    everyday = observe(case.given, [(e.apply, e.size) for e in case.everyday])[0][:, :3]
    scatter = np.sqrt(((case.given.frames[1][:, :3] * case.scatter) ** 2).sum(axis=(1, 2)).mean())
    floor = float(np.sqrt(3 * case.sigma**2 + scatter**2 + (everyday**2).sum(1).mean()))
    truth = {
        "case": folder.name, "suite": "outside", "generator": "benchmarks.outsider", "seed": case.seed,
        "robot": case.robot, "kind": case.kind,
        "expected_status": STATUS.get(case.kind, ["explained", "partly_explained"]),
        "effects": sorted(case.labels, key=lambda label: -label["gap_rms_mm"]),
        "background": [
            {"effect": e.effect, "joint": e.place[0], "axis": e.place[1], "size": e.size,
             "over_sigma": _over_sigma(case, e)} for e in case.everyday
        ],
        "sigma_mm": 1e3 * case.sigma, "noise_floor_rms_mm": 1e3 * floor, "dominant_floor_rms_mm": 1e3 * floor,
        "split": split, "register": {"base": True, "tool": True} if case.register else None,
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(truth, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return folder


def _over_sigma(case: Case, error: Any) -> float:
    gap = observe(case.given, [(error.apply, error.size)])[0][:, :3]
    return round(float(np.sqrt((gap**2).sum(1).mean())) / case.sigma, 3)


def _write_log(case: Case, world: World, outliers: float, target: Array) -> tuple[str, dict[str, Any]]:
    """Write the log of a campaign with noise, scatter and slips, and say what is true of it."""
    rng, rows, n = case.rng, world.rows, world.n
    noise = rng.normal(size=(rows.visit[-1] + 1, world.count))[rows.visit] * case.scatter * rows.static[:, None]
    _, position, axes, wrench = observe(world, [(c.apply, c.size) for c in (*case.causes, *case.everyday)], noise)
    if case.register:  # the instrument's frame, and a target beside the tip
        turn, shift = rotation_vector(rng.uniform(-0.9, 0.9, 3)), rng.uniform(-2.0, 2.0, 3)
        position = (position + axes @ target) @ turn.T + shift
    measured = position + case.sigma * rng.normal(size=(n, 3))
    wild = np.flatnonzero(rng.random(n) < outliers)
    measured[wild] += rng.uniform(-4e-3, 4e-3, (len(wild), 3))
    columns: dict[str, list[str]] = {"run": list(rows.run)}
    if "time" in case.columns:
        columns["time_s"] = [f"{t:.3f}" for t in rows.time]
    for k in range(world.count):
        name, factor = (f"q{k + 1}_mm", 1e3) if world.slides[k] else (f"q{k + 1}_deg", 180 / np.pi)
        columns[name] = [f"{factor * v:.7f}" for v in rows.q[:, k]]
    if "wrench" in case.columns:
        names = [*(f"f{a}_N" for a in "xyz"), *(f"m{a}_Nm" for a in "xyz")]
        columns |= {name: [f"{v:z.4f}" for v in wrench[:, k]] for k, name in enumerate(names)}
    columns |= {f"{a}_mm": [f"{1e3 * v:.4f}" for v in measured[:, i]] for i, a in enumerate("xyz")}
    if "temperature" in case.columns:
        columns["temperature_C"] = [f"{21.0 + v:.2f}" for v in rows.warmth + 0.04 * rng.normal(size=n)]
    if "sigma" in case.columns:
        columns["sigma_mm"] = [f"{1e3 * case.sigma:.4f}"] * n
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n", {"rows": n, "outlier_rows": wild.tolist()}


@click.command()
@click.option("--seeds", required=True, help="Range of seeds A:B, B left out.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
def main(seeds: str, out: Path) -> None:
    """Draw labelled measurement campaigns that share no code with the product or with benchmarks.campaigns."""
    try:
        first, last = (int(v) for v in seeds.split(":"))
    except ValueError:
        raise click.BadParameter(f"seeds {seeds!r}, a range A:B of whole numbers is wanted") from None
    for seed in range(first, last):
        case = draw_case(seed)
        if case is None:
            click.echo(f"seed {seed}: no campaign that can be labelled fairly; left out", err=True)
        else:
            write_case(case, out)


if __name__ == "__main__":
    main(prog_name=sys.argv[0])
