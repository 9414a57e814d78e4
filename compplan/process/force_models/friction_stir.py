"""Friction stir welding: torque by Schmidt, Hattel and Wert (2004), forces from the pressure under the shoulder.

With a contact shear stress s on shoulder (radius R, cone angle c), probe side and probe tip (radius r, height h)

    M = 2/3 pi s ((R^3 - r^3)(1 + tan c) + r^3 + 3 r^2 h)

[Schmidt, Hattel, Wert, Modelling Simul. Mater. Sci. Eng. 12 (2004) 143; as quoted in reviews]. Sticking: s is the yield
shear stress at welding temperature; sliding: friction times pressure. Axial force: pressure times the shoulder's area,
or as set at the machine. Traverse and side force as shares of it are assumed. +- 20 % is assumed. Valid for the steady
weld, not for plunging and dwelling; the ramp of contact stands in for these.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from compplan.io.tables import Array
from compplan.toolpath.contact import PathForceTable, lifts
from compplan.toolpath.toolpath import Toolpath

words = "friction stir weld"
cites = "Schmidt, Hattel, Wert: Modelling Simul. Mater. Sci. Eng. 12, 143, 2004"


class FrictionStirProcess(PathForceTable):
    """Mean force of a friction stir weld, see `compplan.process.force_models.friction_stir`."""

    uncertainty: ClassVar[float] = 0.2  #: Relative standard deviation of the level, assumed.
    model: Literal["friction_stir"]
    shoulder_diameter_mm: float = Field(gt=0.0, le=100.0)
    probe_diameter_mm: float = Field(gt=0.0, le=50.0)
    probe_length_mm: float = Field(gt=0.0, le=100.0)
    shoulder_cone_deg: float = Field(default=0.0, ge=0.0, le=30.0)
    shear_N_mm2: float = Field(ge=1.0, le=500.0)
    axial_N: float | None = Field(default=None, gt=0.0, le=1e5)
    pressure_N_mm2: float | None = Field(default=None, ge=1.0, le=500.0)
    traverse_ratio: float = Field(default=0.12, ge=0.0, le=1.0)
    side_ratio: float = Field(default=0.05, ge=-1.0, le=1.0)
    clockwise: bool = True

    @model_validator(mode="after")
    def _check(self) -> FrictionStirProcess:
        if (self.axial_N is None) == (self.pressure_N_mm2 is None):
            raise ValueError("needs one of axial_N and pressure_N_mm2, not both")
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
        cone = 1.0 + np.tan(np.radians(self.shoulder_cone_deg))
        body = (shoulder**3 - probe**3) * cone + probe**3 + 3.0 * probe**2 * self.probe_length_mm
        return float(2.0 / 3.0 * np.pi * self.shear_N_mm2 * body * 1e-3)

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench at every waypoint, path axes, none while the tool is lifted off. Shape (n, 6).

        The side force points to the left.
        """
        axial = self.axial_N
        if axial is None:
            axial = float(self.pressure_N_mm2 or 0.0) * np.pi * (0.5 * self.shoulder_diameter_mm) ** 2
        turn = 1.0 if self.clockwise else -1.0
        row = [-self.traverse_ratio * axial, turn * self.side_ratio * axial, axial, 0.0, 0.0, turn * self.torque]
        return np.tile(row, (len(nominal), 1)) * ~lifts(nominal)[:, None]

    def describe(self, nominal: Toolpath) -> list[str]:
        """Say what was set in the job and what was assumed."""
        stated = self.model_fields_set
        shares = " and ".join(
            f"{words} share {getattr(self, name):g} {'as set in the job' if name in stated else '(assumed)'}"
            for words, name in (("traverse", "traverse_ratio"), ("side", "side_ratio"))
        )
        given = "as set in the job" if self.axial_N is not None else "pressure times the shoulder's area"
        return [
            f"Friction stir welding: torque {self.torque:.3g} N m by Schmidt and others (2004), "
            f"shear stress {self.shear_N_mm2:g} N/mm2 as set in the job, axial force {given}; {shares}; "
            f"scatter {100 * self.uncertainty:g} % (assumed)."
        ]


table = FrictionStirProcess
