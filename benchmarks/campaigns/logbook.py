"""Turn simulated readings into the log that an engineer hands over: frames, noise that grows with distance, columns."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import Array, RobotDescription
from benchmarks.campaigns.simulate import Reading, Rows
from benchmarks.campaigns.visits import Visits

Generator = np.random.Generator


@dataclass(frozen=True)
class Frames:
    """Frames that a campaign's measurements are in; without registration they are base and TCP.

    Args:
        base_turn: Rotation vector of the base in the measurement frame. Shape (3,). [rad]
        base_m: Origin of the base in the measurement frame. Shape (3,). [m]
        target_m: Measured point in the TCP frame. Shape (3,). [m]
        tool_turn: Rotation vector of the measured body in the TCP frame. Shape (3,). [rad]
    """

    base_turn: Array
    base_m: Array
    target_m: Array
    tool_turn: Array

    def view(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Return poses of the measured body in the measurement frame."""
        base = Rotation.from_rotvec(self.base_turn).as_matrix()
        tool = Rotation.from_rotvec(self.tool_turn).as_matrix()
        target = position + rotation @ self.target_m
        return target @ base.T + self.base_m, base @ rotation @ tool

    def facts(self) -> dict[str, list[float]]:
        """Return the frames for truth.json."""
        return {k: np.asarray(v).tolist() for k, v in self.__dict__.items()}


@dataclass(frozen=True)
class Log:
    """One log: its table, as text, and what is known about its noise.

    Args:
        table: Columns by name, in order.
        noise: Measured minus true position, where it is no outlier. Shape (k, 3). [m]
        outliers: Rows that are gross outliers. Shape (j,).
    """

    table: dict[str, list[str]]
    noise: Array
    outliers: np.ndarray

    def write(self, path: Path) -> None:
        """Write the log, first under a temporary name."""
        part = path.with_suffix(".part")
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.table)
            writer.writerows(zip(*self.table.values(), strict=True))
        os.replace(part, path)


def draw_frames(rng: Generator, target: Array | None, tool_turn: Array | None, reach: float) -> Frames:
    """Draw where the instrument's frame lies; target and tool stay what they are in a later campaign."""
    size = min(reach, 2.0)
    return Frames(
        Rotation.random(random_state=rng).as_rotvec() * float(rng.uniform(0.05, 1.0)),
        rng.normal(size=3) * 0.8 * size,
        rng.normal(size=3) * 0.02 if target is None else target,
        rng.normal(size=3) * 0.03 if tool_turn is None else tool_turn,
    )


def record(
    rng: Generator,
    rows: Rows,
    truth: Reading,
    visits: Visits,
    robot: RobotDescription,
    frames: Frames | None,
    warm: float,
) -> Log:
    """Measure a campaign and write its table.

    Args:
        rng: Source of randomness.
        rows: The plan.
        truth: Readings without noise, base frame.
        visits: Instrument and columns.
        robot: The robot, for the kind of every joint.
        frames: Where the instrument's frame lies, or None for the base frame.
        warm: Reference temperature. [deg C]
    """
    n = len(rows.q)
    sigma = visits.sigma(truth.position)
    position, rotation = (
        (truth.position, truth.rotation) if frames is None else frames.view(truth.position, truth.rotation)
    )
    noise = rng.normal(size=(n, 3)) * sigma[:, None]
    outliers = np.flatnonzero(rng.random(n) < visits.outliers)[: int(0.02 * n)]
    thrown = rng.normal(size=(len(outliers), 3))
    thrown *= (np.exp(rng.uniform(np.log(12), np.log(90), len(outliers))) / np.linalg.norm(thrown, axis=1))[:, None]
    inside = np.delete(noise, outliers, axis=0)
    noise[outliers] += thrown * sigma[outliers, None]
    turned = Rotation.from_rotvec(rng.normal(0.0, np.deg2rad(0.005), (n, 3))) * Rotation.from_matrix(rotation)
    shaken = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]) * visits.force_noise
    wrench = truth.wrench + rng.normal(size=(n, 6)) * shaken
    empty = rng.random((n, 7)) < visits.missing
    measured: dict[str, Any] = {
        "position": position + noise,
        "turn": turned.as_rotvec(),
        "wrench": wrench,
        "link": truth.link + rng.normal(0.0, np.deg2rad(0.0003), truth.link.shape),
        "temperature": warm + rows.rise + rng.normal(0.0, 0.03, n),
        "sigma": sigma,
    }
    return Log(tabulate(rows, visits, robot, measured, empty), inside, outliers)


def tabulate(
    rows: Rows, visits: Visits, robot: RobotDescription, measured: dict[str, Any], empty: np.ndarray
) -> dict[str, list[str]]:
    """Return the columns of a log, as text.

    Args:
        rows: The plan.
        visits: Which columns there are, and in which units.
        robot: The robot, for the kind of every joint.
        measured: By quantity what was measured: position, turn, wrench, link, temperature, sigma. SI.
        empty: Empty fields, by row and column of position, orientation and temperature. Shape (n, 7).
    """
    si = visits.si_units
    length, angle = (1.0, 1.0) if si else (1e3, 180.0 / np.pi)
    unit, turn = ("m", "rad") if si else ("mm", "deg")
    table: dict[str, list[str]] = {"run": [str(v) for v in rows.run]}
    if visits.time:
        table["time_s"] = _text(rows.time, 4)
    kinds = [robot.segments[i].kind for i in robot.actuated]

    def joints(values: Array, suffix: str) -> None:
        for j, kind in enumerate(kinds):
            turning = kind == "revolute"
            scale = angle if turning else length
            table[f"q{j + 1}{suffix}_{turn if turning else unit}"] = _text(values[:, j] * scale, 9 if si else 7)

    joints(rows.q, "")
    if visits.loaded:
        for k, name in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
            table[name] = _text(measured["wrench"][:, k] + 0.0, 2 if k < 3 else 3)
    for k, name in enumerate("xyz"):
        table[f"{name}_{unit}"] = _text(measured["position"][:, k] * length, 7 if si else 4, empty[:, k])
    if visits.orientation:
        for k, name in enumerate("xyz"):
            table[f"r{name}_{turn}"] = _text(measured["turn"][:, k] * angle, 7 if si else 5, empty[:, 3 + k])
    if visits.link_encoders:
        joints(measured["link"], "_link")
    if visits.temperature:
        table["temperature_C"] = _text(measured["temperature"], 2, empty[:, 6])
    if visits.sigma_column:
        table[f"sigma_{unit}"] = _text(measured["sigma"] * length, 7 if si else 4)
    return table


def _text(values: Array, digits: int, empty: np.ndarray | None = None) -> list[str]:
    gone = np.zeros(len(values), bool) if empty is None else empty
    return ["" if g else f"{v:.{digits}f}" for v, g in zip(values, gone, strict=True)]
