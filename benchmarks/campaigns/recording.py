"""Turn simulated readings into a measurement log: noise, outliers, missing fields, columns and their units."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import Array, RobotDescription
from benchmarks.campaigns.designs import Design
from benchmarks.campaigns.simulate import Reading, Rows

TEMPERATURE_NOISE = 0.03


@dataclass(frozen=True)
class Recording:
    """One measurement log as instruments give it, and what is known about it.

    Args:
        rows: The plan.
        truth: Readings without noise.
        position: Measured TCP position. Shape (n, 3). [m]
        rotation_vector: Measured orientation. Shape (n, 3). [rad]
        wrench: Reported wrench. Shape (n, 6). [N, N m]
        link: Link-side encoder readings. Shape (n, nq). [rad or m]
        temperature: Temperature of the structure. Shape (n,). [deg C]
        outliers: Rows that are gross outliers. Shape (k,).
        empty: Empty fields, by row and column of position, orientation and temperature. Shape (n, 7).
    """

    rows: Rows
    truth: Reading
    position: Array
    rotation_vector: Array
    wrench: Array
    link: Array
    temperature: Array
    outliers: np.ndarray
    empty: np.ndarray

    @property
    def noise(self) -> Array:
        """Measured minus true position. Shape (n, 3). [m]"""
        return self.position - self.truth.position


def record_readings(
    rng: np.random.Generator, rows: Rows, truth: Reading, design: Design, reference_temperature: float
) -> Recording:
    """Measure a campaign.

    Args:
        rng: Source of randomness.
        rows: The plan.
        truth: Readings without noise.
        design: Noise and columns.
        reference_temperature: Temperature at which nothing has grown yet. [deg C]
    """
    n = len(rows.q)
    position = truth.position + rng.normal(0.0, design.sigma, (n, 3))
    turn = Rotation.from_rotvec(rng.normal(0.0, design.sigma_rotation, (n, 3)))
    rotation = turn * Rotation.from_matrix(truth.rotation)
    outliers = np.flatnonzero(rng.random(n) < design.outliers)
    outliers = outliers[: int(0.02 * n)]
    jump = rng.normal(size=(len(outliers), 3))
    jump *= (
        np.exp(rng.uniform(np.log(10.0), np.log(100.0), len(outliers))) * design.sigma / np.linalg.norm(jump, axis=1)
    )[:, None]
    position[outliers] += jump
    shaken = np.array([design.force_noise] * 3 + [design.moment_noise] * 3)
    wrench = truth.wrench + rng.normal(size=(n, 6)) * shaken
    return Recording(
        rows,
        truth,
        position,
        rotation.as_rotvec(),
        wrench,
        truth.link + rng.normal(0.0, design.sigma_encoder, truth.link.shape),
        reference_temperature + rows.rise + rng.normal(0.0, TEMPERATURE_NOISE, n),
        outliers,
        rng.random((n, 7)) < design.missing,
    )


def write_log(recording: Recording, design: Design, robot: RobotDescription, path: Path, loads: bool) -> None:
    """Write a measurement log, first under a temporary name.

    Args:
        recording: The log.
        design: Which columns it has and in which units.
        robot: The robot, for the kind of every joint.
        path: File to write.
        loads: Whether wrench columns are written.
    """
    si = design.si_units
    rows, n = recording.rows, len(recording.rows.q)
    table: dict[str, list[str]] = {"run": [str(v) for v in rows.run], "time_s": _column(rows.time, 4)}
    kinds = [robot.segments[i].kind for i in robot.actuated]

    def joints(values: Array, suffix: str, digits: int) -> None:
        for j, kind in enumerate(kinds):
            factor = 1.0 if si else (180.0 / np.pi if kind == "revolute" else 1e3)
            unit = {(True, True): "rad", (False, True): "deg", (True, False): "m", (False, False): "mm"}[
                (si, kind == "revolute")
            ]
            table[f"q{j + 1}{suffix}_{unit}"] = _column(values[:, j] * factor, digits + 2 * si)

    joints(rows.q, "", 7)
    if loads:
        for k, name in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
            table[name] = _column(recording.wrench[:, k], 2 if k < 3 else 3)
    length, angle = (1.0, 1.0) if si else (1e3, 180.0 / np.pi)
    for k, name in enumerate("xyz"):
        table[f"{name}_{'m' if si else 'mm'}"] = _column(
            recording.position[:, k] * length, 7 if si else 4, recording.empty[:, k]
        )
    if design.orientation:
        for k, name in enumerate("xyz"):
            values = recording.rotation_vector[:, k] * angle
            table[f"r{name}_{'rad' if si else 'deg'}"] = _column(values, 7 if si else 5, recording.empty[:, 3 + k])
    if design.link_encoders:
        joints(recording.link, "_link", 7)
    if design.temperature:
        table["temperature_C"] = _column(recording.temperature, 2, recording.empty[:, 6])
    if design.sigma_column:
        table["sigma_m" if si else "sigma_mm"] = [
            f"{design.sigma * length:.7f}" if si else f"{design.sigma * length:.4f}"
        ] * n
    part = path.with_suffix(".part")
    with part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*table.values(), strict=True))
    os.replace(part, path)


def _column(values: Array, digits: int, empty: np.ndarray | None = None) -> list[str]:
    texts = [f"{v:.{digits}f}" for v in values]
    if empty is not None:
        texts = ["" if gone else text for text, gone in zip(texts, empty, strict=True)]
    return texts
