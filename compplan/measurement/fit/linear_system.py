"""The linearised problem of a fit: residuals, derivatives, weights and what they leave over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.measurement.fit.robust import robust_scale
from compplan.robot import Array

POSITION, ORIENTATION, ENCODERS, DISTANCES = range(4)
#: Blocks, and those whose noise the residuals tell: known distances are too few for that.
BLOCKS, TOLD_BLOCKS = 4, 3
#: The residuals never say less than this share of the stated noise: simulated data may hold none.
LEAST_NOISE = 1e-6


class System(NamedTuple):
    """Residuals and derivatives at one state; m components a row: 6 of the pose, then the encoders.

    A row that tells one number of the position has it first. Known distances between contacts follow as components of
    the first row of a contact.
    """

    residual: Array  #: Measured minus predicted, zero where nothing was measured. Shape (n, m).
    columns: Array  #: Derivatives of the prediction. Shape (n, m, p).
    sigma: Array  #: Stated standard deviation, infinite where nothing was measured. Shape (n, m).
    block: NDArray[np.int_]  #: Position, orientation, encoders or known distances. Shape (m,).

    @property
    def known(self) -> NDArray[np.bool_]:
        """Tell what was measured. Shape (n, m)."""
        return np.isfinite(self.sigma)

    def whitener(self, noise: Array) -> Array:
        """Take one over the standard deviation, zero where nothing was measured. Shape (n, m)."""
        return 1.0 / (self.sigma * noise[self.block])

    @property
    def seen(self) -> Array:
        """Count what each row saw itself: a known distance between contacts is no part of the row. Shape (n,)."""
        return np.asarray(self.known[:, self.block != DISTANCES].sum(axis=1))

    def distance(self, noise: Array) -> Array:
        """Measure how far what the rows saw lies from the model, in standard deviations. Shape (n,)."""
        away = self.residual * self.whitener(noise)
        return np.asarray(np.linalg.norm(away[:, self.block != DISTANCES], axis=1))

    def temper(self, weights: Array) -> Array:
        """Return the roots of robust weights; known distances keep theirs. Shape (n, m)."""
        return np.where(self.block == DISTANCES, 1.0, np.sqrt(weights)[:, None])


def weigh(system: System, whitener: Array, group: NDArray[np.int_] | None) -> tuple[Array, Array]:
    """Weigh the system; with groups, take off each group's weighted mean first. Shapes (n, m), (n, m, p)."""
    residual, columns = system.residual, system.columns
    if group is not None:
        power = whitener**2
        total = np.zeros((int(group.max()) + 1, power.shape[1]))
        np.add.at(total, group, power)
        share = power / np.where(total > 0, total, 1.0)[group]
        mean, mean_columns = np.zeros_like(total), np.zeros((*total.shape, columns.shape[2]))
        np.add.at(mean, group, share * residual)
        np.add.at(mean_columns, group, share[..., None] * columns)
        residual, columns = residual - mean[group], columns - mean_columns[group]
    return residual * whitener, columns * whitener[..., None]


def stack(columns: Array) -> Array:
    """Put the components of all rows under one another. Shape (n, m, p) -> (n m, p)."""
    n, m, p = columns.shape
    return np.reshape(columns, (n * m, p))


def information(system: System, whitener: Array, group: NDArray[np.int_] | None) -> Array:
    """Build the information matrix A^T W A. Shape (p, p)."""
    flat = stack(weigh(system, whitener, group)[1])
    return np.asarray(flat.T @ flat)


def invert(matrix: Array) -> Array:
    """Invert an information matrix whose parameters differ by orders of magnitude."""
    norms = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(norms, norms)) / np.outer(norms, norms))


def count_spare(system: System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_]) -> Array:
    """Count the measured numbers of each block less what the fit uses up (the trace of the hat matrix). Shape (3,)."""
    columns = weigh(system, whitener, group)[1][:, :, free]
    flat = stack(columns)
    inverse = invert(flat.T @ flat)
    spare = np.zeros(TOLD_BLOCKS)
    for block in range(TOLD_BLOCKS):
        part, known = stack(columns[:, system.block == block]), system.known[:, system.block == block]
        spare[block] = known.sum() - np.sum((part.T @ part) * inverse)
        if group is not None:
            spare[block] -= sum(len(np.unique(group[known[:, c]])) for c in range(known.shape[1]))
    return spare


def scale_noise(
    system: System, noise: Array, free: NDArray[np.bool_], group: NDArray[np.int_] | None, loss: str
) -> Array:
    """Estimate how large the noise is against the stated one, for position, orientation and encoders apart.

    Variance components: residual sum of squares of a block over what the fit leaves of it. Robust losses take the
    median size of the residuals instead.

    Args:
        system: The linearised problem.
        noise: Estimate before. Shape (3,).
        free: Which parameters are estimated. Shape (p,).
        group: Number of the pose of each row, for differences; None for absolute poses. Shape (n,).
        loss: "least_squares", "huber" or "tukey".
    """
    result, whitener = noise.copy(), system.whitener(noise)
    left = count_spare(system, whitener, group, free)
    residual = weigh(system, whitener, group)[0]
    for block in range(TOLD_BLOCKS):
        columns = system.block == block
        known = system.known[:, columns]
        spare = left[block]
        if not known.any():
            continue
        if loss == "least_squares":
            factor = np.sqrt((residual[:, columns] ** 2).sum() / max(spare, 1.0))
        else:
            told = known.sum(axis=1)
            rows = told == told.max()
            size = np.linalg.norm(residual[rows][:, columns], axis=1)
            factor = robust_scale(size, int(told.max())) / np.sqrt(max(spare / known.sum(), 0.02))
        result[block] = max(noise[block] * factor, LEAST_NOISE)
    return result
