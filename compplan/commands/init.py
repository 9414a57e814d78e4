"""`compplan init`: write a job with every key explained."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.errors import InputError
from compplan.files.tables import write_text
from compplan.job.text import write_job_text


@click.command()
@click.argument("file", type=click.Path(path_type=Path), default=Path("job.toml"))
def command(file: Path) -> None:
    """Write a job FILE (default job.toml) in which every key is explained."""
    if file.exists():
        raise InputError("exists already; name another file", file=file)
    write_text(file, write_job_text())
    click.echo(f"wrote {file}; next: compplan plan {file} --out out")
