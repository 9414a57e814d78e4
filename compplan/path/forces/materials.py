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


_MAKER = (
    "(radial 0.4 and axial 0.2 of it assumed) kc1 and mc of a tool maker's table, Iscar turning catalogue 2017, p. 558"
)


def _of_maker(main: float, exponent: float, group: str, *, uncertainty: float = 0.25) -> Coefficients:
    """Return what a tool maker's table gives along the cutting speed, the other parts assumed as shares of it."""
    return Coefficients(
        (main, 0.4 * main, 0.2 * main), exponent=(exponent, exponent, exponent), uncertainty=uncertainty, assumed=True,
        source=f"assumed {_MAKER}: {group}",
    )  # fmt: skip


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
    "low_carbon_steel": _of_maker(1350.0, 0.21, "non-alloy steel below .25 % C, annealed, 125 HB"),
    "low_alloy_steel_300hb": _of_maker(1725.0, 0.24, "low alloy steel, quenched and tempered, 300 HB"),
    "tool_steel_annealed": _of_maker(2450.0, 0.23, "high alloyed and tool steel, annealed, 200 HB"),
    "stainless_austenitic": _of_maker(2150.0, 0.2, "austenitic stainless steel, 180 HB"),
    "stainless_martensitic": _of_maker(1875.0, 0.21, "martensitic stainless steel, 240 HB"),
    "cast_iron_pearlitic": _of_maker(1350.0, 0.28, "pearlitic cast iron, 250 HB"),
    "aluminium_cast": _of_maker(700.0, 0.25, "cast aluminium of up to 12 % Si, cured, 90 HB"),
    "brass": _of_maker(700.0, 0.27, "brass, 90 HB"),
    "copper": _of_maker(700.0, 0.27, "electrolytic copper, 100 HB"),
    "nickel_alloy_aged": _of_maker(3300.0, 0.24, "nickel or cobalt based, cured, 350 HB"),
    "particleboard": Coefficients(
        (34.8, 13.9, 0.0), uncertainty=0.3, assumed=True,
        source="assumed (radial part 0.4) mean of 32.0 and 37.6 N/mm2 measured in peripheral milling, Palubicki 2021, "
        "Materials 14, 2208",
    ),
}  # fmt: skip
