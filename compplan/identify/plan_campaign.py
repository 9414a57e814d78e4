"""Plan a campaign: which poses and loads tell the most (D-optimal), and what standard errors they promise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.identify.forward import attain_rows, differentiate, frame_parameters
from compplan.identify.parameters import FreeRobot, Parameter
from compplan.identify.problem import IdentifyOptions, build_considered, list_forms
from compplan.identify.rows import KNOWN_FRAMES, Rows
from compplan.identify.separability import tell_apart
from compplan.measure.fit.system import invert
from compplan.measure.made import make_log
from compplan.measure.poses.exchange import exchange_taken, take_greedily
from compplan.measure.poses.information import determinant_gains
from compplan.measure.poses.pool import PoseCandidates, draw_candidates
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot

CANDIDATES = 2000
MAX_SWEEPS = 30
#: Limits on standard errors are aimed at with this margin, and weighed against the determinant by this factor.
LIMIT_MARGIN = 0.97
LIMIT_PENALTY = 50.0


@dataclass(frozen=True)
class PoseInformation:
    """What each candidate tells about the parameters.

    Attributes:
        parameters: The parameters that the whole candidate set can tell. Length p.
        rows: Weighted derivatives, in typical sizes of the parameters. Shape (n, m, p).
    """

    parameters: tuple[Parameter, ...]
    rows: Array

    def standard_errors(self, chosen: Sequence[int] | NDArray[np.int_]) -> Array:
        """Predict the standard errors that chosen candidates give; infinite where they cannot tell. Shape (p,)."""
        flat = self.rows[np.asarray(chosen)].reshape(-1, self.rows.shape[2])
        matrix = flat.T @ flat
        if np.linalg.matrix_rank(matrix, hermitian=True) < len(matrix):
            return np.full(len(matrix), np.inf)
        sizes = np.array([parameter.size for parameter in self.parameters])
        return np.asarray(np.sqrt(np.diag(invert(matrix))) * sizes)


def weigh_candidates(
    structure: FreeRobot,
    candidates: PoseCandidates,
    *,
    orientation: bool = True,
    sigma_position: float = 4e-5,
    sigma_rotation: float = 5e-5,
    registration: Registration | None = None,
) -> PoseInformation:
    """Weigh what each candidate tells, at the nominal parameters.

    Args:
        structure: Robot and the parameters to identify.
        candidates: The candidates.
        orientation: Whether orientation is measured.
        sigma_position: Standard deviation of position per axis. [m]
        sigma_rotation: Standard deviation of orientation per axis. [rad]
        registration: Frames that are fitted along.

    Raises:
        InputError: If the candidates tell nothing.
    """
    n = len(candidates)
    blank = np.broadcast_to(np.eye(3), (n, 3, 3)) if orientation else None
    log = make_log(candidates.q, candidates.wrench, np.zeros((n, 3)), blank)
    rows = Rows(log, np.arange(n), KNOWN_FRAMES if registration is None else registration)
    columns = differentiate(rows, attain_rows(structure, structure.nominal, rows, rows.registration))[0]
    sigma = np.repeat([sigma_position, sigma_rotation], 3)
    used = slice(0, 6 if orientation else 3)
    parameters = (*structure.parameters, *frame_parameters(rows.registration, orientation))
    white = columns[:, used] / sigma[used, None]
    flat = white.reshape(-1, white.shape[2])
    free = tell_apart(flat.T @ flat, parameters)
    if not free.any():
        raise InputError("these candidates tell nothing about the parameters; give loads")
    kept = tuple(parameter for parameter, keep in zip(parameters, free, strict=True) if keep)
    return PoseInformation(kept, white[:, :, free] * np.array([parameter.size for parameter in kept]))


def choose_poses(
    information: PoseInformation,
    count: int,
    *,
    allowed: NDArray[np.int_] | None = None,
    limits: Array | None = None,
) -> NDArray[np.int_]:
    """Choose D-optimal candidates (largest determinant of the information): greedy, then exchanges [Fedorov1972].

    Adding a candidate with rows A to the information M gains log det(1 + A M^-1 A^T).

    Args:
        information: What each candidate tells.
        count: How many to choose.
        allowed: Indices to choose from; all if left out.
        limits: Standard errors that no parameter shall exceed, such as those of random poses; the determinant gives way
            to them as little as it has to. Shape (p,).

    Returns:
        Indices of the chosen candidates, in rising order. Shape (count,).

    Raises:
        InputError: If there are fewer candidates than poses wanted.
    """
    pool = np.arange(len(information.rows)) if allowed is None else np.asarray(allowed)
    if len(pool) < count:
        raise InputError(f"{count} poses wanted of {len(pool)} candidates, expected at most as many")
    rows = information.rows[pool]
    sizes = np.array([parameter.size for parameter in information.parameters])
    bound = None if limits is None else (LIMIT_MARGIN * np.asarray(limits) / sizes) ** 2
    # A weak prior of ten typical sizes makes the first choices well defined.
    prior = 1e-2 * np.eye(rows.shape[2])

    def worth(taken: list[int], goal: Array | None = None) -> Array:
        flat = rows[taken].reshape(-1, rows.shape[2])
        gain, left = determinant_gains(np.asarray(np.linalg.inv(prior + flat.T @ flat)), rows)
        if goal is None:
            return gain
        over = np.maximum(np.log(np.maximum(left, 1e-300) / goal), 0.0)
        return np.asarray(gain - LIMIT_PENALTY * over.sum(axis=1))

    chosen = exchange_taken(worth, sorted(take_greedily(worth, count)), MAX_SWEEPS)
    if bound is not None:
        chosen = exchange_taken(partial(worth, goal=bound), sorted(chosen), MAX_SWEEPS)
    return np.sort(pool[chosen])


def compare_with_random(
    information: PoseInformation,
    count: int,
    *,
    draws: int = 200,
    seed: int = 0,
    allowed: NDArray[np.int_] | None = None,
) -> Array:
    """Predict the standard errors that random candidates give: their median over many draws. Shape (p,).

    Args:
        information: What each candidate tells.
        count: How many are drawn each time.
        draws: Number of draws.
        seed: Seed of the draws.
        allowed: Indices to draw from; all if left out.
    """
    rng = np.random.default_rng(seed)
    pool = np.arange(len(information.rows)) if allowed is None else np.asarray(allowed)
    errors = [information.standard_errors(rng.choice(pool, count, replace=False)) for _ in range(draws)]
    return np.asarray(np.median(errors, axis=0))


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
