"""Input of a measurement log for API functions and commands: mounted tool, measured point, plausibility questions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compplan.api.given import load_with_tool
from compplan.diagnosis.data.plausibility import check_plausibility
from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.checks import check_runs
from compplan.measurement.instrument import read_instrument
from compplan.measurement.reading import read_campaign
from compplan.robot import Robot

#: Greatest valid distance of a measured point from the TCP, along an axis. [mm]
MOST_OFFSET = 1e4


def read_measured(
    measurements: Any, robot: str | Path | Robot, *, tool: Mapping[str, Any] | Path | None = None,
    target_offset_mm: Sequence[float] | None = None, instrument: str | Path | None = None,
) -> tuple[Robot, Campaign]:  # fmt: skip
    """Read a robot with its mounted tool, and a log with its measured point.

    Raises:
        InputError: If a file or the offset is not valid.
    """
    mounted, campaign = load_with_tool(robot, tool), measurements
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(
            measurements, mounted, None if instrument is None else read_instrument(Path(instrument))
        )
    if instrument is not None and campaign.observations is None:
        message = "an instrument is given, but the log has none of the columns contact, reading_mm, distance_mm"
        raise InputError(message, file=campaign.file)
    if target_offset_mm is not None:
        offset = np.asarray(target_offset_mm, float)
        if offset.shape != (3,) or not (np.abs(offset) <= MOST_OFFSET).all():
            expected = f"expected three numbers X, Y, Z in mm, at most {MOST_OFFSET:.0f} each"
            raise InputError(f"the target offset is {list(target_offset_mm)}, {expected}")
        campaign = replace(campaign, target_offset=offset * 1e-3)
    return mounted, campaign


def choose_frames(register: Sequence[str], campaign: Campaign) -> tuple[str, ...]:
    """Return the frames to fit: those given, otherwise the tool if an instrument observes an unknown point."""
    unknown = campaign.observations is not None and not campaign.measured.any() and campaign.target_offset is None
    return tuple(register) or (("tool",) if unknown else ())


def resolve_questions(robot: Robot, campaign: Campaign, register: Sequence[str], assume_ok: bool) -> list[str]:
    """Return the plausibility questions about a log before a fit, as sentences, if they are assumed to be answered.

    Raises:
        InputError: With the first question that is not answered.
    """
    check_runs(campaign)
    questions = check_plausibility(robot, campaign, register)
    if questions and not assume_ok:
        raise InputError(f"{questions[0].sentence} (to continue anyway: --assume-ok)", file=campaign.file)
    return [question.sentence for question in questions]
