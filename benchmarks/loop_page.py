"""The page of the loop in virtual shops: what every program left of path A and path B, and the band beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.io.palette import CATEGORIES
from compplan.io.quantities import format_length, format_percent
from compplan.io.tables import write_text
from compplan.reporting.charts import Figure
from compplan.reporting.page import Block, Cell, Chart, DataTable, Provenance, Section, Summary, render_page

#: Programs of a shop, by folder, and what people call them.
ROUNDS = {
    "nominal_A": "A nominal", "nominal_B": "B nominal", "poses_A": "A, 12 poses", "poses_B": "B, 12 poses",
    "taught_A": "A, one part", "taught_B": "B, one part of A",
}  # fmt: skip
#: What is asked: noise floors of A, ratio of B to poses alone, floors of B and their share, held tips, width of a band.
FLOORS, BETTER, WORSE, SECOND, HELD, WIDE = 1.2, 0.55, 1.05, 1.5, (0.93, 0.97), 1.6


@dataclass(frozen=True)
class Program:
    """A program on the true robot."""

    true: float  #: Median over parts of the shop's own force of the true rms deviation across the path. [m]
    whole: float  #: The same in 3D, along the path too. [m]
    band: float  #: The 95 % band at its widest. [m]
    point: float  #: What 95 % of the parts keep within where they stray most, 3D. [m]
    held: float  #: Share of tips within the band, all parts and places.
    floor: float  #: Noise floor, what a part's own force moves in it. [m]
    calm: float  #: True rms across the path as `true`, but under the force that was predicted. [m]


@dataclass(frozen=True)
class ShopResult:
    """What happened in one virtual shop: its seed, robot and hidden causes, and its programs by folder."""

    seed: int
    robot: str
    hidden: tuple[str, ...]
    programs: Mapping[str, Program]


def describe_shops(shops: Sequence[ShopResult], floor: float) -> list[str]:
    """Say how the shops stand beside what is asked; `floor` is the noise floor without a part's own force. [m]"""
    true = {name: np.array([shop.programs[name].true for shop in shops]) for name in ROUNDS}
    own = {name: np.array([shop.programs[name].floor for shop in shops]) for name in ROUNDS}
    a, b = (true[name] / own[name] for name in ("taught_A", "taught_B"))
    plain = [format_percent(float(np.mean(true[f"taught_{path}"] <= most * floor)))
             for path, most in (("A", FLOORS), ("B", SECOND))]  # fmt: skip
    solid = np.mean([s.programs["taught_A"].whole <= FLOORS * s.programs["taught_A"].floor for s in shops])
    ratio = true["taught_B"] / true["poses_B"]
    near, second = float(np.mean(a <= FLOORS)), float(np.mean(b <= SECOND))
    scatter = format_length(float(np.median(own["taught_A"])))
    worse = [int((true[f"taught_{path}"] > 1.001 * true[f"nominal_{path}"]).sum()) for path in "AB"]
    return [
        f"Path A after one part: at most {FLOORS} noise floors off across the path in {format_percent(near)} (asked:"
        f" 95 %), {plain[0]} if the force is left out of the floor, median {np.median(a):.2f}; in 3D in"
        f" {format_percent(float(solid))} (asked: 90 %), {worse[0]} worse than nominal. Noise floor: instrument,"
        f" robot and clamping {format_length(floor)}, with force scatter {scatter}.",
        f"Path B after one part of A: {np.median(ratio):.2f} of after poses alone in the median (asked: at most"
        f" {BETTER}), {ratio.max():.2f} in the worst (asked: {WORSE}), {int((ratio > WORSE).sum())} above that; at most"
        f" {SECOND} noise floors in {format_percent(second)} (asked: 60 %), {plain[1]} if the force is left out;"
        f" {worse[1]} worse than nominal.",
    ]


def write_loop_page(shops: Sequence[ShopResult], floor: float, file: Path) -> None:
    """Write the page; `floor` is the noise floor. [m]"""
    each: list[Block] = [
        Chart(_draw(shops, "poses", "taught"), "Below the line one part of A helped.", 420), _table(shops)
    ]  # fmt: skip
    sections = [Section("Poses alone, and one part", each, "True rms across the path, median over drawn parts.")]
    origin = Provenance([("robot", "MuJoCo, hidden effects drawn from the seed"), ("shops", str(len(shops)))])
    said = describe_shops(shops, floor)
    opening = Summary(said[0].partition(". ")[0] + ".")
    html = render_page(
        "The loop in virtual shops", opening, sections, kind="Benchmark", answers=said, provenance=origin
    )
    write_text(file, html)


def _draw(shops: Sequence[ShopResult], before: str, after: str) -> Figure:
    figure = Figure()
    ends = []
    for number, path in enumerate("AB"):
        x, y = ([1e3 * shop.programs[f"{one}_{path}"].true for shop in shops] for one in (before, after))
        ends += [*x, *y]
        marker = {"color": CATEGORIES[number], "size": 9}
        figure.line(x, y, f"path {path}", mode="markers", marker=marker)
    line = [min(ends), max(ends)]
    figure.line(line, line, showlegend=False)
    figure.axis("x", type="log", title="after 12 poses, mm")
    figure.axis("y", type="log", title="after one part of A, mm")
    return figure


def _table(shops: Sequence[ShopResult]) -> DataTable:
    rows = []
    for shop in shops:
        row: list[Any] = [shop.seed, shop.robot]
        for name, program in shop.programs.items():
            after = shop.programs.get(name.replace("taught", "poses"), program)
            bad = name == "taught_B" and program.true > WORSE * after.true
            good = name.startswith("taught") and program.true <= SECOND * program.floor
            mark = "bad" if bad else "good" if good else ""
            row += [Cell(1e3 * program.true, mark), 1e3 * program.band, f"{program.held:.0%}"]
        rows.append([*row, ", ".join(shop.hidden)])
    columns = ["shop", "robot"]
    for words in ROUNDS.values():
        columns += [f"{words} [mm]", "band [mm]", "held"]
    return DataTable([*columns, "hidden"], rows, "True rms, widest band, share of tips held.", scroll=24)
