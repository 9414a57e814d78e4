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
    "delay equation of drawn cuts; none shares code with the models of the product. `benchmarks.force_logs` draws "
    "force logs with offset, drift, lag and noise and fits them; `benchmarks.crashes` plants rapid moves in stock, "
    "short flutes, wide holders and gouges in the shipped jobs. `benchmarks.walls` cuts ten drawn finishing walls with "
    "arm, tool and wall that give; `benchmarks.drilling` holds drills against published figures and a second relation."
)
#: Aims for mean force and moment, for the ripple and for the mean error of a finished wall, as shares.
MEAN_AIM, RIPPLE_AIM, WALL_AIM = 0.03, 0.10, 0.10
LIMITS = (
    "The simulations share the cutting law and its coefficients with the product: they check geometry and mechanics, "
    "not the material.",
    "Chips thin towards what an earlier pass left, and the product's do not: a ball's second pass is 3 % off.",
    "The mean leaves run-out out; the ripple knows it.",
    "Masses and damping of the arms are assumed.",
    "No published force record of incremental forming was found by search, and no later quote of its regression's list "
    "of variables: whether its height is the scallop or the step-down stays open; both are stated, the band has both.",
)


def measure(settings: Settings) -> Findings:
    """Run the eight benchmarks."""
    from benchmarks import drilling, engagement, milling

    del settings
    meets, mills = engagement.compare(), milling.compare()
    walls = run_benchmark("benchmarks.deflected")
    logs = run_benchmark("benchmarks.force_logs", "--logs", 100)
    held = re.search(r"all: ([\d.]+) % held", logs)
    calls = [run_benchmark("benchmarks.stability", "--seed", seed) for seed in (18, 19)]
    made, drilled = run_benchmark("benchmarks.walls").strip(), run_benchmark("benchmarks.drilling").strip()
    crashes = run_benchmark("benchmarks.crashes").strip()
    off = [float(share) / 100.0 for share in re.findall(r"\| ([\d.]+) % \| [\d.]+ %$", made, re.MULTILINE)]
    far = [share for share in off if share > WALL_AIM]
    agree = [float(share) for text in calls for share in re.findall(r"semi-discretisation: ([\d.]+) %", text)]
    worst = re.search(r"worst: ([\d.]+) %", walls)
    force, torque, ripple = (100 * np.nanmax([row[k] for row in mills]) for k in (1, 2, 3))
    volume = 100 * np.nanmax([row[1] for row in meets])
    return Findings(
        (
            f"Mean milling force within {force:.1f} %, moment within {torque:.1f} %, ripple within {ripple:.1f} %; "
            "flat, ball and corner-radius cutters, axes that stand and that swing by 20 degrees, run-out.",
            f"Removed volume within {volume:.1f} % of a sweep of cubes.",
            f"Walls cut by an arm that gives way within {worst[1] if worst else '?'} % of the deviation.",
            f"95 % intervals of coefficients fitted to drawn logs hold {held[1] if held else '?'} % of the truths.",
            f"Chatter is called as the simulation calls it in {min(agree):.1f} % of the drawn cuts or more.",
            f"{crashes.splitlines()[-1]}.",
            f"Finished walls drawn by a seed, beside a simulation in time: {len(off) - len(far)} of {len(off)} within "
            f"{100 * WALL_AIM:.0f} % of their mean error, the worst {100 * max(off):.0f} % off.",
            f"Drills: {drilled.splitlines()[len(drilling.PUBLISHED) + 1]}.",
        ),
        (
            "Engagement, mean differences:\n\n"
            + draw_table(
                ("path", "volume", "axial depth", "radial width"), [(r[0], *map(_share, r[1:])) for r in meets]
            ),
            "Milling, differences:\n\n"
            + draw_table(("cut", "mean force", "moment", "ripple"), [(r[0], *map(_share, r[1:])) for r in mills]),
            "Deflected walls:\n\n```text\n" + walls.strip() + "\n```",
            "Finished walls:\n\n```text\n" + made + "\n```",
            "Drilling:\n\n```text\n" + drilled + "\n```",
            "Force logs:\n\n```text\n" + logs.strip() + "\n```",
            "Planted crashes and gouges:\n\n```text\n" + crashes + "\n```",
            "Chatter:\n\n```text\n" + "\n".join(text.strip() for text in calls) + "\n```",
        ),
        _find_losses(mills) + _count_walls(off, far),
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


def _count_walls(off: list[float], far: list[float]) -> tuple[str, ...]:
    """Say how many walls miss their aim."""
    told = "where teeth are straight the simulation itself moves by 7 % with its step"
    return (f"{len(far)} of {len(off)} finished walls miss the aim of {100 * WALL_AIM:.0f} %; {told}.",) if far else ()


def _share(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"
