"""Outputs of `compplan montecarlo` in addition to the samples: montecarlo.json, and a page.

The page shows the deviation of each strategy on this path, its confidence interval, and its sensitivities.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.io.palette import CATEGORIES, TOLERANCE
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length, format_mm, format_mm_change, format_percent, format_set_length
from compplan.io.tables import write_json, write_text
from compplan.io.transaction import list_files, replace_folder
from compplan.reporting.along_path import FLOOR, Stations, chart_strategies
from compplan.reporting.charts import Bars, Figure, draw_bars, use_decades
from compplan.reporting.compare import colour_strategies, name_strategy
from compplan.reporting.page import Block, Cell, Chart, DataTable, Section, Summary, render_page
from compplan.reporting.provenance import describe_robot, list_assumptions
from compplan.studies.job_study import JobStudy
from compplan.studies.runner import Run
from compplan.studies.sensitivity import Sensitivity

#: Names of groups of uncertainties in a sentence.
GROUPS = {
    "wrench_level": "the level of the process force", "wrench_direction": "the direction of the process force",
    "robot": "the robot (compplan campaign)", "link_share": "the link share", "part": "the place of the part",
}  # fmt: skip


def write_study(study: JobStudy, folder: Path) -> list[Path]:
    """Write montecarlo.json and report.html; return the files written.

    Raises:
        InputError: If the folder cannot be written.
    """
    with replace_folder(folder, "montecarlo") as part:
        write_text(part / "report.html", _render(study))
        write_json(part / "montecarlo.json", {**study.summary, "made_by": describe_origin()}, indent=2)
        names = list_files(part)
    return [folder / name for name in names]


def _render(result: JobStudy) -> str:
    run, study, summary = result.run, result.run.study, result.summary
    sections = [_show_strategies(result, _find_best(result)), _show_path(run)]
    if result.sensitivity is not None:
        sections.append(_show_sensitivity(result.sensitivity, summary["sensitivity_of"]))
    facts = [
        ("job", str(result.job.file)),
        ("samples", f"{summary['samples']} in {summary['replicates']} replicates of a Sobol sequence"),
        ("seed", str(summary["seed"])),
        ("waypoints", f"{summary['waypoints']} of {summary['waypoints_of_path']}"),
        ("tip computed by", "exact loaded equilibrium of every sample and waypoint to 1 nm, geometry to first order"),
    ]
    return render_page(
        summary["name"], open_study(result), sections,
        kind=f"Strategies under uncertainty, {study.task.robot.name}",
        provenance=describe_robot(study.task.robot, facts, [*list_assumptions(result.job), *summary["assumptions"]]),
    )  # fmt: skip


def _find_best(result: JobStudy) -> str:
    """Return the strategy with most parts within the tolerance; of equals that with the least mean rms deviation."""
    figures = result.summary["strategies"]
    return max(figures, key=lambda name: (figures[name]["within_tolerance"], -figures[name]["rms_mm"]["mean"]))


def open_study(result: JobStudy) -> Summary:
    """Return the first screen: share of parts within the tolerance, and the uncertainty to reduce."""
    figures, tolerance = result.summary["strategies"], 1e-3 * result.summary["tolerance_mm"]
    best = _find_best(result)
    entry, share = figures[best], float(figures[best]["within_tolerance"])
    tone = "good" if share >= 0.95 else "unsure" if share >= 0.5 else "bad"
    count = result.summary["samples"]
    parts = {name: round(count * figures[name]["within_tolerance"]) for name in (best, *({"none"} & set(figures)))}
    none = f" (uncorrected: {parts['none']})" if "none" in figures else ""
    verdict = (f"{parts[best]} of {count} simulated parts {'keeps' if parts[best] == 1 else 'keep'} "
               f"{format_set_length(tolerance)} with the best strategy, {name_strategy(best)}{none}.")  # fmt: skip
    numbers = [
        (format_mm(1e-3 * entry["rms_mm"]["mean"]), "rms deviation with that strategy, mean of all parts"),
        (format_mm(1e-3 * entry["max_mm"]["p95"]), "greatest deviation with it on 95 % of the parts", tone),
    ]
    todo = "More samples narrow the intervals: --samples."
    if result.sensitivity is not None:
        group = result.sensitivity.groups[int(np.argmax(result.sensitivity.total[result.summary["sensitivity_of"]]))]
        todo = f"Measure {GROUPS.get(group, group.replace('_', ' '))}: it causes most of the deviation that is left."
    boxes = "Greatest deviation of each part. Box: middle half of the parts; line: 5 to 95 %. Dashed: tolerance."
    picture = Chart(_draw_distributions(result.run, best), boxes, 90 + 34 * len(figures))
    return Summary(verdict, tone, numbers, picture, todo)


def _show_strategies(result: JobStudy, best: str) -> Section:
    rows = []
    for name, entry in result.summary["strategies"].items():
        rms, most = entry["rms_mm"], entry["max_mm"]
        rows.append(
            [Cell(name_strategy(name), "strong"), Cell(format_length(1e-3 * rms["mean"]), "good" * (name == best)),
             format_mm_change(*(1e-3 * max(end, 0.0) for end in rms["ci95"])).replace("→", "–"),
             *(format_length(1e-3 * figures[key]) for figures in (rms, most) for key in ("p50", "p95")),
             *(format_percent(entry.get(key, float("nan")))
               for key in ("of_uncorrected", "within_tolerance", "waypoints_within_tolerance"))]
        )  # fmt: skip
    columns = [
        "strategy", "rms, mean", "95 % interval", "rms, median", "rms, 95 %", "greatest, median", "greatest, 95 %",
        "of uncorrected", "parts within tolerance", "waypoints within",
    ]  # fmt: skip
    table = DataTable(columns, rows, "Deviation of the loaded tool tip from the path.")
    return Section("Strategies", [table])


def _show_path(run: Run) -> Section:
    """Show the deviation along the path, one chart per strategy: median and 95 % quantile of the samples."""
    study = run.study
    steps = np.linalg.norm(np.diff(study.task.position, axis=0), axis=1)
    length, time = (np.r_[0.0, np.cumsum(step)][study.stations] for step in (steps, study.task.step_time))
    median, most = (1e3 * np.maximum(np.quantile(run.evaluated.along, share, axis=0), FLOOR) for share in (0.5, 0.95))
    deviations = {
        name_strategy(name): {"median": median[k], "95 % of the parts": most[k]}
        for k, name in enumerate(study.strategies)
    }
    stations = Stations(length, time, np.zeros(0, int), np.zeros((0, 2)))
    chart = chart_strategies(stations, deviations, 1e3 * study.task.tolerance, log=True)
    return Section("Along the path", [chart], "Distance of the loaded tool tip from the path.")


def _show_sensitivity(found: Sensitivity, strategy: str) -> Section:
    rows = [[group.replace("_", " "), *(round(float(found.total[name][k]), 2) for name in found.total)]
            for k, group in enumerate(found.groups)]  # fmt: skip
    heads = ["total index", *(f"{name_strategy(name)} [, 2]" for name in found.total)]
    caption = (
        "Share of the variance of the rms deviation that remains if all but this were exact, with 95 % interval; "
        f"{found.samples} samples, {found.waypoints} waypoints."
    )
    order = np.argsort(-found.total[strategy])
    total, half = found.total[strategy][order], found.half_width[strategy][order]
    names = [found.groups[k].replace("_", " ") for k in order]
    series = {"": Bars(total, CATEGORIES[0], total - half, total + half)}
    chart = draw_bars(names, series, f"total index, strategy {name_strategy(strategy)}")
    blocks: list[Block] = [Chart(chart, caption, 90 + 40 * len(names)), DataTable(heads, rows, "All strategies.")]
    return Section("Which uncertainty matters", blocks, "Total Sobol indices.")


def _draw_distributions(run: Run, best: str) -> Figure:
    """Draw the greatest deviation of every sample by strategy, as boxes with whiskers at 5 and 95 %."""
    figure, most, names = Figure(), np.maximum(run.evaluated.max, FLOOR), list(run.study.strategies)
    colours = colour_strategies(names, best)
    ends = 1e3 * np.quantile(most, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0)
    for name, colour, (low, q1, median, q3, high) in zip(names, colours, ends.T.tolist(), strict=True):
        figure.add(
            "box", y=[name_strategy(name)], orientation="h", marker={"color": colour}, showlegend=False,
            name=name_strategy(name), lowerfence=[low], q1=[q1], median=[median], q3=[q3], upperfence=[high],
        )  # fmt: skip
    low, high = 1e3 * float(np.quantile(most, 0.02)), 1e3 * float(np.quantile(most, 0.99))
    use_decades(figure, "x", low, max(high, 2 * low), title="greatest deviation")
    figure.axis("y", autorange="reversed")
    figure.level(1e3 * run.study.task.tolerance, "x", color=TOLERANCE, width=1.4)
    return figure
