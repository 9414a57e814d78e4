"""Draw campaigns from outside: `python -m benchmarks outsider --seeds 0:60 --out DIR`, one folder a seed."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from benchmarks.outsider.draw import draw_case
from benchmarks.outsider.logbook import write_case


@click.command()
@click.option("--seeds", required=True, help="Range of seeds A:B, B left out.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
def main(seeds: str, out: Path) -> None:
    """Draw labelled measurement campaigns that share no code with the product or with benchmarks.campaigns."""
    try:
        first, last = (int(v) for v in seeds.split(":"))
    except ValueError:
        raise click.BadParameter(f"seeds {seeds!r}, a range A:B of whole numbers is wanted") from None
    with click.progressbar(
        range(first, last), label="campaigns", file=sys.stderr, hidden=not sys.stderr.isatty()
    ) as bar:
        for seed in bar:
            case = draw_case(seed)
            if case is None:
                click.echo(f"seed {seed}: no campaign that can be labelled fairly; left out", err=True)
            else:
                write_case(case, out)


if __name__ == "__main__":
    main()
