"""Diagnose a campaign the plain way: python -m benchmarks rival LOG.csv --robot DIR --out FILE."""

from __future__ import annotations

import json
from pathlib import Path

import click

from benchmarks.rival.answer import diagnose


@click.command()
@click.argument("log", type=click.Path(path_type=Path, exists=True))
@click.option("--robot", required=True, type=click.Path(path_type=Path, exists=True), help="Robot folder.")
@click.option("--register", default="", help="base, tool or both, with a comma.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="JSON file to write.")
def main(log: Path, robot: Path, register: str, out: Path) -> None:
    """Write the answer to a measurement log."""
    answer = diagnose(robot, log, [r for r in register.split(",") if r])
    out.write_text(json.dumps(answer.table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
