"""Draw campaigns from the command line: `python -m benchmarks.campaigns --seed 1 --count 10 --out campaigns`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from benchmarks.campaigns.draw import DIFFICULTIES, KINDS, draw_campaign

MIX = (
    ("single",) * 8 + ("double",) * 4 + ("triple",) * 2 + ("unknown",) * 3 + ("none",) * 2 + ("indistinguishable",) * 2
)


@click.command()
@click.option("--seed", type=int, required=True, help="Seed of the first campaign; the next ones count up.")
@click.option("--count", type=int, default=1, show_default=True, help="How many campaigns.")
@click.option("--kind", type=click.Choice(["mixed", *KINDS]), default="mixed", show_default=True)
@click.option("--difficulty", type=click.Choice(["mixed", *DIFFICULTIES]), default="mixed", show_default=True)
@click.option("--effect", "effects", multiple=True, help="Name of an effect; may be repeated.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
def main(seed: int, count: int, kind: str, difficulty: str, effects: tuple[str, ...], out: Path) -> None:
    """Draw measurement campaigns with known effects and write one folder a campaign."""
    seeds = range(seed, seed + count)
    with click.progressbar(seeds, label="campaigns", file=sys.stderr, hidden=not sys.stderr.isatty()) as bar:
        for number in bar:
            chosen = MIX[number % len(MIX)] if kind == "mixed" else kind
            grade = DIFFICULTIES[(number // len(MIX) + number) % 2] if difficulty == "mixed" else difficulty
            campaign = draw_campaign(number, chosen, grade, list(effects) or None)
            campaign.write(out / f"{chosen}_{grade}_{number}")


if __name__ == "__main__":
    main()
