"""One simulated campaign with its truth, and how it is written to a folder."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaigns.description import Array, RobotDescription, write_robot_folder
from benchmarks.campaigns.designs import Design
from benchmarks.campaigns.recording import Recording, write_log
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, predict_rows
from benchmarks.campaigns.templates import SOURCES


@dataclass(frozen=True)
class Campaign:
    """A nominal robot, the log that a diagnosis is given, a later log of the same real robot, and the truth.

    Args:
        nominal: The robot as its folder states it.
        design: How the given campaign was run.
        later_design: How the later campaign was run.
        given: The log that a diagnosis is given.
        fresh: The later log.
        truth: What truth.json holds.
    """

    nominal: RobotDescription
    design: Design
    later_design: Design
    given: Recording
    fresh: Recording
    truth: dict[str, Any]

    def write(self, folder: str | Path) -> Path:
        """Write robot/, measurements.csv, fresh.csv and truth.json.

        Args:
            folder: Folder to write to; made if it is missing.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        source = SOURCES.get(self.nominal.name, "assumed")
        write_robot_folder(
            self.nominal, folder / "robot", {"compliance": source, "geometry": source, "masses": "assumed"}
        )
        loads = self.design.loads != "none"
        write_log(self.given, self.design, self.nominal, folder / "measurements.csv", loads)
        write_log(self.fresh, self.later_design, self.nominal, folder / "fresh.csv", loads)
        part = folder / "truth.part"
        part.write_text(json.dumps({"case": folder.name, **self.truth}, indent=1) + "\n", encoding="utf-8")
        os.replace(part, folder / "truth.json")
        return folder


def rms(vectors: Array) -> float:
    """Return the rms length of vectors, 0 if there are none. Shape (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else 0.0


def gap_of(nominal: Scenario, rows: Rows, real: Reading) -> Array:
    """Return true position minus what the nominal robot predicts from the reported wrench. Shape (n, 3). [m]"""
    return real.position - predict_rows(nominal, rows, real.wrench).position


def register_gap(gap: Array, real: Reading) -> Array:
    """Return what is left of a gap after base and tool frames were fitted to it, to first order. Shape (n, 3). [m]"""
    n = len(gap)
    p = real.position
    columns = np.zeros((n, 3, 9))
    columns[:, :, :3] = np.eye(3)
    for k in range(3):
        columns[:, :, 3 + k] = np.cross(np.eye(3)[k], p)
    columns[:, :, 6:] = real.rotation
    flat = columns.reshape(3 * n, 9)
    fit = np.linalg.lstsq(flat, gap.ravel(), rcond=1e-10)[0]
    return np.asarray((gap.ravel() - flat @ fit).reshape(n, 3))


def gap_figures(nominal: Scenario, rows: Rows, real: Reading) -> dict[str, float | None]:
    """Return the rms figures of a gap. [mm]"""
    gap = gap_of(nominal, rows, real) * 1e3
    path = rows.is_path
    return {
        "gap_rms_mm": rms(gap),
        "gap_registered_rms_mm": rms(register_gap(gap, real)),
        "gap_static_rms_mm": rms(gap[~path]),
        "gap_path_rms_mm": rms(gap[path]) if path.any() else None,
    }


def log_figures(recording: Recording, figures: dict[str, Any], file: str) -> dict[str, Any]:
    """Return what truth.json says about one log."""
    noise = recording.noise * 1e3
    inside = np.ones(len(noise), bool)
    inside[recording.outliers] = False
    labels, counts = np.unique(recording.rows.run, return_counts=True)
    rows = recording.rows
    stays = len(np.unique(rows.visit[~rows.is_path]))
    return {
        "file": file,
        "rows": len(noise),
        "runs": {str(label): int(count) for label, count in zip(labels, counts, strict=True)},
        "pose_visits": stays,
        **figures,
        "noise_rms_mm": rms(noise[inside]),
        "noise_rms_with_outliers_mm": rms(noise),
        "outlier_rows": [int(k) for k in recording.outliers],
    }
