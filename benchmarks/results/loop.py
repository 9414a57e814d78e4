"""The loop from poses over a first part to the next program, on simulated robots."""

from __future__ import annotations

import json

import numpy as np

from benchmarks.loop_page import ROUNDS
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark

TITLE = "The loop: what do poses and a first part bring?"
QUESTION = "A robot hides three errors and the force is not the predicted one. How far is each program's tip off?"
METHOD = (
    "`python -m benchmarks.loop` ([commands](../first_part.md)): MuJoCo robots with three hidden effects, every third "
    "with one in no vocabulary; the product sees programs in and measurements out. True rms deviation across the path, "
    "circle of 240 mm, KUKA KR 270."
)
LIMITS = (
    "Simulated robots: exact clamping, known frames, one path, one robot.",
    "The first part and the next are the same part. A different next part gains less.",
)
SHOPS, FIRST = 8, 60


def measure(settings: Settings) -> Findings:
    """Run the shops."""
    run_benchmark("benchmarks.loop", "--shops", SHOPS, "--seed", FIRST, "--out", settings.work)
    shops = json.loads((settings.work / "rounds.json").read_text("utf-8"))
    true = 1e3 * np.array([shop["true"] for shop in shops])
    worse = int((true[:, 1] > 1.001 * true[:, 0]).sum())
    held = np.mean([[t <= p for t, p in zip(s["true"], s["promised"], strict=True)] for s in shops])
    rows = [(s["seed"], *(f"{x:.3f}" for x in t), ", ".join(s["hidden"])) for s, t in zip(shops, true, strict=True)]
    middle = [f"{x:.3f}" for x in np.median(true, axis=0)]
    table = draw_table(("robot", *(f"{name}, mm" for name in ROUNDS), "hidden"), [*rows, ("median", *middle, "")])
    return Findings(
        (
            f"Median over {len(shops)} simulated robots: nominal {middle[0]} mm, after 12 poses {middle[1]} mm, "
            f"after one part "
            f"{middle[2]} mm.",
            f"The true rms lies within the 95 % band in {100 * held:.0f} % of the programs.",
        ),
        (table,),
        (f"After twelve poses alone, {worse} of {len(shops)} robots are not better than before (scatter of the run "
         "included).",),
    )  # fmt: skip
