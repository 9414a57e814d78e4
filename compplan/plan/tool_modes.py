"""Measured modes of tool, holder and spindle: a table of the user's, added to the modes of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compplan.errors import InputError
from compplan.files.columns import FileColumn
from compplan.files.tables import Array, read_table
from compplan.path.forces.stability import Modes

COLUMNS = (
    FileColumn("frequency_Hz", required=True), FileColumn("damping", required=True), FileColumn("mass_kg"),
    FileColumn("residue_1_kg"), *(FileColumn(name, group="direction", required=True) for name in "xyz"),
)  # fmt: skip
#: Frequencies [Hz], shares of critical damping and modal masses [kg] that are taken for true.
FREQUENCY, DAMPING, MASS = (1.0, 20e3), (1e-4, 0.5), (1e-4, 1e5)


@dataclass(frozen=True)
class ToolModes:
    """Modes of what the arm carries, tool axes.

    Attributes:
        omega: Angular frequencies. Shape (m,). [rad/s]
        damping: Shares of critical damping. Shape (m,).
        shape: Motion of the tip, scaled to a modal mass of 1 kg. Shape (3, m).

    """

    omega: Array
    damping: Array
    shape: Array

    def join(self, arm: Modes, axes: Array) -> Modes:
        """Return the modes of arm and tool, by frequency; `axes` are the tool's as columns, in the arm's axes."""
        omega = np.concatenate([arm.omega, self.omega])
        order = np.argsort(omega)
        shape = np.concatenate([arm.shape, axes @ self.shape], axis=1)
        damping = np.concatenate([np.broadcast_to(arm.damping, arm.omega.shape), self.damping])
        measured = order >= len(arm.omega)
        return Modes(omega[order], shape[:, order], damping[order], measured)


def read_tool_modes(file: Path) -> ToolModes:
    """Read a table with frequency_Hz, damping (share of critical), mass_kg or residue_1_kg, and a direction x, y, z.

    The direction is in tool axes (z out of the tool); the mass is that at the tip, along it. The residue is 1 / mass:
    compliance r / (w_n^2 - w^2 + 2 i z w_n w).

    Raises:
        InputError: With file and line, if a value cannot be true.

    """
    table = read_table(file, COLUMNS)
    if not len(table):
        raise table.error("no modes, expected at least one row")
    if ("mass_kg" in table) == ("residue_1_kg" in table):
        raise InputError("needs one of the columns mass_kg and residue_1_kg", file=file, where=1)
    frequency, damping = table.values["frequency_Hz"], table.values["damping"]
    given = table.values["mass_kg"] if "mass_kg" in table else table.values["residue_1_kg"]
    for name, value in (("mass_kg", given), ("residue_1_kg", given)):
        if name in table and (value <= 0.0).any():
            raise table.error(f"{name} is {value.min():g}, above 0 is expected", int(value.argmin()))
    mass = given if "mass_kg" in table else 1.0 / given
    way = np.column_stack([table.values[name] for name in "xyz"])
    size = np.linalg.norm(way, axis=1)
    for name, value, (low, high) in (
        ("frequency_Hz", frequency, FREQUENCY), ("damping", damping, DAMPING), ("modal mass in kg", mass, MASS),
        ("length of the direction x, y, z", size, (1e-6, 1e6)),
    ):  # fmt: skip
        wrong = np.flatnonzero(~((value >= low) & (value <= high)))
        if len(wrong):
            raise table.error(f"{name} is {value[wrong[0]]:g}, {low:g} to {high:g} is allowed", int(wrong[0]))
    return ToolModes(2.0 * np.pi * frequency, damping, (way / size[:, None]).T / np.sqrt(mass))
