"""`compplan compare`: every strategy side by side, in the cell as modelled and in cells that differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.cli.commands.options import robot_instead
from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.io.tables import dump_json
from compplan.job.names import ONLINE, STRATEGIES

if TYPE_CHECKING:
    from compplan.planning.compare import Comparison


@click.command(epilog=f"Strategies: {', '.join((*STRATEGIES, *ONLINE))}.")
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@robot_instead
@click.option("--json", "as_json", is_flag=True, help="Print the summary (compare.json) to stdout.")
def command(job: Path, folder: Path, robot: str | None, as_json: bool) -> None:
    """Compare every strategy on JOB: write compare.json and report.html.

    Example: compplan compare paths/circle_500mm.toml --out out
    """
    from compplan.cli.commands.progress import show_progress
    from compplan.job.operations import load_one_job
    from compplan.reporting.writers.plan import summarise_comparison, write_comparison
    from compplan.studies.comparison import compare_job

    checked = load_one_job(job, robot)
    with show_progress() as announce:
        comparison = compare_job(checked, announce=announce)
        announce("write: compare.json, report.html")
        files = write_comparison(comparison, folder)
    if as_json:
        click.echo(dump_json(summarise_comparison(comparison), indent=2))
        return
    print_table(comparison)
    click.echo(f"wrote {', '.join(str(path.relative_to(folder)) for path in files)} to {folder}")


def print_table(comparison: Comparison) -> None:
    """Print rms and greatest deviation of every strategy in every cell."""
    from rich.console import Console
    from rich.table import Table

    from compplan.reporting.style import format_length

    table = Table(title=f"{comparison.name}: deviation of the loaded tool, rms / greatest")
    table.add_column("strategy")
    drawn = comparison.drawn
    if drawn is not None:
        table.add_column("drawn robots, rms: median (its interval) / 95 %", justify="right")
    for cell in comparison.cells:
        table.add_column(cell.name, justify="right")
    for strategy, command in comparison.commands.items():
        runs = [comparison.evaluations[cell.name][strategy] for cell in comparison.cells]
        figures = [f"{format_length(run.rms_deviation)} / {format_length(run.max_deviation)}" for run in runs]
        if drawn is not None:
            ends = " to ".join(f"{1e3 * end:.3g}" for end in drawn.interval[strategy])
            median, most = (format_length(value) for value in (drawn.median(strategy), drawn.most(strategy)))
            figures.insert(0, f"{median} ({ends}) / {most}")
        table.add_row(strategy if command.status == "solved" else f"{strategy} (infeasible)", *figures)
    console = Console(width=max(80, 26 * (1 + 2 * (drawn is not None) + len(comparison.cells))))
    console.print(table)
    if drawn is not None:
        console.print(f"drawn robots: {drawn.source}")
    console.print(f"deviation computed by {comparison.judge}; robot model: {comparison.task.robot.grade}")
