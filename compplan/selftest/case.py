"""A case of a study: what a diagnosis is given, a later campaign of the same robot, and the truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.measure.campaign import Campaign, read_campaign
from compplan.robot import Robot, load_robot

#: Kinds of cases: how many effects of the vocabulary, and whether there is one outside it.
KINDS = ("single", "double", "triple", "none", "unknown", "partly", "indistinguishable")
MIX = ("single",) * 9 + ("double",) * 4 + ("triple",) * 2 + ("unknown",) * 3 + ("none",) * 2 + ("partly",)
DIFFICULTIES = ("clean", "realistic")


@dataclass(frozen=True, eq=False)
class Case:
    """One case.

    Attributes:
        robot: The nominal robot.
        campaign: The log that a diagnosis is given.
        fresh: A later log of the same robot: other poses, other loads.
        truth: kind, difficulty, effects (each with those that the campaign cannot tell from it), background, floor.
    """

    robot: Robot
    campaign: Campaign
    fresh: Campaign
    truth: dict[str, Any]


def kind_of(number: int) -> tuple[str, str]:
    """Return kind and difficulty of the case of a number, so that any range of numbers is mixed."""
    return MIX[number % len(MIX)], DIFFICULTIES[(number // len(MIX) + number) % 2]


def read_case(folder: Path) -> Case:
    """Read a case from a folder with robot/, measurements.csv, fresh.csv and truth.json.

    Raises:
        InputError: If truth.json is missing or no JSON.
    """
    file = folder / "truth.json"
    try:
        truth = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise InputError(f"cannot be read: {error}; expected the truth of a simulated campaign", file=file) from None
    robot = load_robot(folder / "robot")
    given, fresh = (read_campaign(folder / name, robot) for name in ("measurements.csv", "fresh.csv"))
    return Case(robot, given, fresh, truth)
