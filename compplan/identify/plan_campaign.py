"""Plan a campaign: which poses and loads tell the most (D-optimal), and what standard errors they promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.errors import InputError
from compplan.identify.forward import attain_fit, differentiate, frame_parameters
from compplan.identify.parameters import FreeRobot
from compplan.identify.problem import IdentifyOptions, build_considered, list_forms
from compplan.identify.separability import tell_apart
from compplan.measure.campaign import Campaign
from compplan.measure.fit.rows import KNOWN_FRAMES, Rows
from compplan.measure.poses.determinant import CampaignPlan, PoseInformation, choose_poses, compare_with_random
from compplan.measure.poses.pool import draw_candidates
from compplan.measure.registration import Registration
from compplan.robot import Robot

CANDIDATES = 2000


def weigh_candidates(
    structure: FreeRobot,
    candidates: Campaign,
    *,
    sigma_position: float = 4e-5,
    sigma_rotation: float = 5e-5,
    registration: Registration | None = None,
) -> PoseInformation:
    """Weigh what each candidate tells, at the nominal parameters.

    Args:
        structure: Robot and the parameters to identify.
        candidates: Rows that could be measured.
        sigma_position: Standard deviation of position per axis. [m]
        sigma_rotation: Standard deviation of orientation per axis. [rad]
        registration: Frames that are fitted along.

    Raises:
        InputError: If the candidates tell nothing.
    """
    n = len(candidates)
    log = replace(candidates, rotation=np.broadcast_to(np.eye(3), (n, 3, 3)))
    rows = Rows(log, np.arange(n), KNOWN_FRAMES if registration is None else registration)
    columns = differentiate(rows, attain_fit(structure, structure.nominal, rows, rows.registration))[0]
    sigma = np.repeat([sigma_position, sigma_rotation], 3)
    parameters = (*structure.parameters, *frame_parameters(rows.registration, True))
    white = columns[:, :6] / sigma[:, None]
    flat = white.reshape(-1, white.shape[2])
    free = tell_apart(flat.T @ flat, parameters)
    if not free.any():
        raise InputError("these candidates tell nothing about the parameters; give loads")
    sizes = np.array([parameter.size for parameter in parameters])[free]
    names = tuple(parameter.name for parameter, keep in zip(parameters, free, strict=True) if keep)
    units = tuple(parameter.unit for parameter, keep in zip(parameters, free, strict=True) if keep)
    return PoseInformation(names, units, sizes, white[:, :, free] * sizes)


def plan_campaign(
    robot: Robot, options: IdentifyOptions, count: int, *, force: float, lever: float, seed: int = 0
) -> CampaignPlan:
    """Choose the poses and loads that tell the most about what `options` ask for, none worse than random ones do.

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
    rows = Rows(candidates, np.arange(len(candidates)), frames)
    structure = build_considered(robot, options, list_forms(robot, options, rows))
    information = weigh_candidates(structure, candidates, registration=frames)
    if 6 * count <= len(information.sizes):
        least = len(information.sizes) // 6 + 1
        raise InputError(f"{count} poses for {len(information.sizes)} parameters, expected at least {least}")
    limits = compare_with_random(information, count, seed=seed + 1)
    chosen = choose_poses(information, count, limits=limits)
    return CampaignPlan(robot, candidates.take(chosen), information, information.standard_errors(chosen), limits)
