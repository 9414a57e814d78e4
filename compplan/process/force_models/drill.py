"""Mean thrust and torque of a drill, from the share of its point in the material.

The relation is that of a maker's table for twist drills [Tungaloy], D in mm, f in mm a turn, K a constant of the
material (1 for grey cast iron of 177 HB):

    thrust = 570 K D f^0.85 N          torque = 0.01 K D^2 (0.630 + 16.84 f) N m

It is written for two lips, so that it is linear in its coefficients (f_z: feed a lip, R = D / 2):

    thrust = N k_a f_z^0.85 R          torque = N (k_t f_z + k_e) R^2 / 2

with k_a against the feed, k_t and k_e along the cutting speed. The chisel edge causes half of the thrust of a
conventional point (textbooks [Ghosh, Mallik]); a thinned web removes four fifths of that (assumed). While the point
enters or leaves, the lips count with their length in the material, the chisel edge if the middle of the point is
inside. The forces of the lips across the axis cancel. Valid for moves along the axis.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.process.cutting import CuttingTable, MillingShape
from compplan.process.engagement import Cutter, Engagement
from compplan.process.materials import Coefficients

words = "thrust and torque of a drill"
SOURCE = "thrust and torque of twist drills by a tool maker's table (Tungaloy general catalogue, technical reference)"
#: Exponent of the thrust in Kienzle's form, 1 - 0.85.
EXPONENT = (0.0, 0.0, 0.15)
#: Coefficients at K = 1, two lips: along the speed [N/mm^2], of the edge [N/mm], against the feed [N/mm^1.85].
TANGENTIAL, EDGE, AXIAL = 16.84 * 10.0 * 8.0, 0.630 * 10.0 * 4.0, 570.0 * 2.0**0.85
#: The chisel edge's share of the radius, and of the thrust of a conventional point (assumed).
WEB, CHISEL = 0.2, 0.5
#: Share of the chisel edge's thrust that a thinned web removes (assumed).
THINNED = 0.8
#: Relative standard deviation of the level (assumed), due to points, coatings and wear.
SCATTER = 0.3
#: Constant K of the materials, and its source: assumed where the table has only a similar material.
DRILLED: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def drill_coefficients(material: str) -> Coefficients:
    """Return the coefficients of a drill's lips in a material: along the speed, across (zero), against the feed."""
    constant, words = DRILLED[material]["constant"], DRILLED[material]["source"]
    return Coefficients(
        (TANGENTIAL * constant, 0.0, AXIAL * constant), (EDGE * constant, 0.0, 0.0), EXPONENT, SCATTER, (0.02, 0.5),
        f"{SOURCE}, K = {constant:g}: {words}", words.startswith("assumed"),
    )  # fmt: skip


def shape_drilling(found: Engagement, lips: int) -> MillingShape:
    """Compute the factor of each coefficient of a drill in the mean wrench at its tip, path axes.

    Moves across the axis have no force.
    """
    edge = found.cutter.slices
    inner, outer = edge.knots[:-1, 0], edge.knots[1:, 0]
    radius = found.cutter.radius
    share = found.depth.mean(axis=2, dtype=np.float64) * np.maximum(-found.travel[:, 1:], 0.0)  # (n, k)
    length, area = (outer - inner) / radius, (outer**2 - inner**2) / radius**2
    middle = inner < 0.5 * WEB * radius
    chisel = CHISEL * (1.0 - THINNED)
    push = share @ (length * (1.0 - CHISEL)) + chisel * share[:, middle].mean(axis=1)
    turn = share @ area
    straight = np.zeros((len(found), 6, 6))
    straight[:, 0, 5] = straight[:, 3, 5] = lips * 0.5e-3 * (1e3 * radius) ** 2 * turn
    straight[:, 2, 2] = lips * 1e3 * radius * push
    return MillingShape(straight, np.zeros((len(found), 6, 6)))


class DrillProcess(CuttingTable):
    """A drill: thrust and torque of its lips and chisel edge; lips are opposite each other."""

    model: Literal["drill"]
    point_deg: float = Field(default=118.0, ge=60.0, le=180.0)

    @model_validator(mode="after")
    def _check_drilled(self) -> DrillProcess:
        if self.material is not None and self.material not in DRILLED:
            raise ValueError(f"material is {self.material!r}, choose from {list(DRILLED)} or give coefficients")
        if self.coefficients is not None and self.coefficients.cutting_N_mm2[2] <= 0.0:
            raise ValueError(
                f"cutting_N_mm2 is {list(self.coefficients.cutting_N_mm2)}; a drill's third one pushes against the "
                "feed and is above 0"
            )
        return self

    @property
    def resistance(self) -> Coefficients:
        """Coefficients of the lips: along the speed, across (cancels), against the feed."""
        if self.coefficients is not None:
            return self.coefficients.coefficients()
        return drill_coefficients(str(self.material))

    def cutter(self) -> Cutter:
        """Return the drill's shape; its margins do not cut, so its flute ends with its point."""
        radius = 0.5e-3 * self.diameter_mm
        point = float(np.radians(self.point_deg))
        return Cutter(radius, radius / float(np.tan(0.5 * point)) if point < np.pi else 0.0, point=point)

    def shape(self, found: Engagement) -> MillingShape:
        """Return the factor of each coefficient in thrust and torque, from the engagement."""
        return shape_drilling(found, self.teeth)

    def describe(self, found: Engagement, cuts: NDArray[np.bool_]) -> list[str]:
        """Return a note where the drill moves sideways in material."""
        aside = found.touches & cuts & (np.abs(found.travel[:, 0]) > np.abs(found.travel[:, 1]))
        if not aside.any():
            return []
        first = int(np.argmax(aside))
        return [f"The drill moves sideways in material at {aside.sum()} waypoints, the first {first}: no force is "
                "predicted there."]  # fmt: skip


table = DrillProcess
