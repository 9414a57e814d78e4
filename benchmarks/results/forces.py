"""Milling forces, engagement, deflection and chatter beside simulations in time."""

from __future__ import annotations

import re

import numpy as np

from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "Forces: are the predicted cutting forces right?"
QUESTION = "How far are engagement, mean force, ripple, deflected walls and chatter calls from simulations in time?"
METHOD = (
    "`python -m benchmarks.engagement` sweeps a block of cubes; `benchmarks.milling` cuts tooth by tooth in time; "
    "`benchmarks.deflected` lets force, deflection and removal advance together; `benchmarks.stability` integrates the "
    "delay equation of drawn cuts. None shares code with the models of the product."
)
LIMITS = (
    "The simulations share the cutting law and its coefficients with the product: they check geometry and mechanics, "
    "not the material.",
    "Flat end mills for the force; rounded cutters for the engagement alone.",
    "Masses and damping of the arms are assumed. Tool, holder and spindle are rigid.",
)


def measure(settings: Settings) -> Findings:
    """Run the four benchmarks."""
    from benchmarks import engagement, milling

    del settings
    meets, mills = engagement.compare(), milling.compare()
    walls = run_benchmark("benchmarks.deflected")
    calls = [run_benchmark("benchmarks.stability", "--seed", seed) for seed in (18, 19)]
    agree = [float(share) for text in calls for share in re.findall(r"semi-discretisation: ([\d.]+) %", text)]
    worst = re.search(r"worst: ([\d.]+) %", walls)
    force, torque, ripple = (100 * np.nanmax([row[k] for row in mills]) for k in (1, 2, 3))
    volume = 100 * np.nanmax([row[1] for row in meets])
    return Findings(
        (
            f"Mean milling force within {force:.1f} %, torque within {torque:.1f} %, ripple within {ripple:.1f} %.",
            f"Removed volume within {volume:.1f} % of a sweep of cubes.",
            f"Walls cut by an arm that gives way within {worst[1] if worst else '?'} % of the deviation.",
            f"Chatter is called as the simulation calls it in {min(agree):.1f} % of the drawn cuts or more.",
        ),
        (
            "Engagement, mean differences:\n\n"
            + draw_table(
                ("path", "volume", "axial depth", "radial width"), [(r[0], *map(_share, r[1:])) for r in meets]
            ),
            "Milling, differences:\n\n"
            + draw_table(("cut", "mean force", "torque", "ripple"), [(r[0], *map(_share, r[1:])) for r in mills]),
            "Deflected walls:\n\n```text\n" + walls.strip() + "\n```",
            "Chatter:\n\n```text\n" + "\n".join(text.strip() for text in calls) + "\n```",
        ),
        (),
    )


def _share(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"
