"""Poses that tell parameters best: the largest determinant of the information [Fedorov1972]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.measure.campaign import Campaign
from compplan.measure.fit.system import invert
from compplan.measure.poses.exchange import exchange_taken, take_greedily
from compplan.measure.poses.information import determinant_gains, weigh_rows
from compplan.robot import Array, Robot

MAX_SWEEPS = 30
#: Limits on standard errors are aimed at with this margin, and weighed against the determinant by this factor.
LIMIT_MARGIN = 0.97
LIMIT_PENALTY = 50.0


@dataclass(frozen=True)
class PoseInformation:
    """What each candidate tells about the parameters.

    Attributes:
        names: Names of the parameters that the whole candidate set can tell. Length p.
        units: Their units. Length p.
        sizes: Their typical sizes. Shape (p,).
        rows: Weighted derivatives, in typical sizes of the parameters. Shape (n, m, p).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    sizes: Array
    rows: Array

    def standard_errors(self, chosen: Sequence[int] | NDArray[np.int_]) -> Array:
        """Predict the standard errors that chosen candidates give; infinite where they cannot tell. Shape (p,)."""
        flat = self.rows[np.asarray(chosen)].reshape(-1, self.rows.shape[2])
        matrix = flat.T @ flat
        if np.linalg.matrix_rank(matrix, hermitian=True) < len(matrix):
            return np.full(len(matrix), np.inf)
        return np.asarray(np.sqrt(np.diag(invert(matrix))) * self.sizes)


def choose_poses(information: PoseInformation, count: int, *, limits: Array | None = None) -> NDArray[np.int_]:
    """Choose D-optimal candidates (largest determinant of the information): greedy, then exchanges [Fedorov1972].

    Adding a candidate with rows A to the information M gains log det(1 + A M^-1 A^T).

    Args:
        information: What each candidate tells.
        count: How many to choose.
        limits: Standard errors that no parameter shall exceed, such as those of random poses; the determinant gives way
            to them as little as it has to. Shape (p,).

    Returns:
        Indices of the chosen candidates, in rising order. Shape (count,).

    Raises:
        InputError: If there are fewer candidates than poses wanted.
    """
    rows = information.rows
    if len(rows) < count:
        raise InputError(f"{count} poses wanted of {len(rows)} candidates, expected at most as many")
    bound = None if limits is None else (LIMIT_MARGIN * np.asarray(limits) / information.sizes) ** 2

    def held(mean: Array, covariance: Array, rows: Array) -> Array:
        gain, left = determinant_gains(covariance, rows)
        over = np.maximum(np.log(np.maximum(left, 1e-300) / bound), 0.0)
        return np.asarray(gain - LIMIT_PENALTY * over.sum(axis=1))

    # a weak prior of ten typical sizes makes the first choices well defined
    prior = 1e2 * np.eye(rows.shape[2])
    worth = weigh_rows(lambda mean, covariance, rows: determinant_gains(covariance, rows)[0], prior, rows, 1.0)
    chosen = exchange_taken(worth, sorted(take_greedily(worth, count)), MAX_SWEEPS)
    if bound is not None:
        chosen = exchange_taken(weigh_rows(held, prior, rows, 1.0), sorted(chosen), MAX_SWEEPS)
    return np.sort(chosen)


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
        poses: The chosen poses and loads, nothing measured yet.
        information: What every candidate tells.
        promised: Predicted standard errors of the chosen poses. Shape (p,).
        random: Those of as many random poses. Shape (p,).
    """

    robot: Robot
    poses: Campaign
    information: PoseInformation
    promised: Array
    random: Array
