"""`compplan compare`: every strategy side by side, in the cell as modelled and in cells that differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.cli.options import INPUT, json_summary, out_folder, robot_instead
from compplan.cli.terminal import format_table, show, show_progress
from compplan.job.names import ONLINE, STRATEGIES

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison


@click.command(epilog=f"Strategies: {', '.join((*STRATEGIES, *ONLINE))}.")
@click.argument("job", type=INPUT)
@out_folder
@robot_instead
@json_summary
def command(job: Path, folder: Path, robot_name: str | None, as_json: bool) -> None:
    """Compare every strategy on JOB: write compare.json and report.html.

    Example: compplan compare paths/circle_500mm.toml --out out
    """
    from compplan.job.operations import load_one_job
    from compplan.planning.compare import summarise_comparison
    from compplan.reporting.compare import write_comparison
    from compplan.studies.job_study import compare_job

    checked = load_one_job(job, robot_name)
    with show_progress() as announce:
        comparison = compare_job(checked, announce=announce)
        announce("write: compare.json, report.html")
        files = write_comparison(comparison, folder)
    wrote = f"wrote {', '.join(str(path.relative_to(folder)) for path in files)} to {folder}"
    show(summarise_comparison(comparison), as_json, [*describe_strategies(comparison), wrote])


def describe_strategies(comparison: Comparison) -> list[str]:
    """Return rms and greatest deviation of every strategy in every cell."""
    from compplan.io.quantities import format_length

    drawn, cells = comparison.drawn, [cell.name for cell in comparison.cells]
    rows = []
    for strategy, command in comparison.commands.items():
        runs = [comparison.evaluations[cell][strategy] for cell in cells]
        figures = [f"{format_length(run.rms_deviation)} / {format_length(run.max_deviation)}" for run in runs]
        if drawn is not None:
            ends = " to ".join(f"{1e3 * end:.3g}" for end in drawn.interval[strategy])
            median, most = (format_length(value) for value in (drawn.median(strategy), drawn.most(strategy)))
            figures.insert(0, f"{median} ({ends}) / {most}")
        rows.append([strategy if command.status == "solved" else f"{strategy} (infeasible)", *figures])
    columns = ["strategy", *([] if drawn is None else ["drawn robots, rms: median (its interval) / 95 %"]), *cells]
    title = f"{comparison.name}: deviation of the loaded tool, rms / greatest"
    return [
        *format_table(rows, columns, title, max(80, 26 * (len(columns) + (drawn is not None)))),
        *([] if drawn is None else [f"drawn robots: {drawn.source}"]),
        f"deviation computed by {comparison.judge}; robot model: {comparison.task.robot.grade}",
    ]
