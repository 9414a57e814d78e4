"""`compplan identify`: compliances of a robot from a measurement log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from compplan.cli.measured import load_measured, measured_options, registered_parts, settle_questions
from compplan.cli.options import INPUT, assume_ok, json_summary, out_folder, robot_option
from compplan.cli.terminal import show, show_progress
from compplan.effects.requested import GEOMETRY
from compplan.errors import InputError
from compplan.identification.campaign import identify_campaign
from compplan.identification.parameters import LINK_TERMS
from compplan.identification.problem import IdentifyOptions
from compplan.job.names import EFFECTS
from compplan.measurement.checks import list_notes
from compplan.measurement.fit.least_squares import LOSSES
from compplan.measurement.registration import parse_parts
from compplan.reporting.identify import describe_identification, write_identification


@click.command(epilog=f"Effects: {', '.join(EFFECTS)}.")
@click.argument("measurements", type=INPUT, required=False)
@robot_option()
@out_folder
@click.option("--register", help='Frames that are unknown: "base", "tool" or "base,tool".')
@click.option("--springs", help="Springs to identify, by name; default: those of the robot and one a joint.")
@click.option("--add", help='Springs that the robot lacks and gets, such as "joint_3.rx,base_joint.ry".')
@click.option("--stepwise", is_flag=True, help="Try a spring about every axis; keep those that improve the prediction.")
@click.option("--links", type=click.Choice(LINK_TERMS), help="Terms of the links' 6x6 elasticities to identify.")
@click.option("--effects", help='Effects to fit too, such as "backlash,joint_coupling@joint_5:of joint_4".')
@click.option("--geometry", type=click.Choice([*GEOMETRY, "auto"]), default="auto", help="Geometry fitted along.")
@click.option("--reference", type=click.Choice(["absolute", "difference", "auto"]), default="auto",
              help="Absolute positions, or each pose against itself under other loads.")  # fmt: skip
@click.option("--loss", type=click.Choice(LOSSES), default="tukey", help="How rows far from the model count.")
@click.option("--choose-poses", hidden=True, help="Gone: compplan campaign chooses poses.")
@measured_options
@assume_ok
@json_summary
def command(
    measurements: Path | None, robot_name: str, folder: Path, register: str | None, springs: str | None,
    add: str | None, effects: str | None, choose_poses: str | None, instrument: Path | None, tool: Path | None,
    target_offset: str | None, assume_ok: bool, as_json: bool, **choices: Any,
) -> None:  # fmt: skip
    """Identify the compliances of ROBOT from MEASUREMENTS (a measurement log), with 95 % intervals.

    Writes DIR/robot (the updated robot folder) and DIR/identify.json.

    Example: compplan identify examples/identify/measurements.csv --robot kuka_kr270 --out out
    """
    options = IdentifyOptions(
        register=parse_parts(register), springs=None if springs is None else _split(springs), add=_split(add or ""),
        effects=_split(effects or ""), **choices,
    )  # fmt: skip
    if measurements is None or choose_poses is not None:
        fault = "no measurement log is given" if choose_poses is None else "--choose-poses is gone"
        raise InputError(f"{fault}; compplan campaign JOB --poses N --for calibration chooses poses to measure")
    robot, campaign = load_measured(measurements, robot_name, tool, target_offset, instrument)
    options = replace(options, register=registered_parts(register, campaign))
    settle_questions(robot, campaign, options.register, assume_ok)
    with show_progress() as progress:
        found = identify_campaign(robot, campaign, options, progress=progress)
    summary = write_identification(found, folder, list(campaign.notes))
    wrote = f"wrote {folder / 'robot'}, {folder / 'identify.json'} and {folder / 'report.html'}"
    show(summary, as_json, [*describe_identification(summary), *list_notes(campaign.notes), wrote])


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
