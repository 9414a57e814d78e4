"""The page that sets strategies side by side: a table of strategy and cell, bars, and the deviation along the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.job.names import ONLINE
from compplan.reporting import figure as go
from compplan.reporting.along_path import FLOOR, place_stations
from compplan.reporting.page import Block, Chart, Column, Fold, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.panels import draw_panels, measure_panels
from compplan.reporting.provenance import describe_grade, describe_robot, list_assumptions
from compplan.reporting.strategy_text import colour_strategies, name_strategy
from compplan.reporting.style import (
    CATEGORIES,
    TOLERANCE,
    format_length,
    format_mm,
    format_percent,
    format_set_length,
    format_set_value,
)
from compplan.reporting.summaries import choose_best, join_names, open_comparison

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison
    from compplan.planning.evaluate import Evaluation

#: What the picture of the first screen shows.
DRAWN_CAPTION = "Bar: every second robot like yours stays below it; tick: 95 of 100 do. Dashed: the tolerance."


def write_compare_page(comparison: Comparison, file: Path) -> None:
    """Write the page of a comparison.

    Args:
        comparison: The comparison.
        file: The HTML file.

    Raises:
        InputError: If the folder cannot be written.
    """
    left, task = find_left(comparison), comparison.task
    planned = {name: pair for name, pair in left.items() if name not in ONLINE}
    job = [] if comparison.job is None else [("job", str(comparison.job.file))]
    facts = [("deviation computed by", comparison.judge), *job,
             ("toolpath", task.nominal.source or "given in memory")]  # fmt: skip
    others, assumptions = list_wrong(comparison), list_assumptions(comparison.job)
    if others:
        assumptions.append(f"cells: {', '.join(others)}: what the model may be wrong by is assumed, not measured")
    notes = [
        f"{name} is infeasible: {len(command.failures)} waypoints fail "
        f"({', '.join(sorted(set(command.failures.values())))}); its best compromise is shown."
        for name, command in comparison.commands.items() if command.status == "infeasible"
    ]  # fmt: skip
    write_page(
        file,
        comparison.name,
        describe_comparison(comparison),
        [_figures(comparison), _along(comparison)],
        kind=f"Strategies compared, {task.robot.name}",
        opening=open_comparison(
            {name: pair[0] for name, pair in planned.items()}, {name: pair[1] for name, pair in planned.items()},
            task.tolerance, drawn=comparison.drawn is not None,
            picture=Chart(_draw_left(comparison), DRAWN_CAPTION, 90 + 46 * len(left)),
        ),
        notes=notes,
        provenance=describe_robot(task.robot, facts, assumptions),
    )  # fmt: skip


def find_left(comparison: Comparison) -> dict[str, tuple[float, float]]:
    """Return by strategy median and 95 % of the rms deviation on drawn robots; without them rms and largest. [m]"""
    drawn = comparison.drawn
    if drawn is not None:
        return {name: (drawn.median(name), drawn.most(name)) for name in drawn.rms}
    return {name: (run.rms_deviation, run.max_deviation) for name, run in _own(comparison).items()}


def list_wrong(comparison: Comparison) -> list[str]:
    """List the cells that the model is wrong about."""
    return [cell.name for cell in comparison.cells[1:]]


def _own(comparison: Comparison) -> Mapping[str, Evaluation]:
    """Return the runs in the cell in which the plan's own model is the truth."""
    return comparison.evaluations[comparison.cells[0].name]


def describe_comparison(comparison: Comparison) -> str:
    """Say which strategy comes closest: on drawn robots, where the model is wrong, and where it is right."""
    own, runs = comparison.cells[0].name, _own(comparison)
    wrong = list_wrong(comparison)
    text = _describe_drawn(comparison)
    if wrong:
        named = ", ".join(wrong)
        worst = {name: max(comparison.evaluations[cell][name].rms_deviation for cell in wrong) for name in runs}
        text += f"{_name_closest(worst, f'If the robot model is wrong ({named})', 'up to ')}. "
    left = {name: max(run.rms_deviation, FLOOR / 1.02) for name, run in runs.items()}
    text += _name_closest(left, f"If the robot is {own}", "")
    return f"{text}. {describe_grade(comparison.task.robot)}"


def _name_closest(left: Mapping[str, float], where: str, word: str) -> str:
    """Say which strategies leave least, and how much."""
    least = min(left.values())
    equals = [name for name, value in left.items() if value <= 1.02 * least]
    text = f"{where}, {_say_closest(equals)}: {word}{format_length(least)} rms"
    if "none" in left and "none" not in equals:
        text += f", against {format_length(left['none'])} without correction"
    return text


def _describe_drawn(comparison: Comparison) -> str:
    drawn = find_left(comparison) if comparison.drawn is not None else {}
    if not drawn:
        return ""
    least = min(median for median, _ in drawn.values())
    equals = [name for name, (median, _) in drawn.items() if median <= 1.02 * least]
    most = max(drawn[name][1] for name in equals)
    text = f"On robots that may be yours, by what is known of it, {_say_closest(equals)}: "
    text += f"{format_length(least)} rms in the median, {format_length(most)} in 95 %"
    if "none" in drawn and "none" not in equals:
        text += f", against {format_length(drawn['none'][0])} and {format_length(drawn['none'][1])} without"
        text += " correction"
    return f"{text}. "


def _say_closest(names: list[str]) -> str:
    return f"{join_names([name_strategy(name) for name in names])} {'comes' if len(names) == 1 else 'come'} closest"


def _figures(comparison: Comparison) -> Section:
    blocks: list[Block] = [_matrix(comparison)]
    wrong = list_wrong(comparison)
    cells = wrong or [comparison.cells[0].name]
    height = 90 + (34 + 16 * len(comparison.commands)) * len(cells)
    caption = "Bars: rms deviation; ticks: largest deviation; dashed: the tolerance."
    blocks.append(Chart(_bars(comparison, cells), caption, height=height))
    lede = "A strategy is worth what it leaves where the model is wrong: no model is right." if wrong else ""
    return Section("Strategies and cells", [*blocks, Fold("All figures", [_long_table(comparison)])], lede)


def _matrix(comparison: Comparison) -> PageTable:
    rows: list[Row] = []
    drawn, cells = comparison.drawn, [*list_wrong(comparison), comparison.cells[0].name]
    least = {cell: min(run.rms_deviation for run in comparison.evaluations[cell].values()) for cell in cells}
    for name in comparison.commands:
        row: Row = [TableCell(name_strategy(name), "strong")]
        if drawn is not None:
            close = drawn.median(name) <= 1.02 * min(drawn.median(other) for other in drawn.rms)
            ends = " to ".join(f"{1e3 * end:.3g}" for end in drawn.interval[name])
            text = f"{format_length(drawn.median(name))}, {ends}  ({format_length(drawn.most(name))})"
            row.append(TableCell(text, "good" if close else ""))
        for cell in cells:
            run = comparison.evaluations[cell][name]
            close = run.rms_deviation <= max(1.02 * least[cell], FLOOR)
            text = f"{format_length(run.rms_deviation)}  ({format_length(run.max_deviation)})"
            row.append(TableCell(text, "good" if close else ""))
        rows.append(row)
    first = [] if drawn is None else [Column("robots drawn from what is known")]
    columns = [Column("strategy"), *first, *(Column(cell) for cell in cells)]
    caption = "Deviation of the loaded tool tip from the path: rms (largest); the closest of each cell is green."
    if drawn is not None:
        caption += f" Drawn robots: rms, median and its 95 % interval (what 95 % stay below); {drawn.source}."
    return PageTable(columns, rows, caption)


def _long_table(comparison: Comparison) -> PageTable:
    rows: list[Row] = []
    tolerance = comparison.task.tolerance
    for cell, runs in comparison.evaluations.items():
        for name, run in runs.items():
            left = run.rms_deviation / runs["none"].rms_deviation if "none" in runs else float("nan")
            lengths = [format_length(value) for value in (run.rms_deviation, run.mean_deviation, run.max_deviation)]
            within = format_percent(run.share_within(tolerance))
            rows.append([cell, name_strategy(name), *lengths, format_percent(left), within])
    within = f"within {format_set_value(1e3 * tolerance)} mm"
    titles = ("cell", "strategy", "rms", "mean", "largest", "of uncorrected", within)
    return PageTable([Column(title) for title in titles], rows)


def _bars(comparison: Comparison, cells: Sequence[str]) -> Any:
    figure = go.Figure()
    names = [name_strategy(name) for name in comparison.commands]
    for number, cell in enumerate(cells):
        runs = comparison.evaluations[cell].values()
        rms = [1e3 * run.rms_deviation for run in runs]
        largest = [1e3 * run.max_deviation for run in runs]
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
    figure.add_vline(x=1e3 * comparison.task.tolerance, line={"color": TOLERANCE, "width": 1.4, "dash": "dash"})
    figure.update_layout(barmode="group", bargap=0.28, legend={"traceorder": "normal"})
    return figure


def _draw_left(comparison: Comparison) -> Any:
    """Draw what each strategy leaves on robots that may be the user's."""
    left = find_left(comparison)
    best = choose_best({name: median for name, (median, _) in left.items()})
    middle = [1e3 * median for median, _ in left.values()]
    most = [1e3 * max(most - median, 0.0) for median, most in left.values()]
    figure = go.Figure(go.Bar(
        y=[f"{name_strategy(name)}: {format_mm(median)}" for name, (median, _) in left.items()],
        x=middle, orientation="h",
        marker_color=colour_strategies(left, best),
        error_x={"type": "data", "array": most, "arrayminus": [0.0] * len(most), "thickness": 1.6, "width": 6},
        hovertemplate="%{x:.3g} mm<extra></extra>",
    ))  # fmt: skip
    figure.update_xaxes(title_text="deviation, rms, mm", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    figure.add_vline(x=1e3 * comparison.task.tolerance, line={"color": TOLERANCE, "width": 1.6, "dash": "dash"})
    return figure


def _along(comparison: Comparison) -> Section:
    task = comparison.task
    time = np.concatenate([[0.0], np.cumsum(task.step_time)])
    stations = place_stations(task.position, time, task.compensated)
    evaluated = np.where(task.compensated, 1e3, np.nan)
    cells = (*list_wrong(comparison), comparison.cells[0].name)
    panels = {
        name_strategy(name): {cell: comparison.evaluations[cell][name].distance * evaluated for cell in cells}
        for name in comparison.commands
    }
    figure = draw_panels(stations, panels, tolerance=1e3 * task.tolerance)
    caption = f"One chart a strategy, all with the same axes; dashed: tolerance {format_set_length(task.tolerance)}."
    chart = Chart(figure, caption, height=measure_panels(len(panels)), along=True)
    return Section("Along the path", [chart], "Distance of the loaded tool tip from the path.")
