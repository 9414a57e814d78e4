"""`compplan reproduce`: the figures of a paper beside ours."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import Answer, make_command, out_folder
from compplan.cli.terminal import show_progress
from compplan.reproduce import PAPERS, reproduce_paper
from compplan.reproduce.page import summarise_reproduction, write_reproduction


@make_command(click.argument("paper", metavar="|".join(PAPERS)), out_folder)
def command(paper: str, folder: Path) -> Answer:
    """Compute what a paper states, and show it beside the paper's figures.

    Example: compplan reproduce johra2022 --out out
    """
    with show_progress() as progress:
        progress(f"figures of {paper}")
        result = reproduce_paper(paper)
        progress("report")
        write_reproduction(result, folder)
    summary, lines = summarise_reproduction(result), []
    for row in result.rows:
        ours = f"{row.ours:.4g}" if isinstance(row.ours, float) else row.ours or "none"
        unit = f" {row.unit}" if row.unit and row.ours is not None else ""
        lines.append(f"{row.quantity}: paper {row.paper}, ours {ours}{unit}: {row.verdict}")
    counts = ", ".join(f"{count} {verdict}" for verdict, count in summary["verdicts"].items())
    return Answer(summary, [*lines, counts, f"wrote {folder / 'reproduction.json'}, {folder / 'report.html'}"])
