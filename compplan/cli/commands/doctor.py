"""`compplan doctor`: what is odd about the installation, a robot folder or a log."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

from compplan.cli.commands.options import complete_robots
from compplan.cli.doctor import Remark, examine_installation, examine_log, examine_robot
from compplan.errors import InputError
from compplan.io.provenance import describe_origin
from compplan.io.tables import dump_json
from compplan.robot import load_robot
from compplan.toolpath.readers import list_suffixes

#: How a state looks on a terminal.
COLOURS = {"fine": "green", "note": "cyan", "odd": "yellow"}


@click.command("doctor")
@click.argument("target", required=False)
@click.option("--robot", "robot_name", default=None, shell_complete=complete_robots,
              help="Robot that the log was taken on: folder or shipped robot.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(target: str | None, robot_name: str | None, as_json: bool) -> None:
    """Look at TARGET and say what is odd: a robot (folder or name) or a measurement log; without it the installation.

    Example: compplan doctor measurements.csv --robot ur10
    """
    _refuse_others(target)
    if target is not None and Path(target).is_file():
        findings = examine_log(Path(target), None if robot_name is None else load_robot(robot_name))
    elif target is not None and Path(target).suffix.lower() == ".csv":
        raise InputError("no such measurement log", file=Path(target))
    elif target is not None and robot_name is not None:
        raise InputError(f"--robot is the robot of a log, but {target!r} is no log: name one robot")
    elif target is not None or robot_name is not None:
        findings = examine_robot(load_robot(target if target is not None else str(robot_name)))
    else:
        findings = examine_installation()
    if as_json:
        click.echo(dump_json({"findings": [asdict(finding) for finding in findings], "made_by": describe_origin()}))
        return
    _print_findings(findings)


def _refuse_others(target: str | None) -> None:
    """Refuse what another command takes, and name that."""
    suffix = "" if target is None else Path(target).suffix.lower()
    if target is None or Path(target).is_dir():
        return
    if suffix == ".toml":
        sentence = f"is no robot folder and no log; if it is a job: compplan plan {target} --out out"
    elif suffix in list_suffixes():
        sentence = (f"is a CAM file; compplan convert {target} --out path.csv writes its toolpath, "
                    f"compplan init job.toml --robot ROBOT --toolpath {target} writes a job for it")  # fmt: skip
    else:
        return
    raise InputError(sentence, file=target)


def _print_findings(findings: list[Remark]) -> None:
    table = RichTable(box=None, show_header=False, pad_edge=False)
    for finding in findings:
        said = finding.sentence + (f"; {finding.advice}" if finding.advice else "")
        table.add_row(f"[{COLOURS[finding.state]}]{finding.state}[/]", finding.about, escape(said))
    Console(highlight=False).print(table)
    odd = sum(finding.state == "odd" for finding in findings)
    click.echo(f"{odd} odd of {len(findings)} looked at" if odd else f"nothing odd; {len(findings)} looked at")
