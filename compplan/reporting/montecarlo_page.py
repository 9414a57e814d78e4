"""The page of a Monte Carlo study: what each strategy brings on this path, how sure that is, and what it hangs on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from compplan.reporting.montecarlo_figures import (
    draw_along,
    draw_convergence,
    draw_differences,
    draw_distributions,
    draw_sensitivity,
)
from compplan.reporting.page import Chart, Column, Fold, PageTable, Row, Section, TableCell, write_page
from compplan.reporting.panels import measure_panels
from compplan.reporting.provenance import describe_grade, describe_robot, list_assumptions
from compplan.reporting.strategy_text import name_strategy
from compplan.reporting.style import format_length, format_percent, format_set_value
from compplan.reporting.summaries import open_study
from compplan.studies.job_study import JobStudy

#: What the boxes show.
BOXES = "Box: middle half of the robots drawn; line: 5 to 95 %; dashed: the tolerance. Logarithmic."
Rows = list[Row]


def write_montecarlo_report(result: JobStudy, folder: Path) -> Path:
    """Write the page of a study: report.html in a folder.

    Args:
        result: The study.
        folder: The folder.

    Returns:
        The file written.

    Raises:
        InputError: If the folder cannot be written.

    """
    study, summary = result.run.study, result.summary
    sections = [_strategies(result), _path(result), _pairs(result)]
    if result.sensitivity is not None:
        sections.append(_sensitivity(result))
    sections.append(_convergence(result))
    facts = [
        ("job", str(result.job.file)),
        ("samples", f"{summary['samples']} in {summary['replicates']} replicates of a Sobol sequence"),
        ("seed", str(summary["seed"])),
        ("waypoints", f"{summary['waypoints']} of {summary['waypoints_of_path']}"),
        ("tip computed by", "exact loaded equilibrium of every sample and waypoint to 1 nm, geometry to first order"),
    ]  # fmt: skip
    assumptions = [*list_assumptions(result.job), *summary["assumptions"]]
    file = folder / "report.html"
    write_page(
        file,
        summary["name"],
        _lede(result),
        sections,
        kind=f"Strategies under uncertainty, {study.task.robot.name}",
        opening=open_study(result, Chart(draw_distributions(result.run), BOXES, 90 + 34 * len(summary["strategies"]))),
        notes=_notes(result),
        provenance=describe_robot(study.task.robot, facts, assumptions),
    )
    return file


def _lede(result: JobStudy) -> str:
    figures = result.summary["strategies"]
    best = min(figures, key=lambda name: figures[name]["rms_mm"]["mean"])
    blind = [name for name, c in result.run.study.answers.items() if c.measures == "nothing" and name != "none"]
    text = f"Closest of all: {name_strategy(best)}, {_mm(figures[best]['rms_mm']['mean'])} rms on average, "
    text += f"{_mm(figures[best]['rms_mm']['p95'])} in 95 of 100 cells"
    if "none" in figures:
        text += f", against {_mm(figures['none']['rms_mm']['mean'])} without correction"
    text += "."
    if blind and best not in blind:
        offline = min(blind, key=lambda name: figures[name]["rms_mm"]["mean"])
        text += f" Closest without any sensor: {name_strategy(offline)}, {_mm(figures[offline]['rms_mm']['mean'])}."
    return f"{text} {describe_grade(result.run.study.task.robot)}"


def _notes(result: JobStudy) -> list[str]:
    summary, notes = result.summary, []
    if summary["waypoints"] < summary["waypoints_of_path"]:
        notes.append(
            f"The path has {summary['waypoints_of_path']} waypoints; the study looks at {summary['waypoints']}, "
            "spread evenly."
        )
    notes.append(
        "The uncertainties are assumed unless the job sets them: the ranking holds for cells like these, "
        "and only as far as they are like yours."
    )
    return notes


def _strategies(result: JobStudy) -> Section:
    rows: Rows = []
    figures = result.summary["strategies"]
    best = min(figures, key=lambda name: figures[name]["rms_mm"]["mean"])
    for name, entry in figures.items():
        rms, most = entry["rms_mm"], entry["max_mm"]
        rows.append(
            [
                TableCell(name_strategy(name), "strong"),
                TableCell(_mm(rms["mean"]), "good" if name == best else ""),
                f"{_mm(rms['ci95'][0])} – {_mm(rms['ci95'][1])}",
                _mm(rms["p50"]),
                _mm(rms["p95"]),
                _mm(most["p50"]),
                _mm(most["p95"]),
                format_percent(entry.get("of_uncorrected", float("nan"))),
                format_percent(entry["within_tolerance"]),
                format_percent(entry["waypoints_within_tolerance"]),
            ]
        )
    tolerance = format_set_value(result.summary["tolerance_mm"])
    titles = (
        "strategy", "rms, mean", "95 % interval", "rms, median", "rms, 95 %", "greatest, median", "greatest, 95 %",
        "of uncorrected", f"parts within {tolerance} mm", "waypoints within",
    )  # fmt: skip
    table = PageTable([Column(title) for title in titles], rows, "Deviation of the loaded tool tip from the path.")
    about: Rows = [
        [TableCell(name_strategy(name), "strong"), c.knows, c.measures, c.commands]
        for name, c in result.run.study.answers.items()
    ]
    heads = [Column(title) for title in ("strategy", "knows", "measures", "commands")]
    height = 90 + 34 * len(figures)
    chart = Chart(draw_distributions(result.run), BOXES, height=height)
    fold = Fold("What each strategy knows, measures and commands", [PageTable(heads, about)])
    return Section("Strategies", [table, chart, fold])


def _path(result: JobStudy) -> Section:
    tolerance = format_set_value(result.summary["tolerance_mm"])
    caption = f"One chart a strategy, all with the same axes, logarithmic; dashed: tolerance {tolerance} mm."
    height = measure_panels(len(result.run.study.strategies))
    chart = Chart(draw_along(result.run), caption, height=height, along=True)
    return Section("Along the path", [chart], "Distance of the loaded tool tip from the path.")


def _pairs(result: JobStudy) -> Section:
    main = result.summary["sensitivity_of"]
    chart = Chart(
        draw_differences(result.summary, main),
        f"rms deviation of each strategy less that of {name_strategy(main)}, cell by cell; 95 % interval of the mean.",
        height=90 + 26 * len(result.summary["strategies"]),
    )
    rows: Rows = []
    for pair in result.summary["paired_differences"]:
        first, second = pair["strategies"]
        mean, (low, high) = pair["rms_mm"]["mean"], pair["rms_mm"]["ci95"]
        share = format_percent(pair["second_better"])
        rows.append([name_strategy(first), name_strategy(second), _mm(mean), f"{_mm(low)} – {_mm(high)}", share])
    heads = ("first", "second", "second less first", "95 % interval", "second closer in")
    fold = Fold("All pairs", [PageTable([Column(title) for title in heads], rows, scroll=14)])
    return Section("Differences", [chart, fold], "All strategies meet the same cells, so that differences are paired.")


def _sensitivity(result: JobStudy) -> Section:
    found = result.sensitivity
    assert found is not None
    rows: Rows = [
        [group, *(float(found.total[name][k]) for name in found.total)] for k, group in enumerate(found.groups)
    ]
    heads = [Column("total index"), *(Column(name_strategy(name), "", 2) for name in found.total)]
    fold = Fold("All strategies", [PageTable(heads, rows)])
    caption = (
        f"Share of the variance of the rms deviation that is left if all but this were known, with 95 % interval; "
        f"{found.samples} samples, {found.waypoints} waypoints."
    )
    figure = draw_sensitivity(found, result.summary["sensitivity_of"])
    chart = Chart(figure, caption, height=90 + 40 * len(found.groups))
    return Section("Which uncertainty matters", [chart, fold], "Total Sobol indices.")


def _convergence(result: JobStudy) -> Section:
    caption = "Mean rms with its 95 % interval against the number of samples, one chart a strategy."
    chart = Chart(draw_convergence(result.run), caption, height=measure_panels(len(result.run.study.strategies)))
    return Section("Convergence", [chart])


def _mm(value: float) -> str:
    return format_length(value * 1e-3) if np.isfinite(value) else "–"


__all__: list[Any] = ["write_montecarlo_report"]
