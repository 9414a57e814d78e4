"""The loop from poses over a first part to the next program, on simulated robots."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.loop import FLOOR
from benchmarks.loop_page import FLOORS, HELD, ROUNDS, WIDE, WORSE, Program, ShopResult, describe_shops
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "The loop: what do poses and a first part bring?"
QUESTION = "A robot hides three errors and the force is not the predicted one. How far is each program's tip off?"
METHOD = (
    "`python -m benchmarks loop` ([commands](../first_part.md)): MuJoCo robots with three hidden effects, every third "
    "with one in no vocabulary, everyday errors of every axis, frames that the product does not know; it sees programs "
    "in and measurements out. Path B lies elsewhere. True rms deviation across the path, the force that of the shop; "
    "bands are held against parts whose force is drawn anew by 7 %. So is that of the part that teaches: a noise floor "
    "counts instrument, robot, clamping, and what that moves."
)
LIMITS = ("Simulated robots, five kinds; circles under a constant force.",)
SHOPS, FIRST = 40, 0


def measure(settings: Settings) -> Findings:
    """Run the shops."""
    asked = settings.shops or SHOPS
    run_benchmark("benchmarks.loop", "--shops", asked, "--seed", FIRST, "--out", settings.work)
    shops = read_rounds(settings.work / "rounds.json")
    true = 1e3 * np.array([[shop.programs[name].true for name in ROUNDS] for shop in shops])
    rows = [(s.seed, s.robot, *(f"{x:.3f}" for x in t), ", ".join(s.hidden)) for s, t in zip(shops, true, strict=True)]
    middle = [f"{x:.3f}" for x in np.median(true, axis=0)]
    head = ("shop", "robot", *(f"{words}, mm" for words in ROUNDS.values()), "hidden")
    table = draw_table(head, [*rows, ("median", "", *middle, "")])
    named = dict(zip(ROUNDS, middle, strict=True))
    said = (
        f"Median over {len(shops)} simulated robots, path A: nominal {named['nominal_A']} mm, after 12 poses"
        f" {named['poses_A']} mm, after one part {named['taught_A']} mm. Path B: nominal {named['nominal_B']} mm, after"
        f" 12 poses {named['poses_B']} mm, after one part of A {named['taught_B']} mm."
    )
    left = [f"{len(shops)} of {asked} shops: the others were not run, or a command ended with another status than 0."]
    losses = (*left * (len(shops) < asked), *_fall_short(shops))
    return Findings((said, *describe_shops(shops, FLOOR)), (table,), losses)


def read_rounds(file: Path) -> list[ShopResult]:
    """Read the shops that `benchmarks.loop` wrote."""
    return [
        ShopResult(t["seed"], t["robot"], tuple(t["hidden"]), {k: Program(**p) for k, p in t["programs"].items()})
        for t in json.loads(file.read_text("utf-8"))
    ]


def _fall_short(shops: list[ShopResult]) -> list[str]:
    """Say which shops fall short after one part: A above its noise floors, bands that hold too few or are too wide."""
    said = []
    for shop in shops:
        a, b = shop.programs["taught_A"], shop.programs["taught_B"]
        if a.true > FLOORS * a.floor:
            off = f"{a.true / a.floor:.1f} noise floors off, asked are {FLOORS}"
            said.append(f"Shop {shop.seed}: after one part A is {off}.")
        before = shop.programs["poses_B"]
        if b.true > WORSE * before.true:
            said.append(
                f"Shop {shop.seed}: B after one part is {1e3 * b.true:.3f} mm off, after poses alone"
                f" {1e3 * before.true:.3f} mm, {before.true / before.floor:.1f} noise floors."
            )
        for name, part in (("A", a), ("B", b)):
            if part.held < HELD[0] or part.band > WIDE * part.point:
                said.append(
                    f"Shop {shop.seed}: the band of {name} after one part holds {part.held:.0%} of tips and is"
                    f" {part.band / part.point:.1f} times the true 95 % point at its widest."
                )
    return [*said, *_lose_by_poses(shops)]


def _lose_by_poses(shops: list[ShopResult]) -> list[str]:
    """Say where poses alone left a path farther off than the shipped folder, and where the force alone is why."""
    said = []
    for path in "AB":
        pairs = [(s.seed, s.programs[f"nominal_{path}"], s.programs[f"poses_{path}"]) for s in shops]
        lost = [(seed, before, after) for seed, before, after in pairs if after.true > WORSE * before.true]
        if not lost:
            continue
        calm = [seed for seed, before, after in lost if after.calm <= WORSE * before.calm]
        named = ", ".join(str(seed) for seed, _, _ in lost)
        tail = (
            f"; under the force that was predicted it is not in {', '.join(map(str, calm))}: there the shipped folder's"
            " error makes up for part of the force's, which no pose shows"
        ) * bool(calm)
        said.append(
            f"After 12 poses alone path {path} is farther off than with the shipped folder in {len(lost)} of"
            f" {len(shops)} shops ({named}){tail}."
        )
    return said
