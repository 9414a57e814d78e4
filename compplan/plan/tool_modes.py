"""Modes of what the arm carries: measured ones of a table, fitted to a measured response, or those of a beam.

Measured modes stand beside those of the arm. A beam is coupled to them: it is dragged along where the arm moves and
holds it back, to first order by the motion of the tip across the tool; that the arm also turns it is left out. In arm
modes a and beam modes b, each scaled to 1 kg, the mass matrix is [[1, P], [P^T, 1]] with P the beam's pull along a.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import eigh

from compplan.errors import InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import Array, read_table
from compplan.process.stability import Modes
from compplan.process.tool_beam import ToolBeam

COLUMNS = (
    FileColumn("frequency_Hz", required=True), FileColumn("damping", required=True), FileColumn("mass_kg"),
    FileColumn("residue_1_kg"), FileColumn("s_mm"),
    *(FileColumn(name, group="direction", required=True) for name in "xyz"),
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
        pull: What a unit acceleration of the clamp puts on each, along x, y, z; None for measured ones. Shape (3, m).
            [sqrt(kg)]
        place: Length of path at which each was measured, None for everywhere. Shape (m,). [m]

    """

    omega: Array
    damping: Array
    shape: Array
    pull: Array | None = None
    place: Array | None = None

    def at(self, length: float) -> ToolModes:
        """Return those that were measured nearest to a length of path [m]."""
        if self.place is None:
            return self
        away = np.abs(self.place - length)
        near = away <= away.min() + 1e-9
        return ToolModes(self.omega[near], self.damping[near], self.shape[:, near])

    def join(self, arm: Modes, axes: Array) -> Modes:
        """Return the modes of arm and tool, by frequency; `axes` are the tool's as columns, in the arm's axes."""
        omega = np.concatenate([arm.omega, self.omega])
        order = np.argsort(omega)
        shape = np.concatenate([arm.shape, axes @ self.shape], axis=1)
        damping = np.concatenate([np.broadcast_to(arm.damping, arm.omega.shape), self.damping])
        if self.pull is None:
            return Modes(omega[order], shape[:, order], damping[order], order >= len(arm.omega))
        mass = np.eye(len(omega))
        drag = arm.shape.T @ (axes @ self.pull)
        mass[: len(drag), len(drag) :], mass[len(drag) :, : len(drag)] = drag, drag.T
        if np.linalg.eigvalsh(mass)[0] < 1e-6:  # the arm is lighter than what it carries: its masses leave the tool out
            return replace(self, pull=None).join(arm, axes)
        square, ways = eigh(np.diag(omega**2), mass)
        found = np.sqrt(square)
        lost = np.einsum("jk,j->k", ways**2, damping * omega) / found
        return Modes(found, shape @ ways, lost)


def model_beam(beam: ToolBeam, count: int = 1) -> ToolModes:
    """Return the lowest modes of a beam across the tool, along x and y alike; the first makes 0.97 of what it gives."""
    omega, tip, pull = beam.modes.omega[:count], beam.modes.tip[:count], beam.modes.pull[:count]
    both = [np.concatenate([np.outer(way, values) for way in np.eye(3)[:2]], axis=1) for values in (tip, pull)]
    return ToolModes(np.tile(omega, 2), np.full(2 * len(omega), beam.damping), *both)


def read_tool_modes(file: Path) -> ToolModes:
    """Read a table with frequency_Hz, damping (share of critical), mass_kg or residue_1_kg, and a direction x, y, z.

    The direction is in tool axes (z out of the tool); the mass is that at the tip, along it. The residue is 1 / mass:
    compliance r / (w_n^2 - w^2 + 2 i z w_n w). Rows measured in several postures say s_mm, the length of path there.

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
    place = 1e-3 * table.values["s_mm"] if "s_mm" in table else None
    return ToolModes(2.0 * np.pi * frequency, damping, (way / size[:, None]).T / np.sqrt(mass), place=place)
