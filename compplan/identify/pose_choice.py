"""Choose poses and loads that tell the most: D-optimal subsets of a candidate set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.identify.forward import attain_rows, differentiate, frame_parameters
from compplan.identify.parameters import FreeRobot, Parameter
from compplan.identify.rows import KNOWN_FRAMES, Rows, make_log
from compplan.identify.separability import find_free
from compplan.identify.system import invert
from compplan.known.exchange import exchange_taken, take_greedily
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

MAX_SWEEPS = 30
#: Limits on standard errors are aimed at with this margin, and weighed against the determinant by this factor.
LIMIT_MARGIN = 0.97
LIMIT_PENALTY = 50.0


@dataclass(frozen=True)
class PoseCandidates:
    """Poses with one load each, of which some are to be measured.

    Attributes:
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
    """

    q: Array
    wrench: Array

    def __len__(self) -> int:
        return len(self.q)


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


def draw_candidates(
    robot: Robot,
    count: int,
    *,
    force: float = 1000.0,
    lever: float = 0.3,
    vertical: bool = False,
    least_height: float | None = 0.1,
    seed: int = 0,
) -> PoseCandidates:
    """Draw poses inside the joint limits, each with a force in a random direction on a lever beside the tool axis.

    Args:
        robot: The robot.
        count: Number of candidates.
        force: Size of the force. [N]
        lever: Distance of its point of attack from the TCP, across the tool axis, on a random side. [m]
        vertical: Forces point down (weights) instead of anywhere.
        least_height: Poses whose TCP is lower than this above the base frame are left out; None keeps them. [m]
        seed: Seed of the draw.

    Raises:
        InputError: If hardly any pose inside the limits is above the least height.
    """
    rng = np.random.default_rng(seed)
    chain, poses = build_chain(robot), np.empty((0, robot.nq))
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    lower = np.where(robot.prismatic, np.maximum(robot.lower, -1e3), lower)
    upper = np.where(robot.prismatic, np.minimum(robot.upper, 1e3), upper)
    for _ in range(20):
        q = rng.uniform(lower, upper, (2 * count, robot.nq))
        high = np.full(len(q), True)
        if least_height is not None:
            high = locate_frames(chain, q).tcp_position[:, 2] >= least_height
        poses = np.vstack([poses, q[high]])
        if len(poses) >= count:
            break
    else:
        raise InputError(f"fewer than 1 pose in 40 lies {least_height} m above the base; lower the least height")
    q = poses[:count]
    direction = rng.standard_normal((count, 3))
    if vertical:
        direction[:] = [0.0, 0.0, -1.0]
    pull = force * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    side = rng.uniform(0, 2 * np.pi, count)
    arm = lever * np.column_stack([np.cos(side), np.sin(side), np.zeros(count)])
    arm = np.einsum("nij,nj->ni", locate_frames(chain, q).tcp_rotation, arm)
    return PoseCandidates(q, np.hstack([pull, np.cross(arm, pull)]))


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
    free = find_free(flat.T @ flat, parameters)
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
        return _gains(rows, prior + flat.T @ flat, goal)

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


def _gains(rows: Array, matrix: Array, bound: Array | None) -> Array:
    """Compute log det(1 + A M^-1 A^T) of every candidate, less a penalty on variances above a bound. Shape (n,)."""
    inverse = np.linalg.inv(matrix)
    spread = rows @ inverse
    inner = np.eye(rows.shape[1]) + spread @ np.swapaxes(rows, 1, 2)
    gain = np.asarray(np.linalg.slogdet(inner)[1])
    if bound is None:
        return gain
    variance = np.diag(inverse) - np.einsum("nmp,nmp->np", spread, np.linalg.solve(inner, spread))
    over = np.maximum(np.log(np.maximum(variance, 1e-300) / bound), 0.0)
    return np.asarray(gain - LIMIT_PENALTY * over.sum(axis=1))
