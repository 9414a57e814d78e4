"""Milling forces and engagement beside simulations in time."""

from __future__ import annotations

import re

import numpy as np

from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "Forces: are the predicted cutting forces right?"
QUESTION = "How far are engagement, mean force and ripple from simulations in time?"
METHOD = (
    "`python -m benchmarks engagement` sweeps a block of cubes; `benchmarks.milling` cuts tooth by tooth in time; "
    "neither shares code with the models of the product. `benchmarks.force_logs` draws force logs with offset, drift, "
    "lag and noise and fits them; `benchmarks.drilling` holds drills against published figures and a second relation."
)
#: Aims for mean force and moment, and for the ripple, as shares.
MEAN_AIM, RIPPLE_AIM = 0.03, 0.10
LIMITS = (
    "The simulations share the cutting law and its coefficients with the product: they check geometry and mechanics, "
    "not the material.",
    "Chips thin towards what an earlier pass left, and the product's do not: a ball's second pass is 3 % off.",
    "The mean leaves run-out out; the ripple knows it.",
    "No published force record of incremental forming was found by search, and no later quote of its regression's list "
    "of variables: whether its height is the scallop or the step-down stays open; both are stated, the band has both.",
)


def measure(settings: Settings) -> Findings:
    """Run the four benchmarks."""
    from benchmarks import drilling, engagement, milling

    del settings
    meets, mills = engagement.compare(), milling.compare()
    logs = run_benchmark("benchmarks.force_logs", "--logs", 100)
    held = re.search(r"all: ([\d.]+) % held", logs)
    drilled = run_benchmark("benchmarks.drilling").strip()
    force, torque, ripple = (100 * np.nanmax([row[k] for row in mills]) for k in (1, 2, 3))
    volume = 100 * np.nanmax([row[1] for row in meets])
    return Findings(
        (
            f"Mean milling force within {force:.1f} %, moment within {torque:.1f} %, ripple within {ripple:.1f} %; "
            "flat, ball and corner-radius cutters, axes that stand and that swing by 20 degrees, run-out.",
            f"Removed volume within {volume:.1f} % of a sweep of cubes.",
            f"95 % intervals of coefficients fitted to drawn logs hold {held[1] if held else '?'} % of the truths.",
            f"Drills: {drilled.splitlines()[len(drilling.PUBLISHED) + 1]}.",
        ),
        (
            "Engagement, mean differences:\n\n"
            + draw_table(
                ("path", "volume", "axial depth", "radial width"), [(r[0], *map(_share, r[1:])) for r in meets]
            ),
            "Milling, differences:\n\n"
            + draw_table(("cut", "mean force", "moment", "ripple"), [(r[0], *map(_share, r[1:])) for r in mills]),
            "Drilling:\n\n```text\n" + drilled + "\n```",
            "Force logs:\n\n```text\n" + logs.strip() + "\n```",
        ),
        _find_losses(mills),
    )


def _find_losses(mills: list[tuple[str, float, float, float]]) -> tuple[str, ...]:
    """Name the cuts that miss the aims."""
    mean = [name for name, force, moment, _ in mills if max(force, moment) > MEAN_AIM]
    ripple = [name for name, *_, share in mills if share > RIPPLE_AIM]
    return tuple(
        f"{len(names)} of {len(mills)} cuts miss the aim of {100 * aim:.0f} % for {what}: {', '.join(names)}."
        for names, aim, what in ((mean, MEAN_AIM, "mean force and moment"), (ripple, RIPPLE_AIM, "the ripple"))
        if names
    )


def _share(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"
