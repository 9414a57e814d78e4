"""Drawn force logs and what `compplan forces --log` makes of them: `python -m benchmarks force_logs [--logs 40]`.

Each log is the force of known coefficients along half a level of the shipped pocket, with an offset, a drift, a lag and
noise of 30 % of the force, white or, in every second log, hanging together from row to row. Asked is how often the
95 % intervals hold the truth, and how wide they are beside those of an oracle that knows the lag and
the noise. Force law, path axes and coefficients' columns are the product's own; noise and interpolation are not.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from compplan.job.job import load_job
from compplan.job.loading import load_path
from compplan.process.fit import fit_forces
from compplan.process.force_law import ForceLaw
from compplan.process.log import ForceLog
from compplan.toolpath.contact import cutting_progress, path_axes
from compplan.toolpath.toolpath import Toolpath

POCKET = Path(__file__).parents[1] / "examples" / "forces" / "pocket.toml"
TRUTH = np.array([900.0, 300.0, 120.0, 20.0, 18.0, 1.0])
NOISE, OFFSET, DRIFT, LAG, ROWS, MEMORY = 0.3, 15.0, 10.0, 5e-3, (400, 4000), 0.7


@dataclass(frozen=True)
class Drawn:
    """Of each log: which of the six coefficients and the lag are held, widths, and the oracle's; fits refused."""

    held: np.ndarray
    width: np.ndarray
    oracle: np.ndarray
    white: np.ndarray
    negative: int
    refused: int


def load_pocket() -> tuple[Toolpath, ForceLaw]:
    """Return the path and force law of half a level of the pocket."""
    with tempfile.TemporaryDirectory() as folder:
        rows = (POCKET.parent / "pocket.csv").read_text(encoding="utf-8").splitlines()[:17]
        (Path(folder) / "pocket.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        job = Path(folder) / "job.toml"
        job.write_text(POCKET.read_text(encoding="utf-8"), encoding="utf-8")
        return load_path(load_job(job))


def lay_columns(nominal: Toolpath, law: ForceLaw, s: np.ndarray) -> np.ndarray:
    """Return the force by one of each coefficient at lengths cut, part axes. Shape (6, m, 3)."""
    assert law.cutting is not None
    process, progress = law.cutting.process, cutting_progress(nominal)
    per_tooth = process.spindle().feed_per_tooth(nominal.feed)
    local = law.cutting.shape.columns(process.resistance.exponent, per_tooth)[:, :, :3] * ~nominal.rapid[:, None, None]
    axes = np.einsum("ji,njk->nik", law.T_base_part[:3, :3], path_axes(nominal))
    after = np.clip(np.searchsorted(progress, s - 1e-9), 1, len(progress) - 1)
    share = np.clip((s - progress[after - 1]) / np.maximum(np.diff(progress)[after - 1], 1e-9), 0.0, 1.0)
    mixed = (1.0 - share)[:, None, None] * local[after - 1] + share[:, None, None] * local[after]
    mixed *= ((s >= -1e-9) & (s <= progress[-1] + 1e-9))[:, None, None]
    return np.einsum("mij,mcj->cmi", axes[after], mixed)


def draw_logs(count: int) -> Drawn:
    """Draw logs and fit each."""
    nominal, law = load_pocket()
    end = float(cutting_progress(nominal)[-1])
    held, width, oracle, white = [], [], [], []
    negative = refused = 0
    for seed in range(count):
        rng = np.random.default_rng(seed)
        lag = rng.uniform(-LAG, LAG)
        s = np.linspace(-LAG, end + LAG, int(rng.integers(*ROWS)))
        columns = lay_columns(nominal, law, s - lag)
        force = np.einsum("c,cmk->mk", TRUTH, columns)
        sigma = NOISE * np.sqrt((force**2).sum(axis=1).mean() / 3.0)
        noise, longer = rng.normal(0.0, sigma, force.shape), 1.0
        if seed % 2:
            longer = np.sqrt((1.0 + MEMORY) / (1.0 - MEMORY))  # of a mean over many rows
            noise = lfilter([np.sqrt(1.0 - MEMORY**2)], [1.0, -MEMORY], noise, axis=0)
        share = (s - s[0]) / np.ptp(s)
        measured = force + noise + rng.uniform(-OFFSET, OFFSET, 3) + np.outer(share, rng.uniform(-DRIFT, DRIFT, 3))
        try:
            fit = fit_forces(ForceLog(s, False, measured), law, nominal, Path("drawn.csv"))
        except Exception as error:  # a refusal counts, whatever its words
            print(f"log {seed} refused: {error}")
            refused += 1
            continue
        held.append([n.low <= t <= n.high for n, t in zip(fit.numbers, [*TRUTH, 1e3 * lag], strict=False)])
        width.append([0.5 * (n.high - n.low) for n in fit.numbers[:6]])
        silent = any(n.value < 0.0 for n in fit.numbers[:6]) and not fit.notes
        negative += silent
        tare = np.einsum("mt,kl->mklt", np.column_stack([np.ones(len(s)), share]), np.eye(3)).reshape(len(s), 3, 6)
        design = np.concatenate([np.moveaxis(columns, 0, 2), tare], axis=2).reshape(-1, 12)
        oracle.append(1.96 * sigma * longer * np.sqrt(np.diag(np.linalg.inv(design.T @ design))[:6]))
        white.append(seed % 2 == 0)
    return Drawn(np.array(held), np.array(width), np.array(oracle), np.array(white), negative, refused)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--logs", type=int, default=40)
    drawn = draw_logs(arguments.parse_args().logs)
    for name, rows in (("white noise", drawn.white), ("noise that hangs together", ~drawn.white)):
        ratio = np.median(drawn.width[rows] / drawn.oracle[rows])
        held = 100 * drawn.held[rows].mean(axis=0)
        print(f"{name}: {rows.sum()} logs; 95 % intervals hold {held[:6].mean():.1f} % of {6 * rows.sum()} "
              f"coefficients, the lag {held[6]:.0f} %; half widths {ratio:.2f} times the oracle's")  # fmt: skip
    every = ", ".join(f"{100 * share:.0f}" for share in drawn.held[:, :6].mean(axis=0))
    print(f"all: {100 * drawn.held[:, :6].mean():.1f} % held (tangential, radial, axial, edges: {every} %); "
          f"{drawn.negative} negative coefficients without a word, {drawn.refused} logs refused")  # fmt: skip


if __name__ == "__main__":
    main()
