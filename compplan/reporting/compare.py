"""What `compplan compare` writes: compare.json, and a page that sets strategies side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from compplan.io.palette import CATEGORIES
from compplan.io.quantities import format_length, format_mm, format_percent, format_set_length, format_set_value
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.job.names import ONLINE
from compplan.planning.tolerance_verdict import MEASURE
from compplan.reporting import page
from compplan.reporting.along_path import FLOOR, draw_strategies, measure_panels, place_stations
from compplan.reporting.charts import Bars, draw_bars
from compplan.reporting.provenance import describe_grade, describe_robot, list_assumptions
from compplan.reporting.strategy_text import colour_strategies, join_names, name_strategy

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison
    from compplan.planning.evaluate import Evaluation

#: Strategies that differ by less than this share leave the same (assumed).
SAME = 0.05
#: Those within this share of the least are the closest of a cell.
CLOSE = 1.02


def write_comparison(comparison: Comparison, folder: str | Path) -> list[Path]:
    """Write a comparison: compare.json and report.html; return the files written.

    Raises:
        InputError: If the folder cannot be written; nothing is written then.
    """
    with replace_folder(folder, "compare") as part:
        write_text(part / "report.html", render_comparison(comparison))
        write_json(part / "compare.json", comparison.to_dict(), indent=2)
        names = list_files(part)
    return [Path(folder) / name for name in names]


def render_comparison(comparison: Comparison) -> str:
    """Return the page: what each strategy leaves, by cell and along the path."""
    task, others = comparison.task, list_wrong(comparison)
    job = [] if comparison.job is None else [("job", str(comparison.job.file))]
    source = ("toolpath", task.nominal.source or "given in memory")
    assumptions = list_assumptions(comparison.job)
    if others:
        assumptions.append(f"cells: {', '.join(others)}: what the model may be wrong by is assumed, not measured")
    notes = [
        f"{name} is infeasible: {len(command.failures)} waypoints fail "
        f"({', '.join(sorted(set(command.failures.values())))}); its best compromise is shown."
        for name, command in comparison.commands.items() if command.status == "infeasible"
    ]  # fmt: skip
    return page.render_page(
        comparison.name, describe_comparison(comparison), [_show_cells(comparison), _show_path(comparison)],
        kind=f"Strategies compared, {task.robot.name}", opening=_open(comparison), notes=notes,
        provenance=describe_robot(task.robot, [("deviation computed by", comparison.judge), *job, source], assumptions),
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


def _list_closest(left: Mapping[str, float], share: float) -> list[str]:
    """List the strategies that leave least, or no more than a share beyond that."""
    return [name for name, value in left.items() if value <= share * min(left.values())]


def _open(comparison: Comparison) -> page.Summary:
    """Return the first screen: which strategy to plan with, and what it brings on a robot like this one."""
    found, tolerance, drawn = find_left(comparison), comparison.task.tolerance, comparison.drawn is not None
    left = {name: median for name, (median, _) in found.items() if name not in ONLINE}
    equals = _list_closest(left, 1.0 + SAME)
    best = "nlp" if "nlp" in equals else equals[-1]  # of equals the product's own
    most = found[best][1]
    kept = most <= tolerance
    where = "on a typical robot like yours" if drawn else "on the robot as modelled"
    if "none" in equals:
        verdict = f"A correction brings nothing here: {format_mm(left[best])} rms {where}, with and without it."
    else:
        others = [name_strategy(name) for name in equals if name != best]
        verb = "leaves" if len(others) == 1 else "leave"
        alike = f"; {join_names(others)} {verb} as little" if others else ""
        verdict = f"Plan with the strategy {name_strategy(best)}{alike}."
    stays = "it stays below that on 95 of 100 robots like yours" if drawn else "greatest deviation"
    words = f"{stays}; the tolerance is {format_set_length(tolerance)}"
    figures = [page.KeyFigure(format_mm(left[best]), f"rms deviation with it, {where}"),
               page.KeyFigure(format_mm(most), words, "good" if kept else "bad")]  # fmt: skip
    if "none" in left:
        figures.append(page.KeyFigure(format_mm(left["none"]), "rms deviation without correction"))
    todo = f'Plan with it: compplan plan JOB, where the job says strategy = "{best}".'
    if not kept:
        todo = f"{MEASURE} Its uncertainty matters more than the strategy."
    names = [f"{name_strategy(name)}: {format_mm(median)}" for name, (median, _) in found.items()]
    high = [1e3 * max(median, most) for median, most in found.values()]
    series = {"": Bars([1e3 * median for median, _ in found.values()], colour_strategies(found, best), None, high)}
    chart = draw_bars(names, series, "deviation, rms, mm", level=1e3 * tolerance, hover="%{x:.3g} mm")
    caption = "Bar: every second robot like yours stays below it; tick: 95 of 100 do. Dashed: the tolerance."
    picture = page.Chart(chart, caption, 90 + 46 * len(found))
    return page.Summary(verdict, "good" if kept else "unsure", figures, picture, todo)


def describe_comparison(comparison: Comparison) -> str:
    """Say which strategy comes closest: on drawn robots, where the model is wrong, and where it is right."""
    own, runs = comparison.cells[0].name, _own(comparison)
    text, wrong = _describe_drawn(comparison), list_wrong(comparison)
    if wrong:
        worst = {name: max(comparison.evaluations[cell][name].rms_deviation for cell in wrong) for name in runs}
        text += f"{_name_closest(worst, f'If the robot model is wrong ({join_names(wrong)})', 'up to ')}. "
    left = {name: max(run.rms_deviation, FLOOR / CLOSE) for name, run in runs.items()}
    text += _name_closest(left, f"If the robot is {own}", "")
    return f"{text}. {describe_grade(comparison.task.robot)}"


def _name_closest(left: Mapping[str, float], where: str, word: str) -> str:
    """Say which strategies leave least, and how much."""
    equals = _list_closest(left, CLOSE)
    text = f"{where}, {_say_closest(equals)}: {word}{format_length(min(left.values()))} rms"
    if "none" in left and "none" not in equals:
        text += f", against {format_length(left['none'])} without correction"
    return text


def _describe_drawn(comparison: Comparison) -> str:
    if comparison.drawn is None:
        return ""
    drawn = find_left(comparison)
    left = {name: median for name, (median, _) in drawn.items()}
    equals = _list_closest(left, CLOSE)
    most = max(drawn[name][1] for name in equals)
    text = f"On robots drawn from the uncertainty, {_say_closest(equals)}: "
    text += f"{format_length(min(left.values()))} rms in the median, {format_length(most)} in 95 %"
    if "none" in drawn and "none" not in equals:
        median, most = drawn["none"]
        text += f", against {format_length(median)} and {format_length(most)} without correction"
    return f"{text}. "


def _say_closest(names: Sequence[str]) -> str:
    return f"{join_names([name_strategy(name) for name in names])} {'comes' if len(names) == 1 else 'come'} closest"


def _show_cells(comparison: Comparison) -> page.Section:
    """Show rms and largest deviation of every strategy in every cell, the closest of each cell in green."""
    drawn, wrong, own = comparison.drawn, list_wrong(comparison), comparison.cells[0].name
    cells, runs, rows = [*wrong, own], comparison.evaluations, list[page.Row]()
    least = {cell: min(run.rms_deviation for run in runs[cell].values()) for cell in cells}
    for name in comparison.commands:
        row: page.Row = [page.Cell(name_strategy(name), "strong")]
        if drawn is not None:
            close = drawn.median(name) <= CLOSE * min(drawn.median(other) for other in drawn.rms)
            ends = " to ".join(f"{1e3 * end:.3g}" for end in drawn.interval[name])
            text = f"{format_length(drawn.median(name))}, {ends}  ({format_length(drawn.most(name))})"
            row.append(page.Cell(text, "good" if close else ""))
        for cell in cells:
            run = runs[cell][name]
            close = run.rms_deviation <= max(CLOSE * least[cell], FLOOR)
            text = f"{format_length(run.rms_deviation)}  ({format_length(run.max_deviation)})"
            row.append(page.Cell(text, "good" if close else ""))
        rows.append([*row, format_percent(runs[own][name].share_within(comparison.task.tolerance))])
    first = [] if drawn is None else ["robots drawn from the uncertainty"]
    tolerance = comparison.task.tolerance
    caption = "Deviation of the loaded tool tip from the path: rms (largest); the closest of each cell is green."
    if drawn is not None:
        caption += f" Drawn robots: rms, median and its 95 % interval (what 95 % stay below); {drawn.source}."
    within = f"{own}: cut within {format_set_value(1e3 * tolerance)} mm"
    table = page.DataTable(["strategy", *first, *cells, within], rows, caption)
    series = {}
    for number, cell in enumerate(wrong or [own]):
        rms, high = ([1e3 * getattr(run, key) for run in runs[cell].values()]
                     for key in ("rms_deviation", "max_deviation"))  # fmt: skip
        series[cell] = Bars(rms, CATEGORIES[number % len(CATEGORIES)], None, high)
    names = [name_strategy(name) for name in comparison.commands]
    chart = draw_bars(names, series, "deviation, mm", level=1e3 * tolerance, hover="%{x:.3g} mm rms")
    height = 90 + (34 + 16 * len(comparison.commands)) * len(series)
    bars = page.Chart(chart, "Bars: rms deviation; ticks: largest deviation; dashed: the tolerance.", height)
    lede = "A strategy is worth what it leaves where the model is wrong: no model is right." if wrong else ""
    return page.Section("Strategies and cells", [table, bars], lede)


def _show_path(comparison: Comparison) -> page.Section:
    task = comparison.task
    time = np.concatenate([[0.0], np.cumsum(task.step_time)])
    stations = place_stations(task.position, time, task.compensated)
    evaluated = np.where(task.compensated, 1e3, np.nan)
    cells = (*list_wrong(comparison), comparison.cells[0].name)
    deviations = {
        name_strategy(name): {cell: comparison.evaluations[cell][name].distance * evaluated for cell in cells}
        for name in comparison.commands
    }
    figure = draw_strategies(stations, deviations, 1e3 * task.tolerance)
    caption = f"One chart a strategy, all with the same axes; dashed: tolerance {format_set_length(task.tolerance)}."
    chart = page.Chart(figure, caption, measure_panels(len(deviations)), along=True)
    return page.Section("Along the path", [chart], "Distance of the loaded tool tip from the path.")
