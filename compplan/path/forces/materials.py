"""Cutting coefficients of materials, each with its source, range of validity and uncertainty.

Force on a slice of cutting edge of width b at chip thickness h, for each of the directions along the cutting speed
(tangential), against the outward normal (radial) and along the edge away from the spindle (axial):

    F = (K h^(1 - m) + K_edge) b        h and b in mm, K in N/mm^2 (at h = 1 mm where m > 0), K_edge in N/mm.
"""

from __future__ import annotations

from dataclasses import dataclass

_DUAN = "Duan et al. 2021, Chinese Journal of Mechanical Engineering 34:18, table 5 (doi 10.1186/s10033-021-00536-9)"


@dataclass(frozen=True)
class Coefficients:
    """What a material resists a cutting edge with.

    Attributes:
        cutting: Tangential, radial, axial. [N/mm^2]
        edge: The same, per width. [N/mm]
        exponent: Kienzle's exponent m of each. []
        uncertainty: Relative standard deviation of the cutting coefficients that Monte Carlo draws from. []
        valid_chip_mm: Chip thickness that they were measured at, or is usual for them. [mm]
        source: Where they come from.
        assumed: Whether they were not checked against a publication.

    """

    cutting: tuple[float, float, float]
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exponent: tuple[float, float, float] = (0.0, 0.0, 0.0)
    uncertainty: float = 0.15
    valid_chip_mm: tuple[float, float] = (0.02, 0.3)
    source: str = "the job"
    assumed: bool = False


#: Uncertainties are assumed: the scatter between the publications that the source compares is larger still.
MATERIALS: dict[str, Coefficients] = {
    "al6061_t6": Coefficients(
        (243.77, 113.5, 0.0), (7.53, 7.83, 0.0), source=f"{_DUAN}, their reference 160; no axial part is given there"
    ),
    "al6082_t6": Coefficients((631.0, 99.0, 273.0), (13.0, 10.0, 2.8), source=f"{_DUAN}, their reference 189"),
    "al7075_t6": Coefficients((767.01, 168.8, 222.0), (27.7, 26.6, 0.7), source=f"{_DUAN}, their reference 190"),
    "ti6al4v": Coefficients(
        (1825.0, 770.0, 735.0), (29.7, 55.7, 1.8), uncertainty=0.2, assumed=True,
        source="assumed: the size that Altintas, Manufacturing Automation (2012), gives; not checked against the print",
    ),
    "c45": Coefficients(
        (1600.0, 640.0, 320.0), exponent=(0.25, 0.25, 0.25), uncertainty=0.25, assumed=True,
        source="assumed: kc1.1 and m as tool makers give for unalloyed steel, radial 0.4 and axial 0.2 of it",
    ),
}  # fmt: skip
