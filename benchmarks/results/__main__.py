"""Measure what docs/results says: `python -m benchmarks results [NAME ...] [--out DIR] [--real DIR]`."""

from __future__ import annotations

import csv
import platform
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import click

from benchmarks.results import PAGES
from benchmarks.results.chart import draw_chart, read_table
from benchmarks.results.findings import ROOT, Findings, MissingError, Settings

#: Packages whose versions a page names.
PACKAGES = ("casadi", "pin", "mujoco", "numpy", "scipy")


def describe_tree() -> str:
    """Return the commit of the tree, and whether it holds changes beyond it."""

    def ask(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    changed = [line for line in ask("status", "--porcelain").splitlines() if "docs/results/" not in line]
    return (ask("rev-parse", "--short", "HEAD") or "unknown") + (" with uncommitted changes" if changed else "")


def describe_machine() -> str:
    """Return processor, cores and system."""
    import os

    info = Path("/proc/cpuinfo")
    names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
    return f"{os.cpu_count()} cores ({(names or [platform.machine()])[0]}), {platform.system()} {platform.machine()}"


def write_page(name: str, page: ModuleType, found: Findings, seconds: float, folder: Path) -> Path:
    """Write a page."""
    versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    blocks = [
        f"# {page.TITLE}",
        f"**Question.** {page.QUESTION}",
        "## In short\n\n" + "\n".join(f"- {line}" for line in found.short),
        "## What falls short\n\n"
        + "\n".join(f"- {line}" for line in found.losses or ("Nothing that was asked here.",)),
        "## Figures",
        *found.tables,
        "## How it was measured\n\n" + page.METHOD,
        "## Limitations\n\n" + "\n".join(f"- {line}" for line in page.LIMITS),
        "## Made by\n\n"
        f"    python -m benchmarks results {name}\n\n"
        f"{datetime.now(UTC):%Y-%m-%d}, commit {describe_tree()}, {describe_machine()}, Python "
        f"{platform.python_version()}, {versions}; {seconds / 60.0:.0f} min. The cores may have had other work.",
    ]
    file = folder / f"{name}.md"
    file.parent.mkdir(parents=True, exist_ok=True)
    if found.data:
        titles, cells = read_table(found.data)
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as table:
            csv.writer(table, lineterminator="\n").writerows([titles, *cells])
    if hasattr(page, "CHART"):
        place = f"charts/{name}.png"
        draw_chart(found.data or "\n\n".join(blocks), page.CHART, folder / place)
        blocks.insert(2, f"![{page.CHART.label}]({place})")
    file.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")
    return file


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(PAGES)))
@click.option("--out", type=click.Path(path_type=Path), default=ROOT / "docs" / "results", help="Folder of the pages.")
@click.option("--work", type=click.Path(path_type=Path), help="Folder to keep what the benchmarks leave.")
@click.option("--real", type=click.Path(path_type=Path, exists=True), help="Folder of measured campaigns.")
@click.option("--shops", type=click.IntRange(min=1), help="Simulated shops of a page that plays some.")
@click.option("--figaroh-python", type=click.Path(path_type=Path, exists=True), help="Interpreter that has FIGAROH.")
def main(
    names: tuple[str, ...], out: Path, work: Path | None, real: Path | None, shops: int | None,
    figaroh_python: Path | None,
) -> None:  # fmt: skip
    """Measure and write the pages NAMES (all)."""
    for name in names or PAGES:
        with tempfile.TemporaryDirectory() as folder:
            place = (work or Path(folder)) / name
            place.mkdir(parents=True, exist_ok=True)
            given = real and real.resolve(), figaroh_python and figaroh_python.absolute()
            settings = Settings(place.resolve(), *given, shops)
            start = time.monotonic()
            try:
                found = PAGES[name].measure(settings)
            except MissingError as reason:
                click.echo(f"{name}: not measured: {reason}", err=True)
                continue
            click.echo(str(write_page(name, PAGES[name], found, time.monotonic() - start, out)))


if __name__ == "__main__":
    sys.exit(main())
