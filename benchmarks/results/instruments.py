"""What a dial gauge, a ball bar or sockets bring where there is no tracker, on simulated robots."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.loop import POSES, SEATED, WITH
from benchmarks.loop_page import HELD, Equipment
from benchmarks.results.findings import Findings, Settings, draw_table, run_benchmark
from benchmarks.results.loop import read_rounds

TITLE = "Without a tracker: what do sockets, a dial gauge or a ball bar bring?"
QUESTION = "The same robots are measured with other instruments. How far is the tip off, beside what a tracker brings?"
METHOD = (
    "`python -m benchmarks loop --shops N --seed 1 --with tracker|sockets|dial|ballbar --out DIR` plays N shops of "
    f"[the loop](loop.md) with each instrument. A tracker sees {POSES} poses, the others {SEATED}; `compplan campaign` "
    "designs each. An independent simulation fills in what they read, with 20 µm of noise. Gauges, bars and plates are "
    "put up by hand, 3 mm off per axis; a gauge leans by 2 mrad. Weights hang at the tool, and but for sockets it is "
    "pulled sideways, too. Then one part of path A teaches, measured alike in "
    "all. The figures are true rms deviations across the path; a ratio is to the same shop with the tracker."
)
LIMITS = (
    "Simulated robots, a few shops, circles under a constant force.",
    "The part is measured by points whatever the poses were measured with.",
)
SHOPS, FIRST = 5, 1
#: What is asked: the tip of path A at most so many times as far off as with a tracker.
ASKED = 1.6
#: A band is named where it is wider than so many times what the shipped robot's program is off.
WIDE = 10.0
ROUNDS = {
    "poses_A": "A, poses", "poses_B": "B, poses", "taught_A": "A, one part", "taught_B": "B, one part of A",
}  # fmt: skip


def measure(settings: Settings) -> Findings:
    """Run the shops with every instrument."""
    shops, failed = settings.shops or SHOPS, list[str]()
    for kind in ("tracker", *WITH):
        said = run_benchmark(
            "benchmarks.loop", "--shops", shops, "--seed", FIRST, "--with", kind, "--out", settings.work / kind
        )
        failed += [f"{kind}, shop {line.strip()}." for line in said.splitlines() if " failed: " in line]
    return compare_instruments(settings.work, failed)


def compare_instruments(work: Path, failed: Sequence[str] = ()) -> Findings:
    """Compare what `benchmarks.loop` left of the same shops with every instrument, in folders named after them.

    Args:
        work: Folder of the folders.
        failed: Shops of an instrument that a command ended early, one sentence each; the others are compared.
    """
    played = {
        kind: {shop.seed: shop for shop in read_rounds(work / kind / "rounds.json")} for kind in ("tracker", *WITH)
    }
    seeds = sorted(set.intersection(*(set(shops) for shops in played.values())))
    tracker = [played["tracker"][seed] for seed in seeds]
    head = ["shop", "robot", "instrument"]
    for words in ROUNDS.values():
        head += [f"{words}, mm", "ratio"]
    rows, said, losses = [], list[str](), list[str]()
    for kind, shops in played.items():
        here = [shops[seed] for seed in seeds]
        true, ratio = _true(here), _true(here) / _true(tracker)
        rows += [[s.seed, s.robot, kind, *_pairs(t, r)] for s, t, r in zip(here, true, ratio, strict=True)]
        rows.append(["median", "", kind, *_pairs(np.median(true, axis=0), np.median(ratio, axis=0))])
        if kind == "tracker":
            continue
        middle, worst = np.median(ratio, axis=0), ratio.max(axis=0)
        told = ", ".join(
            f"{words} {m:.2f} (worst {w:.2f})" for words, m, w in zip(ROUNDS.values(), middle, worst, strict=True)
        )
        said.append(f"{kind}: times the tracker's true rms, median: {told}.")
        losses += [
            f"Shop {s.seed}, {kind}: {words} is {r:.2f} times as far off as with a tracker, asked are {ASKED}."
            for s, row in zip(here, ratio, strict=True)
            for words, r in zip(ROUNDS.values(), row, strict=True)
            if r > ASKED
        ]
    losses += [
        f"Shop {s.seed}, {kind}: the widest 95 % band of {words} is {1e3 * s.programs[name].band:.0f} mm."
        for kind, shops in played.items()
        for s in (shops[seed] for seed in seeds)
        for name, words in ROUNDS.items()
        if s.programs[name].band > WIDE * s.programs[name.replace("poses", "nominal").replace("taught", "nominal")].true
    ]
    losses += [
        f"Shop {s.seed}, {kind}: {s.programs[name].held:.0%} of tips are in the 95 % band of {words}."
        for kind, shops in played.items()
        for s in (shops[seed] for seed in seeds)
        for name, words in ROUNDS.items()
        if s.programs[name].held < HELD[0]
    ]
    bare = [_name_bare(kind, [shops[seed] for seed in seeds]) for kind, shops in played.items()]
    losses += failed
    first = f"{len(seeds)} simulated robots, each with {', '.join(played)}; asked: within {ASKED} of the tracker."
    rows.sort(key=lambda row: (row[0] == "median", row[0]))
    return Findings((first, *said), (draw_table(head, rows),), (*losses, *filter(None, bare)))


def _true(shops: Sequence[Equipment]) -> np.ndarray:
    """Return true rms deviations across the path, shop by shop, one column a round. [m]"""
    return np.array([[shop.programs[name].true for name in ROUNDS] for shop in shops])


def _pairs(true: np.ndarray, ratio: np.ndarray) -> list[str]:
    """Write deviations [m] and ratios one after the other."""
    return [text for t, r in zip(true, ratio, strict=True) for text in (f"{1e3 * t:.3f}", f"{r:.2f}")]


def _name_bare(kind: str, shops: Sequence[Equipment]) -> str:
    """Name the shops whose poses left the shipped robot as it was."""
    bare = [str(s.seed) for s in shops if abs(s.programs["poses_A"].true / s.programs["nominal_A"].true - 1.0) < 1e-3]
    if not bare:
        return ""
    return f"{kind}: the poses left path A as far off as the shipped robot has it in shop {', '.join(bare)}."
