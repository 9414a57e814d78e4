"""Plan a campaign: which poses and loads to measure, and what standard errors they promise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compplan.errors import InputError
from compplan.identify.pose_choice import (
    PoseCandidates,
    PoseInformation,
    choose_poses,
    compare_with_random,
    draw_candidates,
    weigh_candidates,
)
from compplan.identify.problem import IdentifyOptions, build_considered, list_forms
from compplan.identify.rows import KNOWN_FRAMES, Rows, make_log
from compplan.robot import Array, Robot

CANDIDATES = 2000


@dataclass(frozen=True)
class CampaignPlan:
    """Poses and loads to measure.

    Attributes:
        robot: The robot.
        poses: The chosen poses and loads.
        information: What every candidate tells.
        promised: Predicted standard errors of the chosen poses. Shape (p,).
        random: Those of as many random poses. Shape (p,).
    """

    robot: Robot
    poses: PoseCandidates
    information: PoseInformation
    promised: Array
    random: Array


def plan_campaign(
    robot: Robot, options: IdentifyOptions, count: int, *, force: float, lever: float, seed: int = 0
) -> CampaignPlan:
    """Choose the poses and loads that tell the most about what `options` ask for.

    Args:
        robot: The robot.
        options: Parameters to identify; frames to be registered count.
        count: Number of poses.
        force: Size of the force. [N]
        lever: Distance of its point of attack from the TCP. [m]
        seed: Seed of the candidates.

    Raises:
        InputError: If there are too few poses for the parameters, or the force is not above zero.
    """
    if not (np.isfinite(force) and force > 0 and np.isfinite(lever) and lever >= 0):
        given = f"force {force:g} N on a lever of {lever * 1e3:g} mm"
        raise InputError(f"{given}, expected a force above 0 and a lever from 0")
    candidates = draw_candidates(robot, max(CANDIDATES, 2 * count), force=force, lever=lever, seed=seed)
    frames = replace(KNOWN_FRAMES, parts=options.register)
    log = make_log(candidates.q, candidates.wrench, np.zeros((len(candidates), 3)))
    structure = build_considered(robot, options, list_forms(robot, options, Rows(log, np.arange(len(log)), frames)))
    information = weigh_candidates(structure, candidates, registration=frames)
    if 6 * count <= len(information.parameters):
        least = len(information.parameters) // 6 + 1
        raise InputError(f"{count} poses for {len(information.parameters)} parameters, expected at least {least}")
    limits = compare_with_random(information, count, seed=seed + 1)
    chosen = choose_poses(information, count, limits=limits)
    return CampaignPlan(
        robot=robot,
        poses=PoseCandidates(candidates.q[chosen], candidates.wrench[chosen]),
        information=information,
        promised=information.standard_errors(chosen),
        random=limits,
    )


def describe_campaign_plan(summary: dict[str, Any]) -> list[str]:
    """Say in lines for people what the chosen poses promise."""
    lines = [f"{summary['robot']}: {summary['poses']} poses; assumed: {summary['assumed']}"]
    lines.append(f"{'parameter':<26}{'unit':<12}{'standard error':>16}{'random poses':>14}")
    for entry in summary["parameters"]:
        name, unit, promised = entry["name"], entry["unit"], entry["standard_error"]
        lines.append(f"{name:<26}{unit:<12}{promised:>16.4g}{entry['standard_error_of_random_poses']:>14.4g}")
    return [*lines, f"geometric mean of the standard errors: {summary['ratio_to_random']:.2f} of random poses"]
