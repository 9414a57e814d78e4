"""What commands that read a measurement log ask for: the tool, the measured point, and whether oddities are meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from compplan.cli.options import INPUT, add_options, split_numbers
from compplan.diagnosis.data.plausibility import ask_unit, build_rows_model, check_plausibility
from compplan.errors import InputError
from compplan.io.tomlfile import check_table, read_named_table
from compplan.measurement.campaign import Campaign
from compplan.measurement.checks import check_runs
from compplan.measurement.instrument import read_instrument
from compplan.measurement.reading import read_campaign
from compplan.measurement.registration import parse_parts
from compplan.robot import Array, Robot, load_robot

#: Farthest that a measured point may be from the TCP, along an axis. [mm]
MOST_OFFSET = 1e4

measured_options = add_options(
    click.option("--tool", type=INPUT,
                 help="TOML file with position_mm, rotation_deg, mass_kg, centre_of_mass_mm, as [tool] of a job; "
                 "without a mass its weight is not known and bends nothing."),
    click.option("--target-offset", metavar="X,Y,Z",
                 help="Measured point in the TCP frame, mm; left out: the TCP. With --register tool it is where "
                 "the fit begins."),
    click.option("--instrument", type=INPUT,
                 help="TOML file of an instrument that sees no positions: contacts (ball in a socket, tip on a "
                 "cone), readings along a direction (dial gauge, probe), distances (ball bar). The tool is fitted "
                 "unless --target-offset says it."),
)  # fmt: skip


def load_measured(
    measurements: Path, robot_name: str, tool: Path | None = None, target_offset: str | None = None,
    instrument: Path | None = None,
) -> tuple[Robot, Campaign]:  # fmt: skip
    """Load a robot with the tool that was mounted, and a log with the point that was measured.

    Raises:
        InputError: If a file or the offset is not what it has to be.
    """
    robot = load_robot(robot_name)
    if tool is not None:
        from compplan.job.frames import ToolTable

        data, key = read_named_table(tool, "tool")
        robot = check_table(ToolTable, data, file=tool, key=key).mount(robot)
    campaign = read_campaign(measurements, robot, None if instrument is None else read_instrument(instrument))
    if instrument is not None and campaign.sights is None:
        raise InputError(
            f"--instrument {instrument.name} is given, but the log has none of the columns contact, reading_mm,"
            " distance_mm", file=measurements,
        )  # fmt: skip
    if target_offset is not None:
        campaign = replace(campaign, target_offset=_parse_offset(target_offset))
    return robot, campaign


def registered_parts(register: str | None, campaign: Campaign) -> tuple[str, ...]:
    """Return the frames to fit: those that --register names, or the tool of an instrument that sees no positions.

    Who puts a ball into sockets hardly ever knows where it sits on the flange: the rows tell it.

    Raises:
        InputError: If --register names anything else.
    """
    parts = parse_parts(register)
    unknown = campaign.sights is not None and not campaign.measured.any() and campaign.target_offset is None
    return ("tool",) if register is None and unknown else parts


def _parse_offset(text: str) -> Array:
    """Read the value of --target-offset. Shape (3,). [mm] -> [m]."""
    try:
        offset = np.array(split_numbers(text, 3))
    except ValueError:
        offset = np.full(3, np.nan)
    if not (np.abs(offset) <= MOST_OFFSET).all():
        raise InputError(
            f"--target-offset is {text!r}, expected three numbers X,Y,Z in mm, at most {MOST_OFFSET:.0f} each"
        )
    return offset * 1e-3


def read_log(log: Path | None, robot: Robot, instrument: Path | None = None) -> Campaign | None:
    """Read a log whose distances are those that its joints say, in mm; None where there is none.

    Raises:
        InputError: If it is no log, or in another unit.
    """
    if log is None:
        return None
    campaign = read_campaign(log, robot, None if instrument is None else read_instrument(instrument))
    question = ask_unit(build_rows_model(robot, campaign))
    if question is not None:
        raise InputError(question.sentence, file=log)
    return campaign


def settle_questions(robot: Robot, campaign: Campaign, parts: Sequence[str], assume_ok: bool) -> list[str]:
    """Return the questions that a log raises before anything is fitted, as sentences, where they are assumed answered.

    Raises:
        InputError: With the first question that is not answered.
    """
    check_runs(campaign)
    questions = check_plausibility(robot, campaign, parts)
    if questions and not assume_ok:
        raise InputError(f"{questions[0].sentence} (to continue anyway: --assume-ok)", file=campaign.file)
    return [question.sentence for question in questions]
