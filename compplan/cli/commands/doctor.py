"""`compplan doctor`: what is odd about the installation, a robot folder or a log."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click
from rich.markup import escape

from compplan.cli.doctor import Remark, examine_installation, examine_log, examine_robot
from compplan.cli.options import Answer, make_command, robot_option
from compplan.cli.terminal import format_table
from compplan.errors import InputError
from compplan.io.provenance import describe_origin
from compplan.robot import load_robot
from compplan.toolpath.readers import list_suffixes

#: How a state looks on a terminal.
COLOURS = {"fine": "green", "note": "cyan", "odd": "yellow"}


@make_command(
    click.argument("target", required=False),
    robot_option("Robot that the log was taken on: folder or shipped robot.", required=False),
)
def command(target: str | None, robot_name: str | None) -> Answer:
    """Look at TARGET and say what is odd: a robot (folder or name) or a measurement log; without it the installation.

    Example: compplan doctor measurements.csv --robot ur10
    """
    _refuse_others(target)
    if target is not None and Path(target).is_file():
        findings = examine_log(Path(target), None if robot_name is None else load_robot(robot_name))
    elif target is not None and Path(target).suffix.lower() == ".csv":
        raise InputError("measurement log not found", file=Path(target))
    elif target is not None and robot_name is not None:
        raise InputError(f"--robot is the robot of a log, but {target!r} is no log: name one robot")
    elif target is not None or robot_name is not None:
        findings = examine_robot(load_robot(target if target is not None else str(robot_name)))
    else:
        findings = examine_installation()
    summary = {"findings": [asdict(finding) for finding in findings], "made_by": describe_origin()}
    return Answer(summary, _describe_findings(findings))


def _refuse_others(target: str | None) -> None:
    """Refuse what another command takes, and name that."""
    if target is None or Path(target).is_dir():
        return
    suffix = Path(target).suffix.lower()
    if suffix == ".toml":
        sentence = f"is no robot folder and no log; if it is a job: compplan plan {target} --out out"
        raise InputError(sentence, file=target)
    if suffix in list_suffixes():
        sentence = f"is a CAM file; compplan convert {target} --out path.csv writes its toolpath, "
        raise InputError(
            f"{sentence}compplan init job.toml --robot ROBOT --toolpath {target} a job for it", file=target
        )


def _describe_findings(findings: list[Remark]) -> list[str]:
    """Return the findings as lines for people."""
    rows = []
    for finding in findings:
        said = finding.sentence + (f"; {finding.advice}" if finding.advice else "")
        rows.append((f"[{COLOURS[finding.state]}]{finding.state}[/]", finding.about, escape(said)))
    odd = sum(finding.state == "odd" for finding in findings)
    count = f"{odd} odd of {len(findings)} looked at" if odd else f"nothing odd; {len(findings)} looked at"
    return [*format_table(rows), count]
