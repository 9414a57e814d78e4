"""Friction stir welding: torque by Schmidt, Hattel and Wert (2004), forces from the given axial force.

With a contact shear stress s on a flat shoulder (radius R), probe side and probe tip (radius r, height h)

    M = 2/3 pi s (R^3 + 3 r^2 h)

[Schmidt, Hattel, Wert, Modelling Simul. Mater. Sci. Eng. 12 (2004) 143; as quoted in reviews]. Sticking: s is the yield
shear stress at welding temperature; sliding: friction times pressure. Axial force: as set at the machine. The shares of
traverse and side force are assumed, and so is an uncertainty of 20 %. Valid for the steady weld, not for plunging and
dwelling, which the ramp of contact replaces.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from compplan.io.tables import Array
from compplan.toolpath.contact import ContactTable, PathForceTable, find_retracts
from compplan.toolpath.toolpath import Toolpath

words = "friction stir weld"
#: Traverse and side force as shares of the axial one (assumed).
TRAVERSE, SIDE = 0.12, 0.05


class FrictionStirProcess(PathForceTable, ContactTable):
    """Mean force of a friction stir weld, see `compplan.process.force_models.friction_stir`."""

    uncertainty: ClassVar[float] = 0.2  #: Relative standard deviation of the level, assumed.
    model: Literal["friction_stir"]
    shoulder_diameter_mm: float = Field(gt=0.0, le=100.0)
    probe_diameter_mm: float = Field(gt=0.0, le=50.0)
    probe_length_mm: float = Field(gt=0.0, le=100.0)
    shear_N_mm2: float = Field(ge=1.0, le=500.0)
    axial_N: float = Field(gt=0.0, le=1e5)
    clockwise: bool = True

    @model_validator(mode="after")
    def _check(self) -> FrictionStirProcess:
        if self.probe_diameter_mm >= self.shoulder_diameter_mm:
            raise ValueError(
                f"probe_diameter_mm is {self.probe_diameter_mm:g}, "
                f"below shoulder_diameter_mm = {self.shoulder_diameter_mm:g} is allowed"
            )
        return self

    @property
    def torque(self) -> float:
        """Torque about the tool's axis. [N m]"""
        shoulder, probe = 0.5 * self.shoulder_diameter_mm, 0.5 * self.probe_diameter_mm
        body = shoulder**3 + 3.0 * probe**2 * self.probe_length_mm
        return float(2.0 / 3.0 * np.pi * self.shear_N_mm2 * body * 1e-3)

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench at every waypoint, path axes, zero while the tool is lifted off. Shape (n, 6).

        The side force points to the left.
        """
        axial, turn = self.axial_N, 1.0 if self.clockwise else -1.0
        row = [-TRAVERSE * axial, turn * SIDE * axial, axial, 0.0, 0.0, turn * self.torque]
        return np.tile(row, (len(nominal), 1)) * ~find_retracts(nominal)[:, None]

    def describe(self, nominal: Toolpath) -> list[str]:
        """Return notes on inputs and assumptions."""
        return [
            f"Friction stir welding: torque {self.torque:.3g} N m by Schmidt and others (2004), "
            f"shear stress {self.shear_N_mm2:g} N/mm2 and axial force as set in the job; traverse and side "
            f"force {TRAVERSE:g} and {SIDE:g} of it (assumed); scatter {100 * self.uncertainty:g} % (assumed)."
        ]


table = FrictionStirProcess
