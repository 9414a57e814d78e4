"""Draw campaigns: `python -m benchmarks.campaigns draw --suite tracker --seeds 0:120 --out DIR`.

`clean` draws the campaigns with the plain forms of `effects.py`; `draw` the hard ones of `suite.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from benchmarks.campaigns.draw import DIFFICULTIES, draw_campaign
from benchmarks.campaigns.draw import KINDS as CLEAN_KINDS
from benchmarks.campaigns.suite import KINDS, REPORTING, SUITES, draw_hard

MIX = (
    ("single",) * 8 + ("double",) * 4 + ("triple",) * 2 + ("unknown",) * 3 + ("none",) * 2 + ("indistinguishable",) * 2
)


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


@main.command()
@click.option("--seed", type=int, required=True, help="Seed of the first campaign; the next ones count up.")
@click.option("--count", type=int, default=1, show_default=True, help="How many campaigns.")
@click.option("--kind", type=click.Choice(["mixed", *CLEAN_KINDS]), default="mixed", show_default=True)
@click.option("--difficulty", type=click.Choice(["mixed", *DIFFICULTIES]), default="mixed", show_default=True)
@click.option("--effect", "effects", multiple=True, help="Name of an effect; may be repeated.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
def clean(seed: int, count: int, kind: str, difficulty: str, effects: tuple[str, ...], out: Path) -> None:
    """Draw campaigns with the plain forms of the vocabulary's effects."""
    seeds = range(seed, seed + count)
    with click.progressbar(seeds, label="campaigns", file=sys.stderr, hidden=not sys.stderr.isatty()) as bar:
        for number in bar:
            chosen = MIX[number % len(MIX)] if kind == "mixed" else kind
            grade = DIFFICULTIES[(number // len(MIX) + number) % 2] if difficulty == "mixed" else difficulty
            campaign = draw_campaign(number, chosen, grade, list(effects) or None)
            campaign.write(out / f"{chosen}_{grade}_{number}")


if __name__ == "__main__":
    main()
