"""The page of the loop in virtual shops: the true deviation after every round, and the promise beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compplan.report import figure as go
from compplan.report.page import Block, Chart, Column, PageTable, Provenance, Row, Section, TableCell, write_page
from compplan.report.style import CATEGORIES, format_length, format_percent

#: What is planned with, round after round.
ROUNDS = ("nominal", "12 poses", "1 part", "2 parts")
#: Rms deviations whose ratio is below this are the same.
SAME = 1.001
#: Rounds that the shares count: after the poses and one part.
JUDGED = 2


@dataclass(frozen=True)
class Shop:
    """What happened in one virtual shop.

    Attributes:
        seed: Its seed.
        hidden: What its robot hides.
        true: True rms deviation across the path, by round. [m]
        promised: The 95 % band at its widest that the plan of the round promised. [m]
        paired: The same as `true`, the scatter of the run the same in all rounds. [m]
        as_predicted: The same as `paired` before any part, had the process pushed as predicted. [m]
    """

    seed: int
    hidden: tuple[str, ...]
    true: tuple[float, ...]
    promised: tuple[float, ...]
    paired: tuple[float, ...]
    as_predicted: tuple[float, ...]


def describe_shops(shops: Sequence[Shop], floor: float) -> list[str]:
    """Say how near the noise floor the shops came, and in how many some round was worse than the nominal plan."""
    ratio = np.array([shop.true[JUDGED] / floor for shop in shops])
    near, far = (float(np.mean(ratio <= limit)) for limit in (1.2, 2.0))
    later = [sum(shop.paired[k] > shop.paired[0] * SAME for shop in shops) for k in range(1, len(ROUNDS))]
    poses = sum(shop.as_predicted[1] > shop.as_predicted[0] * SAME for shop in shops)
    same = sum(abs(shop.paired[1] / shop.paired[0] - 1.0) < SAME - 1.0 for shop in shops)
    back = sum(b > 1.2 * max(a, floor) for shop in shops for a, b in zip(shop.true[1:], shop.true[2:], strict=False))
    held = np.mean([[t <= p for t, p in zip(shop.true, shop.promised, strict=True)] for shop in shops])
    return [
        f"{len(shops)} shops, after 12 poses and 1 part: at most 1.2 noise floors in {format_percent(near)}, at most 2"
        f" in {format_percent(far)}, median {np.median(ratio):.2f}; a noise floor is {format_length(floor)}.",
        f"Worse than the nominal plan, the scatter of the run the same: {later[0]} shops after 12 poses ({poses} had"
        f" the process pushed as predicted; {same} cut the nominal program again), {later[1]} after 1 part, {later[2]}"
        f" after 2. Rounds that left more than 1.2 times the round"
        f" before and 1.2 floors: {back}. True rms within the promise: {format_percent(float(held))} of the rounds.",
    ]


def write_loop_page(shops: Sequence[Shop], floor: float, file: Path) -> None:
    """Write the page; `floor` is the noise floor. [m]"""
    told = describe_shops(shops, floor)
    each: list[Block] = [Chart(_draw_rounds(shops, floor), "One line a shop. Dashed: the noise floor.", 420)]
    beside: list[Block] = [
        Chart(_draw_promises(shops), "Every round; below the line the true rms is within the promise.", 420),
        _table(shops, floor),
    ]
    sections = [
        Section("Deviation, round after round", each, "True rms across the path, as a perfect instrument sees it."),
        Section("The promise beside the truth", beside, "Promised: the 95 % band where it is widest, made before."),
    ]
    write_page(
        file, "The loop in virtual shops", told, sections, kind="Benchmark",
        provenance=Provenance([("robot", "MuJoCo, hidden effects drawn from the seed"), ("shops", str(len(shops)))]),
    )  # fmt: skip


def _draw_rounds(shops: Sequence[Shop], floor: float) -> Any:

    figure = go.Figure()
    for number, shop in enumerate(shops):
        line = {"color": CATEGORIES[number % len(CATEGORIES)]}
        values = [1e3 * value for value in shop.true]
        figure.add_trace(go.Scatter(x=ROUNDS, y=values, mode="lines+markers", name=f"shop {shop.seed}", line=line))
    figure.add_hline(y=1e3 * floor, line={"dash": "dash"})
    figure.update_yaxes(type="log", title="true rms, mm")
    return figure


def _draw_promises(shops: Sequence[Shop]) -> Any:

    figure = go.Figure()
    for number, name in enumerate(ROUNDS):
        said, was = ([1e3 * getattr(shop, key)[number] for shop in shops] for key in ("promised", "true"))
        marker = {"color": CATEGORIES[number], "size": 9}
        figure.add_trace(go.Scatter(x=said, y=was, mode="markers", name=name, marker=marker))
    ends = [1e3 * end(shop.true + shop.promised) for end in (min, max) for shop in shops]
    figure.add_trace(go.Scatter(x=[min(ends), max(ends)], y=[min(ends), max(ends)], mode="lines", showlegend=False))
    figure.update_xaxes(type="log", title="promised, mm")
    figure.update_yaxes(type="log", title="true rms, mm")
    return figure


def _table(shops: Sequence[Shop], floor: float) -> PageTable:
    rows: list[Row] = []
    for shop in shops:
        row: Row = [shop.seed]
        for number, (was, said) in enumerate(zip(shop.true, shop.promised, strict=True)):
            good = "good" if was <= 1.2 * floor else "bad" if was > 2 * floor else ""
            row += [TableCell(1e3 * was, good if number == JUDGED else ""), 1e3 * said]
        rows.append([*row, ", ".join(shop.hidden)])
    columns = [Column("shop")]
    for name in ROUNDS:
        columns += [Column(name, "mm"), Column("promised", "mm")]
    return PageTable([*columns, Column("hidden")], rows, "True rms and promise, round by round.", scroll=24)
