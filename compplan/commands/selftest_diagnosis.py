"""`compplan selftest-diagnosis`: how well hidden effects are found, on campaigns drawn from the virtual cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from compplan.files.tables import dump_json


@click.command("selftest-diagnosis")
@click.option("--campaigns", type=click.IntRange(min=1), default=42, show_default=True, help="How many campaigns.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Number of the first campaign.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Processes.")
@click.option("--withhold", type=click.IntRange(min=0), default=2, show_default=True, metavar="K",
              help="Diagnose every K-th single effect again without it; 0 for none.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print selftest.json.")
def command(campaigns: int, seed: int, out: Path, workers: int, withhold: int, as_json: bool) -> None:
    """Draw campaigns, hide their effects, diagnose them and score the answers.

    The campaigns come from compplan's own forward models, so the figures say what the method can do where its models
    are right. Answers are kept in OUT/cases: an interrupted study goes on where it stopped. Writes OUT/selftest.json,
    OUT/report.html and OUT/failures.txt (every wrong answer in a line).
    """
    from compplan.selftest.draw import draw_case
    from compplan.selftest.failures import list_failures
    from compplan.selftest.page import describe_study, write_study
    from compplan.selftest.study import Settings, run_study
    from compplan.selftest.summary import summarise_study

    settings = Settings(campaigns, seed, workers, withhold)
    with show_bar("campaigns") as progress:
        records = run_study(draw_case, settings, out, progress)
    summary = summarise_study(records)
    facts = [
        ("campaigns", f"{len(records)} of {campaigns}, numbers {seed} to {seed + campaigns - 1}"),
        ("drawn from", "compplan's own forward models"),
    ]
    write_study(summary, list_failures(records), out, facts, "Hidden effects in drawn campaigns")
    click.echo(dump_json(summary) if as_json else describe_study(summary))


@contextmanager
def show_bar(task: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function that tells how much is done; silent where stderr is no terminal."""
    import sys

    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        bar = bars.add_task(task, total=None)
        yield lambda done, total: bars.update(bar, completed=done, total=total)
