"""`compplan reproduce`: the figures of a paper beside ours."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import json_summary, out_folder
from compplan.cli.terminal import show, show_progress
from compplan.reproduce import PAPERS, reproduce_paper
from compplan.reproduce.paper import summarise_reproduction, write_reproduction


@click.command()
@click.argument("paper", metavar="|".join(PAPERS))
@out_folder
@json_summary
def command(paper: str, folder: Path, as_json: bool) -> None:
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
    wrote = f"wrote {folder / 'reproduction.json'}, {folder / 'report.html'}"
    show(summary, as_json, [*lines, counts, wrote])
