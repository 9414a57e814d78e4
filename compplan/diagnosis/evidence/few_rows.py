"""Few rows: the evidence where a campaign has fewer values than a model has columns, solved among the values.

A tracker campaign has a hundred values, the errors that may explain them have four hundred columns: the covariance
of the values is then the smaller matrix. Turned so that the first value of every stay is its mean (times the root of
its rows), the values have independent noise,

    v = noise (1 + n lambda^2) for the mean of a stay of n rows,    v = noise for what its rows differ by,

and small errors Phi_B of variance D_B add V = diag(v) + Phi_B D_B Phi_B^T. Columns that may be large (claims, frames
that are fitted freely) are solved for by themselves, so that V stays well conditioned:

    S = (1/D_A + Phi_A^T V^-1 Phi_A)^-1,    a = S Phi_A^T V^-1 y,    b = D_B Phi_B^T V^-1 (y - Phi_A a)

which is the same as the solution among the columns (compplan.diagnosis.evidence.evidence) by Woodbury's identity
[Rasmussen2006, A.3].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.evidence.cholesky import factorize, invert_triangle, multiply_triangle, solve_factor
from compplan.diagnosis.evidence.normal_equations import ChannelProducts
from compplan.robot import Array


@dataclass(frozen=True, eq=False)
class FewRows:
    """The values of all channels, and the active columns.

    Attributes:
        small: Columns of small errors, in units of the noise, turned. Shape (N, b).
        large: Columns that are solved for by themselves. Shape (N, w).
        observed: Values, in units of the noise, turned. Shape (N,).
        size: Rows of the stay whose mean a value is, 0 for none. Shape (N,).
        channel: Channel of each value. Shape (N,).
        wide: Which of the active columns are solved for by themselves. Shape (a,).
    """

    small: Array
    large: Array
    observed: Array
    size: Array
    channel: NDArray[np.int_]
    wide: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SolvedRows:
    """The solution at one noise and background.

    Attributes:
        value: Log likelihood, without constant.
        inverse: Inverse of the lower factor of V. Shape (N, N).
        wide: Wide columns, whitened by it. Shape (N, w).
        inner: Lower factor of 1 + R Phi_A^T V^-1 Phi_A R, R the wide columns' standard deviations. Shape (w, w).
        deviation: Those standard deviations. Shape (w,).
        variance: Prior variance of all columns. Shape (a,).
        large: Values of the wide columns. Shape (w,).
        pull: V^-1 (y - Phi_A a). Shape (N,).
        noise: Variance v. Shape (N,).
        shared: What the error that a stay shares adds to it. Shape (N,).
    """

    value: float
    inverse: Array
    wide: Array
    inner: Array
    deviation: Array
    variance: Array
    large: Array
    pull: Array
    noise: Array
    shared: Array

    def across(self, white: Array) -> Array:
        """Return what the wide columns take of whitened columns. Shape (N, k) -> (w, k)."""
        return np.asarray(invert_triangle(self.inner) @ (self.deviation[:, None] * (self.wide.T @ white)))


def gather_rows(
    channels: Sequence[ChannelProducts], active: NDArray[np.int_], wide: NDArray[np.bool_]
) -> FewRows | None:
    """Gather the values of all channels; None where there are no fewer of them than of the active columns.

    Args:
        channels: The products.
        active: Active columns.
        wide: Which of these may be large. Shape (active,).
    """
    if sum(channel.total.count for channel in channels) >= len(active):
        return None
    rows = [channel.rows for channel in channels]
    if any(part is None for part in rows):
        return None
    parts = [part for part in rows if part is not None]
    return FewRows(
        np.asfortranarray(np.concatenate([part.design.take(active[~wide], axis=1) for part in parts])),
        np.concatenate([part.design.take(active[wide], axis=1) for part in parts]),
        np.concatenate([part.observed for part in parts]),
        np.concatenate([part.size for part in parts]),
        np.repeat(np.arange(len(parts)), [len(part.observed) for part in parts]),
        wide,
    )


def solve_rows(rows: FewRows, variance: Array, log_noise: Array, log_shared: Array) -> SolvedRows:
    """Solve at one noise and background.

    Args:
        rows: Values and columns.
        variance: Prior variance of the columns. Shape (a,).
        log_noise: Logarithm of each channel's noise variance over its estimate. Shape (channels,).
        log_shared: Logarithm of the shared error over the noise, standard deviations. Shape (channels,).
    """
    single = np.exp(log_noise)[rows.channel]
    shared = single * rows.size * np.exp(2.0 * log_shared)[rows.channel]
    noise = single + shared
    small = rows.small * np.sqrt(variance[~rows.wide])
    covariance = small @ small.T
    covariance[np.diag_indices_from(covariance)] += noise
    lower = factorize(covariance)
    inverse = invert_triangle(lower)
    observed, wide = inverse @ rows.observed, inverse @ rows.large
    deviation = np.sqrt(variance[rows.wide])
    scaled = wide * deviation
    inner = factorize(scaled.T @ scaled + np.eye(len(deviation)))
    large = deviation * solve_factor(inner, scaled.T @ observed)
    left = observed - wide @ large
    log_det = 2.0 * float(np.sum(np.log(np.diag(lower))) + np.sum(np.log(np.diag(inner))))
    value = -0.5 * (log_det + float(observed @ left))
    return SolvedRows(value, inverse, wide, inner, deviation, variance, large, inverse.T @ left, noise, shared)


def row_slopes(rows: FewRows, done: SolvedRows, channels: int) -> tuple[Array, Array, Array]:
    """Return the derivatives of the log likelihood by log noise, log shared error, and the variance of each column.

    With P = (V + Phi_A D_A Phi_A^T)^-1 and its pull P y: 1/2 ((c^T P y)^2 - c^T P c) for every column c. Those of wide
    columns are not asked for and zero. Shapes (channels,), (channels,), (a,).

    Args:
        rows: Values and columns.
        done: The solution.
        channels: Number of channels.
    """
    by_value = 0.5 * (done.pull**2 - _precision_squares(done, done.inverse))
    of_columns = np.zeros(len(rows.wide))
    squares = _precision_squares(done, multiply_triangle(done.inverse, rows.small))
    of_columns[~rows.wide] = 0.5 * ((done.pull @ rows.small) ** 2 - squares)
    of_noise = np.bincount(rows.channel, by_value * done.noise, channels)
    of_shared = np.bincount(rows.channel, by_value * 2.0 * done.shared, channels)
    return np.asarray(of_noise), np.asarray(of_shared), of_columns


def _precision_squares(done: SolvedRows, white: Array) -> Array:
    """Return c^T P c of columns c that V has whitened. Shape (N, k) -> (k,)."""
    across = done.across(white)
    return np.asarray(np.einsum("nk,nk->k", white, white) - np.einsum("nk,nk->k", across, across))


def row_mean(rows: FewRows, done: SolvedRows) -> Array:
    """Return the values of the columns. Shape (a,)."""
    mean = np.zeros(len(rows.wide))
    mean[rows.wide], mean[~rows.wide] = done.large, done.variance[~rows.wide] * (done.pull @ rows.small)
    return mean


def row_covariance(rows: FewRows, done: SolvedRows) -> Array:
    """Return the covariance of the columns. Shape (a, a)."""
    wide, small = np.flatnonzero(rows.wide), np.flatnonzero(~rows.wide)
    scaled = done.variance[small]
    covariance = np.zeros((len(rows.wide), len(rows.wide)))
    white = multiply_triangle(done.inverse, rows.small) * scaled
    root = invert_triangle(done.inner) * done.deviation
    across = root @ (done.wide.T @ white)
    covariance[np.ix_(wide, wide)] = root.T @ root
    covariance[np.ix_(wide, small)] = -root.T @ across
    covariance[np.ix_(small, wide)] = covariance[np.ix_(wide, small)].T
    covariance[np.ix_(small, small)] = np.diag(scaled) - white.T @ white + across.T @ across
    return covariance
