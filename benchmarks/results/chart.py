"""The chart at the head of a page of results, drawn from a table in markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class Chart:
    """What a chart shows."""

    label: str  #: Title of the axis, with unit.
    #: Name of each series; title of its column, and which number of a cell counts (from 0).
    series: Mapping[str, tuple[str, int]]
    log: bool = False  #: Logarithmic axis.
    rows: int | None = None  #: Number of rows that are drawn, from the top; None: all.


def read_table(text: str) -> tuple[list[str], list[list[str]]]:
    """Return titles and cells of the first table of a text in markdown."""
    block = re.search(r"(?m)^\|.*\n\|[-| ]+\|\n(?:\|.*\n?)*", text)
    assert block is not None
    lines = [[cell.strip(" `") for cell in line.strip().strip("|").split("|")] for line in block[0].splitlines()]
    return lines[0], lines[2:]


def draw_chart(text: str, chart: Chart, file: Path) -> None:
    """Draw the rows of the first table of a text as a dot plot, one line a row and one colour a series."""
    titles, cells = read_table(text)
    cells = cells[: chart.rows]
    figure, axes = plt.subplots(figsize=(7.2, 1.1 + 0.21 * len(cells)))
    for k, (name, (title, which)) in enumerate(chart.series.items()):
        column = titles.index(title)
        points = [(NUMBER.findall(row[column])[which:], -i) for i, row in enumerate(cells)]
        known = [(float(numbers[0]), y) for numbers, y in points if numbers]
        axes.scatter(*zip(*known, strict=True), s=30, color=f"C{k}", alpha=0.85, label=name, zorder=3)
    axes.set_yticks([-i for i in range(len(cells))], [row[0] for row in cells], fontsize=8)
    if chart.log:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(chart.label)
    axes.grid(axis="both", alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(chart.series), frameon=False, fontsize=8)
    figure.tight_layout()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)
