"""Write simulated readings as the log that an engineer hands over."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.campaigns.description import Array, RobotDescription
from benchmarks.campaigns.simulate import Rows
from benchmarks.campaigns.visits import Visits


@dataclass(frozen=True)
class Log:
    """One log: its table, as text, and what is known about its noise."""

    table: dict[str, list[str]]  #: Columns by name, in order.
    noise: Array  #: Measured minus true position, where it is not an outlier. Shape (k, 3). [m]
    outliers: np.ndarray  #: Rows that are gross outliers. Shape (j,).

    def write(self, path: Path) -> None:
        """Write the log, first under a temporary name."""
        part = path.with_suffix(".part")
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(self.table)
            writer.writerows(zip(*self.table.values(), strict=True))
        os.replace(part, path)


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
