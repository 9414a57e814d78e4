"""`compplan montecarlo`: strategies against each other under uncertainty."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.io.tables import dump_json
from compplan.job.names import ONLINE, STRATEGIES

LOG = logging.getLogger(__name__)


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--samples", type=click.IntRange(2, 10_000_000), default=1000, show_default=True,
              help="Number of samples.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="Seed of everything.")
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine; default: one a core.")
@click.option("--scheduler", help="Address of a Dask scheduler (tcp://HOST:PORT) whose workers compute.")
@click.option("--strategies", help="Names of the strategies, with commas; default: all that the robot can carry out of "
              f"{', '.join((*STRATEGIES, *ONLINE))}.")  # fmt: skip
@click.option("--replicates", type=click.IntRange(2, 1024), default=8, show_default=True,
              help="Independent replicates.")  # fmt: skip
@click.option("--waypoints", type=click.IntRange(2, 5_000_000), default=2500, show_default=True,
              help="A longer path is thinned evenly to this many waypoints.")  # fmt: skip
@click.option("--no-sensitivity", is_flag=True, help="Leave out the sensitivity analysis.")
@click.option("--discard", is_flag=True, help="Take away finished samples of another study in OUT first.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary (montecarlo.json) to stdout.")
def command(job: Path, folder: Path, workers: int | None, scheduler: str | None, as_json: bool, **choices: Any) -> None:
    """Let strategies cut JOB in many uncertain cells: write montecarlo.json, report.html and the samples.

    Samples are kept in OUT/samples: an interrupted study goes on where it stopped when it is run again.

    Example: compplan montecarlo paths/isf_cone.toml --samples 200 --seed 1 --out out
    """
    from compplan.errors import InputError
    from compplan.io.transaction import lock_folder
    from compplan.job.operations import load_one_job
    from compplan.reporting.writers.montecarlo import write_study
    from compplan.studies.job_study import study_job
    from compplan.studies.runner import Settings
    from compplan.studies.workers import Workers

    if workers and scheduler:
        raise InputError("--workers and --scheduler are both given, choose one")
    checked = load_one_job(job)
    names = [name.strip() for name in (choices["strategies"] or "").split(",") if name.strip()]
    if choices["strategies"] is not None and (not names or len(set(names)) < len(names)):
        raise InputError(f"--strategies is {choices['strategies']!r}, expected names with commas, each once")
    settings = Settings(choices["samples"], choices["seed"], choices["replicates"])
    with lock_folder(folder), show_bars() as (announce, progress):
        study = study_job(
            checked,
            settings,
            folder,
            strategies=names,
            most_waypoints=choices["waypoints"],
            sensitivity=not choices["no_sensitivity"],
            discard=choices["discard"],
            workforce=Workers(workers, scheduler),
            announce=announce,
            progress=progress,
        )
        announce("report")
        files = write_study(study, folder)
    summary = study.summary
    if as_json:
        click.echo(dump_json(summary, indent=2))
        return
    print_table(summary)
    click.echo(f"wrote {', '.join(str(path.relative_to(folder)) for path in files)} to {folder}")


def print_table(summary: dict[str, Any]) -> None:
    """Print rms and greatest deviation of every strategy."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{summary['name']}: deviation in mm over {summary['samples']} samples")
    for column in ("strategy", "rms, mean", "95 % interval", "rms, 95 %", "greatest, 95 %", "parts within tolerance"):
        table.add_column(column, justify="left" if column == "strategy" else "right")
    for name, figures in summary["strategies"].items():
        rms, largest = figures["rms_mm"], figures["max_mm"]
        ends = f"{rms['ci95'][0]:.4g} to {rms['ci95'][1]:.4g}"
        share = f"{100 * figures['within_tolerance']:.3g} %"
        table.add_row(name, f"{rms['mean']:.4g}", ends, f"{rms['p95']:.4g}", f"{largest['p95']:.4g}", share)
    console = Console(width=110)
    console.print(table)
    if summary["waypoints"] < summary["waypoints_of_path"]:
        console.print(f"path thinned from {summary['waypoints_of_path']} to {summary['waypoints']} waypoints")
    grade = summary["robot_grade"]
    console.print(f"robot model: {grade}; uncertainties as in the report, assumed where the job states none")


@contextmanager
def show_bars() -> Iterator[tuple[Callable[[str], None], Callable[[str, int, int], None]]]:
    """Give functions that tell what is done now and how far it is; silent where stderr is no terminal."""
    if not sys.stderr.isatty() or LOG.isEnabledFor(logging.INFO):
        yield LOG.info, (lambda task, done, total: None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        known: dict[str, Any] = {}
        head = bars.add_task("", total=None)

        def announce(text: str) -> None:
            bars.update(head, description=text)

        def progress(task: str, done: int, total: int) -> None:
            if task not in known:
                known[task] = bars.add_task(task, total=total)
            bars.update(known[task], completed=done, total=total)

        yield announce, progress
