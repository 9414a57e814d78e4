"""`compplan reproduce`: the figures of a paper beside ours."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.cli.commands.progress import show_progress
from compplan.io.tables import dump_json
from compplan.reproduce import PAPERS, reproduce_paper
from compplan.reproduce.page import summarise_reproduction, write_reproduction


@click.command()
@click.argument("paper", metavar="|".join(PAPERS))
@click.option("--out", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(paper: str, out: Path, as_json: bool) -> None:
    """Compute what a paper states, and show it beside the paper's figures.

    Example: compplan reproduce johra2022 --out out
    """
    with show_progress() as progress:
        progress(f"figures of {paper}")
        result = reproduce_paper(paper)
        progress("report")
        write_reproduction(result, out)
    table = summarise_reproduction(result)
    if as_json:
        click.echo(dump_json(table))
        return
    for row in result.rows:
        ours = f"{row.ours:.4g}" if isinstance(row.ours, float) else row.ours or "none"
        unit = f" {row.unit}" if row.unit and row.ours is not None else ""
        click.echo(f"{row.quantity}: paper {row.paper}, ours {ours}{unit}: {row.verdict}")
    click.echo(", ".join(f"{count} {verdict}" for verdict, count in table["verdicts"].items()))
    click.echo(f"wrote {out / 'reproduction.json'}, {out / 'report.html'}")
