"""Process stiffness: the force depends on where the tool really is, not on where its path is.

To first order the force falls as the tool gives way, dF = -K (tip - path). K is given, as the stiffness of a sheet, or
it is the derivative of a cutter's force: engagement is worked out again for the path as a whole shifted by SHIFT to
either side along each axis of the part, the stock left where it is. A wall that the same shifted path has cut goes
along with it, so that only stock and depth that the path did not make answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.process.cutting import CuttingForce
from compplan.toolpath.contact import path_axes
from compplan.toolpath.toolpath import Toolpath, interpolate

#: By how much a path is shifted for the derivative: the size of deviations. [m]
SHIFT = 1e-4
#: Length of path over which a tool follows a force that jumps, in radii of the cutter (assumed: about as far as a tool
#: is pushed aside, since what it then cuts sideways holds it back). Without it rows beside each other at the entry of a
#: cut take turns in the air.
LAG = 0.1

Stiffness3 = Annotated[tuple[float, float, float], Field(strict=False)]


class CouplingTable(StrictTable):
    """[coupling]: how the force answers to where the tool is: `stiffness_N_mm` in a frame, or from the force model."""

    stiffness_N_mm: Stiffness3 | None = None
    frame: Literal["part", "base", "path"] = "part"
    from_model: bool = False

    @model_validator(mode="after")
    def _check(self) -> CouplingTable:
        if (self.stiffness_N_mm is None) != self.from_model:
            raise ValueError("needs one of stiffness_N_mm and from_model = true, not both")
        if self.stiffness_N_mm is not None and not all(0.0 <= value <= 1e6 for value in self.stiffness_N_mm):
            raise ValueError(f"stiffness_N_mm is {list(self.stiffness_N_mm)}, 0 to 1e6 N/mm is allowed: check the unit")
        return self


@dataclass(frozen=True)
class ProcessStiffness:
    """How the force of a process answers to where the tool is.

    Attributes:
        table: What the job says.
        R_base_part: Part axes seen from the base. Shape (3, 3).
        cutting: The engagement of the path, where its derivative is meant.

    """

    table: CouplingTable
    R_base_part: Array
    cutting: CuttingForce | None = None

    @property
    def source(self) -> str:
        """Say in a few words where the stiffness comes from."""
        if self.table.stiffness_N_mm is None:
            return "derivative of the force model, the whole path shifted against its stock"
        values = " / ".join(f"{value:g}" for value in self.table.stiffness_N_mm)
        return f"{values} N/mm along x / y / z of the {self.table.frame} frame, given in the job"

    @cached_property
    def shifted(self) -> tuple[tuple[CuttingForce, CuttingForce], ...]:
        """The force of the path shifted back and forth along each axis of the part."""
        if self.cutting is None:
            return ()
        every = np.ones((len(self.cutting.arc), 1))
        return tuple(
            (self.cutting.shift(-SHIFT * every * axis), self.cutting.shift(SHIFT * every * axis)) for axis in np.eye(3)
        )

    def along(self, nominal: Toolpath, wrench: Array) -> Array:
        """Return the stiffness K of dF = -K (tip - path), zero where nothing acts.

        Args:
            nominal: The path, base frame, with the feed that is driven.
            wrench: The wrench on the tool that stands on it. Shape (n, 6). [N, N m]

        Returns:
            Base axes. Shape (n, 3, 3). [N/m]

        """
        acts = (np.abs(wrench[:, :3]).max(axis=1) > 0.0)[:, None, None]
        if self.table.stiffness_N_mm is not None:
            axes = {"part": self.R_base_part[None], "base": np.eye(3)[None]}.get(self.table.frame)
            axes = path_axes(nominal) if axes is None else axes
            size = 1e3 * np.array(self.table.stiffness_N_mm)
            return np.asarray(acts * ((axes * size) @ np.swapaxes(axes, 1, 2)))
        axes = path_axes(nominal)
        columns = [(back.wrench(nominal)[:, :3] - forth.wrench(nominal)[:, :3]) / (2.0 * SHIFT)
                   for back, forth in self.shifted]  # fmt: skip
        return np.asarray(acts * (axes @ np.stack(columns, axis=2) @ self.R_base_part.T))

    def displace(self, nominal: Toolpath, away: Array) -> CuttingForce | None:
        """Return the cutting force of a tool that is off its path by (n, 3) [m], base axes; None where K is given."""
        if self.cutting is None:
            return None
        part = np.where(nominal.rapid[:, None], 0.0, away) @ self.R_base_part
        there = interpolate(self.cutting.arc, nominal.arc_length, part)
        return self.cutting.shift(follow_jumps(there, self.cutting.arc, LAG * self.cutting.bench.cutter.radius))


def follow_jumps(away: Array, arc: Array, length: float) -> Array:
    """Return where a tool is that follows away (r, 3) [m] along the path over a length [m], to first order."""
    keep = np.exp(-np.diff(arc, prepend=arc[0]) / length)[:, None]
    lagged, last = np.empty_like(away), np.zeros(3)
    for i in range(len(away)):
        last = keep[i] * last + (1.0 - keep[i]) * away[i]
        lagged[i] = last
    return lagged


def read_coupling(
    table: CouplingTable | None, R_base_part: Array, cutting: CuttingForce | None, model: str, job: Path
) -> ProcessStiffness | None:
    """Return what a job says of its process stiffness.

    Raises:
        InputError: If the derivative of a model is asked for that has none.

    """
    if table is None:
        return None
    if table.from_model and cutting is None:
        message = (f"is true, but the model {model!r} does not know how its force answers to where the tool is, only "
                   "end_mill and drill do; give coupling.stiffness_N_mm")  # fmt: skip
        raise InputError(message, file=job, where="coupling.from_model")
    return ProcessStiffness(table, R_base_part, cutting if table.from_model else None)
