"""Study of the diagnosis on campaigns of independent software: MuJoCo, with every effect written there a second time.

    python -m benchmarks.diagnosis_study --out study                      the frozen study: 300 from seed 900000
    python -m benchmarks.diagnosis_study --out trial --campaigns 10 --seed 1000
    python -m benchmarks.diagnosis_study --out trial --folders DIR        campaigns that were written before

Every answer is kept in OUT/cases, so that an interrupted study goes on where it stopped. The scores are those of
`compplan selftest-diagnosis`. Every fourth campaign with one effect is diagnosed once more without it.
"""

from __future__ import annotations

import datetime
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from compplan.commands.selftest_diagnosis import show_bar
from compplan.selftest.case import Case, kind_of, read_case
from compplan.selftest.failures import list_failures
from compplan.selftest.page import describe_study, write_study
from compplan.selftest.study import Settings, run_study
from compplan.selftest.summary import summarise_study

#: Campaigns of the frozen study: thresholds and priors of the diagnosis were fixed before the first of them was drawn.
FROZEN_SEED, FROZEN_CAMPAIGNS = 900000, 300
#: Every so many campaigns are drawn so that their effect cannot be told from others.
INDISTINGUISHABLE_EVERY = 11


def draw_mujoco_case(number: int) -> Case:
    """Draw a campaign in MuJoCo and read it back as a diagnosis would.

    Args:
        number: Its seed; kind and difficulty follow from it.

    Raises:
        LookupError: If no campaign of this kind was found.
    """
    from benchmarks.campaigns.draw import draw_campaign

    kind, difficulty = study_kind(number)
    try:
        campaign = draw_campaign(number, kind, difficulty)
    except ValueError as error:
        raise LookupError(str(error)) from None
    with tempfile.TemporaryDirectory() as folder:
        return read_case(campaign.write(Path(folder) / f"{kind}_{difficulty}_{number}"))


def study_kind(number: int) -> tuple[str, str]:
    """Return kind and difficulty: the product's mix, and some campaigns whose effect cannot be told from others."""
    kind, difficulty = kind_of(number)
    return ("indistinguishable" if number % INDISTINGUISHABLE_EVERY == 0 else kind), difficulty


def read_numbered(folders: tuple[str, ...], number: int) -> Case:
    """Read the case of a number from a list of folders."""
    return read_case(Path(folders[number]))


@click.command()
@click.option("--campaigns", type=click.IntRange(min=1), default=FROZEN_CAMPAIGNS, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=FROZEN_SEED, show_default=True)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--workers", type=click.IntRange(min=1), default=2, show_default=True, help="Processes.")
@click.option("--withhold", type=click.IntRange(min=0), default=4, show_default=True, metavar="K",
              help="Diagnose every K-th single effect again without it; 0 for none.")  # fmt: skip
@click.option("--folders", type=click.Path(path_type=Path, exists=True), help="Campaigns that were written before.")
def main(campaigns: int, seed: int, out: Path, workers: int, withhold: int, folders: Path | None) -> None:
    """Diagnose MuJoCo campaigns without sight of their truth, and score the answers."""
    source: Callable[[int], Case] = draw_mujoco_case
    origin = f"MuJoCo (benchmarks/campaigns), seeds {seed} to {seed + campaigns - 1}"
    if folders is not None:
        found = tuple(str(file.parent) for file in sorted(folders.glob("*/truth.json")))
        source, seed, campaigns = partial(read_numbered, found), 0, min(campaigns, len(found))
        origin = f"{campaigns} folders"
    with show_bar("campaigns") as progress:
        records = run_study(source, Settings(campaigns, seed, workers, withhold), out, progress)
    summary = summarise_study(records)
    facts = [
        ("campaigns", f"{len(records)} of {campaigns}"),
        ("drawn from", origin),
        ("date", datetime.datetime.now(datetime.UTC).date().isoformat()),
    ]
    write_study(summary, list_failures(records), out, facts, "Hidden effects in campaigns of independent software")
    click.echo(describe_study(summary))


if __name__ == "__main__":
    main()
