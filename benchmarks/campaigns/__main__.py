"""Draw campaigns: `python -m benchmarks.campaigns draw --suite tracker --seeds 0:120 --out DIR`.

Other robots, tracker designs, rough effects, everyday errors, unknown causes: see `suite.py` and CONVENTIONS.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from benchmarks.campaigns.suite import KINDS, REPORTING, SUITES, draw_hard


@click.group()
def main() -> None:
    """Draw measurement campaigns with a known truth, one folder a campaign."""


@main.command()
@click.option("--suite", type=click.Choice(SUITES), required=True, help="What kind of campaigns.")
@click.option("--seeds", required=True, help="Range of seeds A:B, B left out; below 1000000 for development.")
@click.option(
    "--kind", type=click.Choice([*KINDS]), default=None, help="One kind alone; drawn by their shares if left out."
)
@click.option("--reporting", is_flag=True, help="Allow seeds from 1000000 on, which are drawn once, for a report.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
def draw(suite: str, seeds: str, kind: str | None, reporting: bool, out: Path) -> None:
    """Draw hard campaigns: other robots, tracker designs, rough effects, everyday errors, unknown causes."""
    try:
        first, last = (int(v) for v in seeds.split(":"))
    except ValueError:
        raise click.BadParameter(f"seeds {seeds!r}, a range A:B of whole numbers is wanted") from None
    if last > REPORTING.start and not reporting:
        raise click.BadParameter(f"seeds from {REPORTING.start} on are kept for reports; add --reporting to draw them")
    with click.progressbar(
        range(first, last), label="campaigns", file=sys.stderr, hidden=not sys.stderr.isatty()
    ) as bar:
        for seed in bar:
            campaign = draw_hard(seed, suite, kind)
            campaign.write(out / f"{suite}_{seed:05d}")


if __name__ == "__main__":
    main()
