"""The loop from poses over a first part to the next program, on simulated robots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.loop import (
    FLOOR,
    FLOORS,
    HELD,
    ROUNDS,
    WIDE,
    WORSE,
    Program,
    ShopResult,
    describe_shops,
    draw_part,
)  # fmt: skip
from benchmarks.results.chart import Chart
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark
from benchmarks.shop import SCATTER

TITLE = "The loop: what do poses and a first part bring?"
QUESTION = "A robot hides three errors and the force is not the predicted one. How far is each program's tip off?"
METHOD = (
    "`python -m benchmarks loop`: MuJoCo robots with three hidden effects, every third with one outside the "
    "vocabulary, small errors on every axis and unknown frames; compplan gets programs and measurements only. "
    "Path B lies elsewhere. The robot touches both parts off before the force acts. True rms deviation across the path "
    "under the shop's own force. Bands are compared with "
    "parts whose force scatters by 7 %, as does that of the measured part. A noise floor counts instrument, robot, "
    "clamping and that scatter. Every shop: [loop.csv](loop.csv)."
)
CHART = Chart("true rms across path A, mm", {
    words: (f"{words}, mm", 0) for words in ("A nominal", "A, 12 poses", "A, one part")
}, log=True)  # fmt: skip
LIMITS = (
    "Simulated robots, five kinds; circles under a constant force. Jobs with joint programs alone.",
    "On shops drawn from the uncertainty after poses, the best linear estimate leaves path B at 0.59 of poses alone"
    " (median of 20, standard deviation 0.09), 3 above 1.05, at most 1.7; the band of A holds at least 76 %."
    " (Computed once, not by this command.)",
    "Poses do not see the force: robot and force errors that cancel in the shipped folder no longer do.",
    "The points of the part have no s_mm, so the error along the path is not measured.",
)
SHOPS, FIRST = 40, 0


def measure(settings: Settings) -> Findings:
    """Run the shops."""
    asked = settings.shops or SHOPS
    run_benchmark("benchmarks.loop", "--shops", asked, "--seed", FIRST, "--out", settings.work)
    shops = read_rounds(settings.work / "rounds.json")
    true = 1e3 * np.array([[shop.programs[name].true for name in ROUNDS] for shop in shops])
    rows = [(f"{s.seed} {s.robot}", *(f"{x:.3f}" for x in t)) for s, t in zip(shops, true, strict=True)]
    head = ("shop", *(f"{words}, mm" for words in ROUNDS.values()))
    middle = [f"{x:.3f}" for x in np.median(true, axis=0)]
    robots = {robot: [s.robot == robot for s in shops] for robot in dict.fromkeys(s.robot for s in shops)}
    medians = [(robot, *(f"{x:.3f}" for x in np.median(true[own], axis=0))) for robot, own in robots.items()]
    table = draw_table(("median", *head[1:]), [*medians, ("all", *middle)])
    named = dict(zip(ROUNDS, middle, strict=True))
    said = (
        f"Median over {len(shops)} simulated robots, path A: nominal {named['nominal_A']} mm, after 12 poses"
        f" {named['poses_A']} mm, after one part {named['taught_A']} mm. Path B: nominal {named['nominal_B']} mm, after"
        f" 12 poses {named['poses_B']} mm, after one part of A {named['taught_B']} mm."
    )
    left = [f"{len(shops)} of {asked} shops: the others were not run, or a command ended with another status than 0."]
    losses = (*left * (len(shops) < asked), *_fall_short(shops))
    return Findings((said, *describe_shops(shops, FLOOR)), (table, table_bands(shops)), losses, draw_table(head, rows))


def read_rounds(file: Path) -> list[ShopResult]:
    """Read the shops that `benchmarks.loop` wrote."""
    return [
        ShopResult(t["seed"], t["robot"], tuple(t["hidden"]), {k: Program(**p) for k, p in t["programs"].items()})
        for t in json.loads(file.read_text("utf-8"))
    ]


def table_bands(shops: list[ShopResult]) -> str:
    """Return how many tips the band of each program holds, and how wide it is."""
    rows = []
    for name, words in ROUNDS.items():
        programs = [shop.programs[name] for shop in shops]
        held = [program.held for program in programs]
        wide = np.median([program.band / program.point for program in programs])
        rows.append((words, f"{np.mean(held):.1%}", f"{min(held):.0%}", f"{wide:.2f}"))
    aims = (f"tips held (aim {HELD[0]:.0%} to {HELD[1]:.0%})", "in the worst shop", f"band over true 95 % (aim {WIDE})")
    return draw_table(("program", *aims), rows)


def _fall_short(shops: list[ShopResult]) -> list[str]:
    """Count the shops that fall short after one part: A above its noise floors, bands too narrow or too wide."""
    far = {s.seed: s.programs["taught_A"].true / s.programs["taught_A"].floor for s in shops}
    said = _count(f"Path A after one part: more than {FLOORS} noise floors off", far, FLOORS)
    worse = {s.seed: s.programs["taught_B"].true / s.programs["poses_B"].true for s in shops}
    said += _count(f"Path B after one part of A: more than {WORSE} times the error after poses alone", worse, WORSE)
    own = [f"{seed}: {SCATTER * draw_part(seed).standard_normal():+.1%}" for seed in worse if worse[seed] > WORSE]
    if own:
        said.append(f"Own force of the parts measured there (scatter {SCATTER:.0%}): {', '.join(own)}.")
    for path in "AB":
        parts = {s.seed: s.programs[f"taught_{path}"] for s in shops}
        few = [part.held for part in parts.values() if part.held < HELD[0]]
        if few:
            aim = f"fewer tips than {HELD[0]:.0%}"
            said.append(f"The band of {path} after one part holds {aim} in {len(few)} shops, at least {min(few):.0%}.")
        wide = {seed: part.band / part.point for seed, part in parts.items()}
        said += _count(f"The band of {path} after one part is wider than {WIDE} true 95 % points", wide, WIDE)
        two = {s.seed: [vars(s.programs[f"{name}_{path}"]) for name in ("poses", "nominal")] for s in shops}
        for force, key in (("", "true"), (", predicted force", "predicted")):
            worse = {seed: poses[key] / nominal[key] for seed, (poses, nominal) in two.items()}
            said += _count(f"Path {path} after poses{force}: above {WORSE} times the shipped one", worse, WORSE)
    return said


def _count(words: str, ratios: dict[int, float], most: float) -> list[str]:
    """Say in how many shops a ratio is beyond its limit, which, and the greatest ratio."""
    beyond = {seed: ratio for seed, ratio in ratios.items() if ratio > most}
    seeds = f" ({', '.join(map(str, beyond))})" if len(beyond) <= 5 else ""
    return [f"{words} in {len(beyond)} shops{seeds}; at most {max(beyond.values()):.1f}."] if beyond else []
