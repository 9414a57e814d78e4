"""Drilling beside published figures and a second relation: `python -m benchmarks drilling`.

Published thrust and torque stand in PUBLISHED, each with its source. More could not be read: of the papers that hold
tables of them (Kyratsis and others 2018, Machines 6, 24, Al7075; Karkalos and others 2019, Machines 7, 13, Al6082;
Materials 2024, 17, 2775, C45) only summaries were reached. Beside them a grid of 30 holes in four materials compares
the maker's table with the handbook's relation of Shaw and Oxford: two relations, no measurements.
"""

from __future__ import annotations

import sys

import numpy as np

from compplan.process.engagement_search import find_engagement
from compplan.process.force_models.drill import DrillProcess, ask_handbook
from compplan.process.stock import build_block

#: Diameter [mm], feed [mm a turn], thrust [N], torque [N m], source. No source says material or point: low carbon steel
#: is taken (assumed), and the product's own point, whose web is thinned.
PUBLISHED = (
    (10.0, 0.3, 2500.0, 15.0, "course on drilling forces, mmc-permanent.learnways.com/courses/81"),
    (7.0, 0.1, 1170.0, 2.617, "laboratory report ME20B138 (500 1/min, 50 mm/min), scribd.com/document/635496981; its "
     "second hole, 91 N at 10 mm and the same feed, is left out: it cannot have cut in full"),
)  # fmt: skip
GRID = [(material, size, feed) for material in ("al6082_t6", "low_carbon_steel", "low_alloy_steel_300hb",
        "cast_iron_pearlitic") for size, feed in ((4.0, 0.08), (6.0, 0.1), (6.0, 0.2), (8.0, 0.15), (10.0, 0.1),
        (10.0, 0.2), (12.0, 0.3), (16.0, 0.25))][:30]  # fmt: skip


def predict(material: str, size: float, feed: float, *, thinned: bool) -> tuple[float, float]:
    """Return the product's thrust [N] and torque [N m] of a hole in full cut."""
    process = DrillProcess(model="drill", diameter_mm=size, spindle_rpm=1000.0, material=material, web_thinned=thinned)
    path = np.zeros((40, 3))
    path[:, 2] = np.linspace(1e-3, -2e-3 * size, 40)
    block = build_block(np.array([-0.1, -0.1, -0.1]), np.array([0.1, 0.1, 0.0]), np.eye(3))
    found = find_engagement(process.cutter(), path, np.ones(40, bool), block)
    wrench = process.shape(found).wrench(process.resistance, np.full(40, 5e-4 * feed))[-1]
    return float(wrench[2]), float(wrench[5])


def main() -> int:
    print("hole: published thrust, torque | predicted | off by")
    inside = 0
    for size, feed, thrust, torque, source in PUBLISHED:
        own, plain = (predict("low_carbon_steel", size, feed, thinned=thinned) for thinned in (True, False))
        off = [100.0 * (a / b - 1.0) for a, b in zip(own, (thrust, torque), strict=True)]
        inside += max(map(abs, off)) <= 20.0
        print(f"{size:g} mm, {feed:g} mm a turn: {thrust:.0f} N, {torque:.3g} N m | {own[0]:.0f} N, {own[1]:.3g} N m | "
              f"{off[0]:+.0f} %, {off[1]:+.0f} %; a conventional point {plain[0]:.0f} N ({source})")  # fmt: skip
    missing = f"30 are wanted, {30 - len(PUBLISHED)} were not found"
    print(f"{inside} of {len(PUBLISHED)} published holes within 20 % (material and point assumed); {missing}")
    print("\nmaker's table over the handbook's relation, conventional point: thrust, torque (least to greatest)")
    for material in dict.fromkeys(material for material, *_ in GRID):
        ratios = np.array([np.divide(predict(material, size, feed, thinned=False),
                                     ask_handbook(material, size, feed, thinned=False))
                           for each, size, feed in GRID if each == material])  # fmt: skip
        low, high = ratios.min(axis=0), ratios.max(axis=0)
        print(f"{material} ({len(ratios)} holes): {low[0]:.2f} to {high[0]:.2f}, {low[1]:.2f} to {high[1]:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
