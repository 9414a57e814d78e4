"""The loop from poses over a first part to the next program, on simulated robots."""

from __future__ import annotations

import json

import numpy as np

from benchmarks.loop import FLOOR
from benchmarks.loop_page import ROUNDS, Program, Shop, describe_shops
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "The loop: what do poses and a first part bring?"
QUESTION = "A robot hides three errors and the force is not the predicted one. How far is each program's tip off?"
METHOD = (
    "`python -m benchmarks.loop` ([commands](../first_part.md)): MuJoCo robots with three hidden effects, every third "
    "with one in no vocabulary, everyday errors of every axis, frames that the product does not know; it sees programs "
    "in and measurements out. Path B lies elsewhere. True rms deviation across the path, the force that of the shop; "
    "bands are held against parts whose force is drawn anew by 7 %."
)
LIMITS = ("Simulated robots, five kinds; circles under a constant force.",)
SHOPS, FIRST = 40, 0


def measure(settings: Settings) -> Findings:
    """Run the shops."""
    run_benchmark("benchmarks.loop", "--shops", SHOPS, "--seed", FIRST, "--out", settings.work)
    tables = json.loads((settings.work / "rounds.json").read_text("utf-8"))
    shops = [
        Shop(t["seed"], t["robot"], tuple(t["hidden"]), {k: Program(**p) for k, p in t["programs"].items()})
        for t in tables
    ]
    true = 1e3 * np.array([[shop.programs[name].true for name in ROUNDS] for shop in shops])
    rows = [(s.seed, s.robot, *(f"{x:.3f}" for x in t), ", ".join(s.hidden)) for s, t in zip(shops, true, strict=True)]
    middle = [f"{x:.3f}" for x in np.median(true, axis=0)]
    head = ("shop", "robot", *(f"{words}, mm" for words in ROUNDS.values()), "hidden")
    table = draw_table(head, [*rows, ("median", "", *middle, "")])
    first, *rest = describe_shops(shops, FLOOR)
    left = (f"{SHOPS - len(shops)} of {SHOPS} shops failed: a command ended with another status than 0.",)
    return Findings((first, *rest), (table,), left if len(shops) < SHOPS else ())
