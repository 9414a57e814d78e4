"""`compplan certificate`: how a robot stands today, on one page."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.commands.completion import complete_robots
from compplan.cli.commands.places import OUT_FILE
from compplan.io.tables import dump_json


@click.command("certificate")
@click.argument("robot_name", metavar="ROBOT", shell_complete=complete_robots)
@click.option("--log", "log", type=click.Path(path_type=Path),
              help="Measurement log: diagnosed, and taken for accuracy and repeatability.")
@click.option("--since", "older", help="Robot folder of the last certificate: drift.")
@click.option("--job", "jobs", type=click.Path(path_type=Path), multiple=True,
              help="Job whose path is looked at, in place of circles of the robot's own size; may be repeated.")
@click.option("--register", help="Frames that the diagnosis of the log fits first: base, tool or base,tool.")
@click.option("--instrument", type=click.Path(path_type=Path),
              help="TOML file of the log's instrument, where that sees no positions.")  # fmt: skip
@click.option("--out", "file", type=OUT_FILE, required=True, help="HTML file to write.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    robot_name: str, log: Path | None, older: str | None, jobs: tuple[Path, ...], register: str | None,
    instrument: Path | None, file: Path, as_json: bool,
) -> None:  # fmt: skip
    """Certify ROBOT: stiffness, lost motion, gear error, drift, and the tolerance within reach, on one page.

    With --log the answer is that of compplan diagnose on the same log, against the folder of --since if one is given.

    Example: compplan certificate out/robot --log campaign.csv --since last/robot --out certificate.html
    """
    from compplan.cli.commands.measured import read_log, registered_parts
    from compplan.cli.commands.progress import show_progress
    from compplan.errors import InputError
    from compplan.job.job import load_job
    from compplan.learning.certificate import certify_robot
    from compplan.measurement.registration import parse_parts
    from compplan.reporting.certificate_page import describe_certificate
    from compplan.reporting.writers.certificate import write_certificate
    from compplan.robot import load_robot

    if file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out is {str(file)!r}, expected a file that ends in .html")
    robot = load_robot(robot_name)
    before = None if older is None else load_robot(older)
    if before is not None and before.joint_names != robot.joint_names:
        raise InputError(f"robot {before.name!r} has other joints than {robot.name!r}: no drift between them")
    campaign = read_log(log, robot, instrument)
    parts = parse_parts(register) if campaign is None else registered_parts(register, campaign)
    paths = [load_job(job, robot_name) for job in jobs]
    with show_progress() as announce:
        announce("paths, stiffness, drift" if campaign is None else "diagnosis of the log, paths, stiffness, drift")
        certificate = certify_robot(robot, campaign, before, paths, parts)
        announce("report")
        summary = write_certificate(certificate, file)
    if as_json:
        click.echo(dump_json(summary, indent=2))
        return
    click.echo(describe_certificate(certificate).replace("\u00a0", " "))
    for sentence in certificate.next_steps:
        click.echo(f"next: {sentence}")
    click.echo(f"wrote {file}")
