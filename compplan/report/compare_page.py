"""The page that sets strategies side by side: a table of strategy and cell, bars, and the deviation along the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.report import figure as go
from compplan.report.along_path import FLOOR, Stations, find_spans
from compplan.report.openings import open_comparison
from compplan.report.page import Block, Chart, Column, Fold, PageTable, Section, TableCell, write_page
from compplan.report.panels import draw_panels, measure_panels
from compplan.report.provenance import describe_grade, describe_robot
from compplan.report.style import (
    CATEGORIES,
    TOLERANCE,
    format_length,
    format_mm,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.robot import Array, Robot

#: What the picture of the first screen shows.
DRAWN_CAPTION = "Bar: every second robot like yours stays below it; tick: 95 of 100 do. Dashed: the tolerance."


@dataclass(frozen=True)
class CompareView:
    """What the page of a comparison shows; n waypoints, base frame.

    Attributes:
        title: Name of the job.
        robot: The robot, with the tool that the job mounts.
        nominal: Wanted tool tip. Shape (n, 3). [m]
        time: Time of each waypoint. Shape (n,). [s]
        cut: Waypoints that are judged. Shape (n,).
        deviation: By cell and strategy, distance of the loaded tip from the path; the first cell is the plan's own
            model. Shape (n,) each. [m]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        drawn: By strategy, rms deviation on robots drawn from what is known: median, and what 95 % stay below. [m]
        drawn_from: What they are drawn from.
        judge: Who computed the deviations.
        facts: Rows of name and value for the foot of the page.
        notes: Warnings, one sentence each.
        assumptions: What was assumed, one sentence each.
    """

    title: str
    robot: Robot
    nominal: Array
    time: Array
    cut: NDArray[np.bool_]
    deviation: Mapping[str, Mapping[str, Array]]
    tolerance: float
    drawn: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    drawn_from: str = ""
    judge: str = ""
    facts: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    assumptions: Sequence[str] = ()

    @property
    def own(self) -> str:
        """The cell in which the plan's own model is the truth."""
        return next(iter(self.deviation))

    @property
    def wrong(self) -> list[str]:
        """The cells that the model is wrong about."""
        return list(self.deviation)[1:]

    @property
    def strategies(self) -> list[str]:
        """Names of the strategies, in the order given."""
        return list(next(iter(self.deviation.values())))

    @property
    def left(self) -> dict[str, tuple[float, float]]:
        """By strategy: rms deviation on drawn robots, median and what 95 % stay below; else rms and largest. [m]."""
        return {
            name: self.drawn.get(name, (self.rms(self.own, name), self.largest(self.own, name)))
            for name in self.strategies
        }

    def rms(self, cell: str, strategy: str) -> float:
        """Root mean square of the deviation over the cut [m]."""
        return float(np.sqrt(np.mean(self.deviation[cell][strategy][self.cut] ** 2)))

    def largest(self, cell: str, strategy: str) -> float:
        """Largest deviation over the cut [m]."""
        return float(self.deviation[cell][strategy][self.cut].max())


def write_comparison(view: CompareView, file: Path) -> None:
    """Write the page of a comparison.

    Args:
        view: What it shows.
        file: The HTML file.
    """
    facts = [("deviation computed by", view.judge or "–"), *view.facts]
    write_page(
        file,
        view.title,
        describe_comparison(view),
        [_figures(view), _along(view)],
        kind=f"Strategies compared, {view.robot.name}",
        opening=open_comparison(
            {name: pair[0] for name, pair in view.left.items()}, {name: pair[1] for name, pair in view.left.items()},
            view.tolerance, drawn=bool(view.drawn),
            picture=Chart(_draw_left(view), DRAWN_CAPTION, 90 + 46 * len(view.strategies)),
        ),
        notes=view.notes,
        provenance=describe_robot(view.robot, facts, list(view.assumptions)),
    )


def describe_comparison(view: CompareView) -> str:
    """Say in two sentences which strategy comes closest, in the modelled cell and where the model is wrong."""
    own, wrong = view.own, view.wrong
    best = [name for name in view.strategies if _is_closest(view, own, name)]
    text = _describe_drawn(view)
    if wrong:
        worst = {name: max(view.rms(cell, name) for cell in wrong) for name in view.strategies}
        closest = min(worst, key=lambda name: worst[name])
        equals = [name for name in view.strategies if worst[name] <= 1.02 * worst[closest]]
        text += f"Where the model is wrong ({', '.join(wrong)}), {_join_names(equals)} {_come(equals)} closest: "
        text += f"up to {format_length(worst[closest])} rms"
        if "none" in worst and "none" not in equals:
            text += f", against {format_length(worst['none'])} without correction"
        text += ". "
    text += f"Where the robot is {own}, {_join_names(best)} {_come(best)} closest: "
    text += f"{format_length(view.rms(own, best[0]))} rms"
    if "none" in view.strategies and "none" not in best:
        text += f", against {format_length(view.rms(own, 'none'))} without correction"
    return f"{text}. {describe_grade(view.robot)}"


def _describe_drawn(view: CompareView) -> str:
    if not view.drawn:
        return ""
    least = min(median for median, _ in view.drawn.values())
    equals = [name for name, (median, _) in view.drawn.items() if median <= 1.02 * least]
    most = max(view.drawn[name][1] for name in equals)
    text = f"On robots drawn from what is known of this one, {_join_names(equals)} {_come(equals)} closest: "
    text += f"{format_length(least)} rms in the median, {format_length(most)} in 95 %"
    if "none" in view.drawn and "none" not in equals:
        text += f", against {format_length(view.drawn['none'][0])} and {format_length(view.drawn['none'][1])} without"
        text += " correction"
    return f"{text}. "


def _come(names: list[str]) -> str:
    return "comes" if len(names) == 1 else "come"


def _join_names(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _figures(view: CompareView) -> Section:
    blocks: list[Block] = [_matrix(view)]
    cells = view.wrong or [view.own]
    height = 90 + (34 + 16 * len(view.strategies)) * len(cells)
    caption = "Bars: rms deviation; ticks: largest deviation; dashed: the tolerance."
    blocks.append(Chart(_bars(view, cells), caption, height=height))
    lede = "A strategy is worth what it leaves where the model is wrong: no model is right." if view.wrong else ""
    return Section("Strategies and cells", [*blocks, Fold("All figures", [_long_table(view)])], lede)


def _is_closest(view: CompareView, cell: str, strategy: str) -> bool:
    best = min(view.rms(cell, name) for name in view.strategies)
    return view.rms(cell, strategy) <= max(1.02 * best, FLOOR)


def _matrix(view: CompareView) -> PageTable:
    rows: list[list[TableCell | str | float | int | None]] = []
    for name in view.strategies:
        row: list[TableCell | str | float | int | None] = [TableCell(name, "strong")]
        if view.drawn:
            median, most = view.drawn[name]
            close = median <= 1.02 * min(least for least, _ in view.drawn.values())
            row.append(TableCell(f"{format_length(median)}  ({format_length(most)})", "good" if close else ""))
        for cell in (*view.wrong, view.own):
            text = f"{format_length(view.rms(cell, name))}  ({format_length(view.largest(cell, name))})"
            row.append(TableCell(text, "good" if _is_closest(view, cell, name) else ""))
        rows.append(row)
    first = [Column("robots drawn from what is known")] if view.drawn else []
    columns = [Column("strategy"), *first, *(Column(cell) for cell in (*view.wrong, view.own))]
    caption = "Deviation of the loaded tool tip from the path: rms (largest); the closest of each cell is green."
    if view.drawn:
        caption += f" Drawn robots: rms, median (what 95 % stay below); {view.drawn_from}."
    return PageTable(columns, rows, caption)


def _long_table(view: CompareView) -> PageTable:
    rows: list[list[TableCell | str | float | int | None]] = []
    for cell, results in view.deviation.items():
        for name in results:
            size = results[name][view.cut]
            left = view.rms(cell, name) / view.rms(cell, "none") if "none" in results else float("nan")
            lengths = [format_length(value) for value in (view.rms(cell, name), float(size.mean()), float(size.max()))]
            within = format_percent(float((size <= view.tolerance).mean()))
            rows.append([cell, name, *lengths, format_percent(left), within])
    within = f"within {format_set_value(1e3 * view.tolerance)} mm"
    titles = ("cell", "strategy", "rms", "mean", "largest", "of uncorrected", within)
    return PageTable([Column(title) for title in titles], rows)


def _bars(view: CompareView, cells: Sequence[str]) -> Any:

    figure = go.Figure()
    names = [name.replace("_", " ") for name in view.strategies]
    for number, cell in enumerate(cells):
        rms = [1e3 * view.rms(cell, name) for name in view.strategies]
        largest = [1e3 * view.largest(cell, name) for name in view.strategies]
        colour = CATEGORIES[number % len(CATEGORIES)]
        ticks = {
            "type": "data",
            "array": [most - mean for most, mean in zip(largest, rms, strict=True)],
            "arrayminus": [0.0] * len(rms),
            "thickness": 1.2,
            "width": 4,
            "color": colour,
        }
        figure.add_bar(
            y=names, x=rms, name=cell, orientation="h", marker_color=colour, error_x=ticks, customdata=largest,
            hovertemplate="%{x:.3g} mm rms, %{customdata:.3g} mm at most",
        )  # fmt: skip
    figure.update_xaxes(title_text="deviation, mm", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    figure.add_vline(x=1e3 * view.tolerance, line={"color": TOLERANCE, "width": 1.4, "dash": "dash"})
    figure.update_layout(barmode="group", bargap=0.28, legend={"traceorder": "normal"})
    return figure


def _draw_left(view: CompareView) -> Any:
    """Draw what each strategy leaves on robots that may be the user's."""
    names = view.strategies
    left = view.left
    middle = [1e3 * left[name][0] for name in names]
    most = [1e3 * max(left[name][1] - left[name][0], 0.0) for name in names]
    figure = go.Figure(go.Bar(
        y=[f"{name.replace('_', ' ')}: {format_mm(left[name][0])}" for name in names], x=middle, orientation="h",
        marker_color=CATEGORIES[0],
        error_x={"type": "data", "array": most, "arrayminus": [0.0] * len(most), "thickness": 1.6, "width": 6},
        hovertemplate="%{x:.3g} mm<extra></extra>",
    ))  # fmt: skip
    figure.update_xaxes(title_text="deviation, rms, mm", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    figure.add_vline(x=1e3 * view.tolerance, line={"color": TOLERANCE, "width": 1.6, "dash": "dash"})
    return figure


def _along(view: CompareView) -> Section:
    steps = np.linalg.norm(np.diff(view.nominal, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    spans = find_spans(~view.cut)
    last = np.minimum(spans[:, 1] + 1, len(length) - 1)  # the point of contact ends a rapid move
    shaded = length[np.column_stack([np.maximum(spans[:, 0] - 1, 0), last]).astype(int)].reshape(-1, 2)
    stations = Stations(length, view.time, np.zeros(0, int), shaded)
    judged = np.where(view.cut, 1.0, np.nan)
    cells = (*view.wrong, view.own)
    panels = {
        name.replace("_", " "): {cell: 1e3 * view.deviation[cell][name] * judged for cell in cells}
        for name in view.strategies
    }
    figure = draw_panels(stations, panels, tolerance=1e3 * view.tolerance)
    caption = f"One chart a strategy, all with the same axes; dashed: tolerance {format_set_length(view.tolerance)}."
    chart = Chart(figure, caption, height=measure_panels(len(panels)), along=True)
    return Section("Along the path", [chart], "Distance of the loaded tool tip from the path.")
