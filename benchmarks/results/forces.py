"""Engagement beside a sweep of cubes."""

from __future__ import annotations

import numpy as np

from benchmarks import engagement
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table

TITLE = "Forces: is the engagement of a cutter right?"
QUESTION = "How far are removed volume, axial depth and radial width from a sweep of cubes?"
METHOD = (
    "`python -m benchmarks engagement` moves a cutter through a block of cubes; it shares no code with compplan. "
    "The mean force is compared with an integral over the teeth in `tests/process/test_milling.py`."
)
CHART = Chart("difference to the sweep of cubes, %", {
    name: (name, 0) for name in ("volume", "axial depth", "radial width")
})  # fmt: skip
LIMITS = (
    "The sweep uses the same cutter shape: it checks geometry, not material.",
    "Force coefficients of a material are the user's; nobody has compared a measured cut.",
)


def measure(settings: Settings) -> Findings:
    """Compare the paths."""
    del settings
    rows = engagement.compare()
    volume, axial, radial = (100 * np.nanmax([row[k] for row in rows]) for k in (1, 2, 3))
    return Findings(
        (
            f"Removed volume within {volume:.1f} %, axial depth within {axial:.1f} %, "
            f"radial width within {radial:.1f} %.",
        ),
        (draw_table(("path", "volume", "axial depth", "radial width"), [(r[0], *map(_share, r[1:])) for r in rows]),),
        (),
    )


def _share(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"
