"""Outputs of `compplan compare`: compare.json, and a page that compares strategies; names of strategies."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from compplan.io.palette import AFTER, BEFORE, NEUTRAL
from compplan.io.quantities import (
    format_length,
    format_mm,
    format_percent,
    format_set_length,
    format_set_value,
    join_names,
)
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.planning.strategies import ONLINE, STRATEGIES
from compplan.planning.tolerance_verdict import MEASURE
from compplan.reporting.along_path import FLOOR, chart_strategies, place_stations
from compplan.reporting.charts import Bars, draw_bars
from compplan.reporting.page import Cell, Chart, DataTable, Section, Summary, render_page
from compplan.reporting.provenance import describe_robot, list_assumptions
from compplan.simulation.simulated_robot import EXACT_EVALUATION

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison

#: Relative difference of the deviation below which strategies are equal (assumed).
SAME = 0.05
#: Greatest ratio to the least deviation of the strategies marked as closest on a simulated robot.
CLOSE = 1.02


def name_strategy(name: str) -> str:
    """Return the display name of a strategy: `words` of its module, or its name."""
    module = STRATEGIES.get(name) or ONLINE.get(name)
    return str(getattr(module, "words", name.replace("_", " ")))


def colour_strategies(names: Iterable[str], best: str) -> list[str]:
    """Return one colour per strategy: one for `none`, one for the best, grey for the others."""
    return [AFTER if name == best else BEFORE if name == "none" else NEUTRAL for name in names]


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
    """Return the page: deviation of each strategy, by simulated robot and along the path."""
    task, own = comparison.task, comparison.cells[0].name
    wrong = [cell.name for cell in comparison.cells[1:]]
    facts = [("deviation computed by", EXACT_EVALUATION), ("toolpath", task.nominal.source or "given in memory")]
    facts += [] if comparison.job is None else [("job", str(comparison.job.file))]
    assumptions = list_assumptions(comparison.job)
    if wrong:
        assumptions.append(f"robots that differ ({', '.join(wrong)}): the size of the model error is assumed")
    notes = [
        f"{name} is infeasible: {len(command.failures)} waypoints fail "
        f"({', '.join(sorted(set(command.failures.values())))}); its best compromise is shown."
        for name, command in comparison.commands.items() if command.status == "infeasible"
    ]  # fmt: skip
    stations = place_stations(task.position, np.r_[0.0, np.cumsum(task.step_time)], task.compensated)
    evaluated = np.where(task.compensated, 1e3, np.nan)
    along = {
        name_strategy(name): {cell: comparison.evaluations[cell][name].distance * evaluated for cell in (*wrong, own)}
        for name in comparison.commands
    }
    lede = "Strategies are compared on robots that differ from the model." if wrong else ""
    sections = [
        Section("Strategies and robots", [_list_cells(comparison, wrong, own)], lede),
        Section("Along the path", [chart_strategies(stations, along, 1e3 * task.tolerance)],
                "Distance of the loaded tool tip from the path."),
    ]  # fmt: skip
    return render_page(
        comparison.name, open_comparison(comparison), sections, kind=f"Strategies compared, {task.robot.name}",
        notes=notes, provenance=describe_robot(task.robot, facts, assumptions),
    )  # fmt: skip


def open_comparison(comparison: Comparison) -> Summary:
    """Return the first screen: recommended strategy, and its deviation on robots like that of the job."""
    drawn, tolerance = comparison.drawn, comparison.task.tolerance
    if drawn is None:  # rms and greatest deviation on the robot as modelled, by strategy
        runs = comparison.evaluations[comparison.cells[0].name]
        found = {name: (run.rms_deviation, run.max_deviation) for name, run in runs.items()}
    else:  # median and 95 % of the rms on drawn robots
        found = {name: (drawn.median(name), drawn.most(name)) for name in drawn.rms}
    left = {name: median for name, (median, _) in found.items() if name not in ONLINE}
    equals = [name for name, value in left.items() if value <= (1.0 + SAME) * min(left.values())]
    best = "nlp" if "nlp" in equals else equals[-1]  # nlp is preferred among equals
    most = found[best][1] if drawn is None else drawn.greatest[best]
    within = most <= tolerance
    where = "on the robot as modelled" if drawn is None else "on a typical robot like yours"
    if "none" in equals:
        verdict = f"A correction brings nothing here: {format_mm(left[best])} rms {where}, with and without it."
    else:
        others = [name_strategy(name) for name in equals if name != best]
        alike = f"; {join_names(others)} {'is' if len(others) == 1 else 'are'} as good" if others else ""
        verdict = f"Without extra sensors: plan with the strategy {name_strategy(best)}{alike}."
        least = min(found, key=lambda name: found[name][0])
        if found[least][0] < (1.0 - SAME) * left[best]:
            verdict += f" Best of all: {name_strategy(least)}."
    stays = f"greatest deviation with it{'' if drawn is None else ' on 95 % of robots like yours'}"
    figures: list[tuple[str, ...]] = [
        (format_mm(left[best]), f"rms deviation with it, {where}"),
        (format_mm(most), f"{stays}; the tolerance is {format_set_length(tolerance)}", "good" if within else "bad"),
    ]
    if "none" in left:
        figures.append((format_mm(left["none"]), "rms deviation without correction"))
    todo = f'Plan with it: compplan plan JOB, where the job has strategy = "{best}"'
    if not within:
        todo = f"The robot's uncertainty matters more than the strategy. {MEASURE}"
    names = [f"{name_strategy(name)}: {format_mm(median)}" for name, (median, _) in found.items()]
    high = [1e3 * max(median, most) for median, most in found.values()]
    series = {"": Bars([1e3 * median for median, _ in found.values()], colour_strategies(found, best), None, high)}
    chart = draw_bars(names, series, "rms, mm", level=1e3 * tolerance, hover="%{x:.3g} mm")
    caption = "Bar: rms on a typical robot like yours; tick: on 95 % of them. Dashed: the tolerance of single points."
    return Summary(verdict, "good" if within else "unsure", figures, Chart(chart, caption, 90 + 46 * len(found)), todo)


def _list_cells(comparison: Comparison, wrong: list[str], own: str) -> DataTable:
    """List rms and largest deviation of every strategy on every simulated robot, the closest of each in green."""
    drawn, runs, tolerance = comparison.drawn, comparison.evaluations, comparison.task.tolerance
    least = {cell: min(run.rms_deviation for run in runs[cell].values()) for cell in (*wrong, own)}
    rows = []
    for name in comparison.commands:
        row: list[Any] = [Cell(name_strategy(name), "strong")]
        if drawn is not None:
            close = drawn.median(name) <= CLOSE * min(drawn.median(other) for other in drawn.rms)
            ends = " to ".join(f"{1e3 * end:.3g}" for end in drawn.interval[name])
            text = f"{format_length(drawn.median(name))}, {ends}  ({format_length(drawn.most(name))})"
            row.append(Cell(text, "good" if close else ""))
        for cell in (*wrong, own):
            run = runs[cell][name]
            text = f"{format_length(run.rms_deviation)}  ({format_length(run.max_deviation)})"
            row.append(Cell(text, "good" if run.rms_deviation <= max(CLOSE * least[cell], FLOOR) else ""))
        rows.append([*row, format_percent(runs[own][name].share_within(tolerance))])
    first = [] if drawn is None else ["robots drawn from the uncertainty"]
    caption = "Deviation of the loaded tool tip from the path: rms (largest); the closest of each column is green."
    if drawn is not None:
        caption += f" Drawn robots: rms, median and its 95 % interval (what 95 % stay below); {drawn.source}."
    within = f"{own}: cut within {format_set_value(1e3 * tolerance)} mm"
    return DataTable(["strategy", *first, *wrong, own, within], rows, caption)
