"""Likelihood of a campaign and posterior of the active columns, solved among the columns.

With the products G = Phi^T N^-1 Phi and a = Phi^T N^-1 y, and D the prior variance of the columns,

    S = (1/D + G)^-1,    m = S a,    log p(y) = -1/2 (log det N + log det(1 + D G) + y^T N^-1 y - a^T m)

The noise N of a channel is v within a stay and v (1 + n lambda^2) for the mean of n rows. G is therefore a sum of
products that do not depend on N (compplan.diagnosis.evidence.normal_equations), with weights that do:

    1/v of all rows,    -1/v n lambda^2 / (1 + n lambda^2) of the means of n rows

Where every stay has one row, the means are the rows: one product with the sum of both weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dlauum, dpotrf, dpotrs, dtrtri

from compplan.diagnosis.evidence.normal_equations import ChannelProducts, Products
from compplan.errors import ConvergenceError
from compplan.robot import Array

#: Size up to which a triangle is inverted as a whole (assumed: it fits into the cache).
BLOCK = 64


@dataclass(frozen=True, eq=False)
class Hyper:
    """Noise and background."""

    log_noise: Array  #: Logarithm of each channel's noise variance over its estimate. Shape (channels,).
    log_shared: Array  #: Logarithm of the shared error over the noise, standard deviations. Shape (channels,).
    log_tau: Array  #: Logarithm of the size of each background class over its scale. Shape (classes,).

    @property
    def vector(self) -> Array:
        """All hyperparameters in one vector."""
        return np.concatenate([self.log_noise, self.log_shared, self.log_tau])

    def with_vector(self, vector: Array) -> Hyper:
        """Return the hyperparameters in a vector."""
        c = len(self.log_noise)
        return Hyper(vector[:c].copy(), vector[c : 2 * c].copy(), vector[2 * c :].copy())


@dataclass(frozen=True, eq=False)
class ProductWeights:
    """Weights of K products in the evidence.

    `channel` is the channel of each, `size` the rows of its stays (0 for all rows of a channel with longer stays),
    `whole` 1 for products of all rows of a channel and 0 for further means, `count` the number of values.
    """

    channel: NDArray[np.int_]
    size: Array
    whole: Array
    count: Array

    def share(self, log_shared: Array) -> Array:
        """Return n lambda^2 of each. Shape (K,)."""
        return np.asarray(self.size * np.exp(2.0 * log_shared)[self.channel])

    def weigh(self, log_noise: Array, log_shared: Array) -> Array:
        """Return the weights. Shape (K,)."""
        share = self.share(log_shared)
        return np.asarray(np.exp(-log_noise)[self.channel] * (self.whole - share / (1.0 + share)))

    def log_det(self, log_noise: Array, log_shared: Array) -> float:
        """Return log det N."""
        single = self.whole * log_noise[self.channel] + np.log1p(self.share(log_shared))
        return float(self.count @ single)


@dataclass(frozen=True, eq=False)
class ManyRows:
    """Products K of the active columns: gram (K, a a) and against (K, a), and square (K,) of the observations."""

    weights: ProductWeights
    gram: Array
    against: Array
    square: Array

    def solve(self, variance: Array, hyper: Hyper) -> SolvedColumns:
        """Solve for given noise and prior variance of the columns. Shape (a,)."""
        weight = self.weights.weigh(hyper.log_noise, hyper.log_shared)
        deviation = np.sqrt(variance)
        p = len(deviation)
        gram = (weight @ self.gram).reshape(p, p)
        against = weight @ self.against
        inner = gram * deviation
        inner *= deviation[:, None]
        inner.reshape(-1)[:: p + 1] += 1.0
        lower = factorize(inner)
        mean = deviation * solve_factor(lower, deviation * against)
        log_det = self.weights.log_det(hyper.log_noise, hyper.log_shared) + 2.0 * float(np.sum(np.log(np.diag(lower))))
        value = -0.5 * (log_det + float(weight @ self.square) - float(against @ mean))
        return SolvedColumns(self, hyper, value, weight, lower, deviation, mean, against - gram @ mean)


@dataclass(frozen=True, eq=False)
class SolvedColumns:
    """The solution at one noise and background.

    `weight` holds the weights of the products (K,), `lower` the factor of 1 + R G R with the columns' deviations R
    (a,), `mean` the posterior means and `pull` a - G m (a,); `value` is the log likelihood, without constant.
    """

    rows: ManyRows
    hyper: Hyper
    value: float
    weight: Array
    lower: Array
    deviation: Array
    mean: Array
    pull: Array

    def compute_covariance(self) -> Array:
        """Return the covariance of the columns. Shape (a, a)."""
        return mirror_lower(_covariance_triangle(self.lower, self.deviation))

    def slopes(self) -> tuple[Array, Array, Array]:
        """Return the derivatives of the log likelihood by log noise, log shared error, and the columns' variances.

        Shapes (channels,), (channels,), (a,).
        """
        rows, weights, hyper = self.rows, self.rows.weights, self.hyper
        # second moment of the columns; twice a triangle replaces both
        triangle = _covariance_triangle(self.lower, self.deviation)
        diagonal = np.diag(triangle)
        moment = np.outer(self.mean, self.mean)
        moment += 2.0 * triangle.T
        moment.reshape(-1)[:: len(diagonal) + 1] -= diagonal
        expected = rows.square - 2.0 * rows.against @ self.mean + rows.gram @ moment.reshape(-1)
        share = weights.share(hyper.log_shared)
        by_shared = np.exp(-hyper.log_noise)[weights.channel] * expected / (1.0 + share) - weights.count
        by_noise = 0.5 * (self.weight * expected - weights.whole * weights.count)
        of_noise = np.bincount(weights.channel, by_noise, len(hyper.log_noise))
        of_shared = np.bincount(weights.channel, share / (1.0 + share) * by_shared, len(hyper.log_noise))
        # G - G S G = 1/D - S/D^2 on the diagonal
        variance = np.maximum(self.deviation**2, 1e-300)
        of_columns = 0.5 * (self.pull**2 - (1.0 - diagonal / variance) / variance)
        return np.asarray(of_noise), np.asarray(of_shared), of_columns


def _covariance_triangle(lower: Array, deviation: Array) -> Array:
    """Return the lower triangle of the covariance of columns, zeros above. Shape (a, a)."""
    inverse = invert_factor(lower)
    inverse *= deviation[:, None]
    inverse *= deviation
    return inverse


def list_products(channels: Sequence[ChannelProducts]) -> tuple[ProductWeights, list[Products]]:
    """List the inner products of all channels, each once, and their weights in the evidence."""
    found: list[tuple[int, int, float, Products]] = []
    for number, channel in enumerate(channels):
        further = {size: means for size, means in channel.means.items() if means is not channel.total}
        single = [size for size in channel.means if size not in further]
        found.append((number, single[0] if single else 0, 1.0, channel.total))
        found += [(number, size, 0.0, means) for size, means in further.items()]
    products = [part for *_, part in found]
    numbers, sizes, whole = (np.array([entry[k] for entry in found]) for k in range(3))
    count = np.array([part.count for part in products], float)
    return ProductWeights(numbers.astype(int), sizes.astype(float), whole, count), products


def gather_products(channels: Sequence[ChannelProducts], active: NDArray[np.int_]) -> ManyRows:
    """Gather the products of the active columns."""
    weights, products = list_products(channels)
    gram = np.empty((len(products), len(active), len(active)))
    for out, part in zip(gram, products, strict=True):
        np.take(part.gram.take(active, axis=0), active, axis=1, out=out, mode="clip")
    against = np.array([part.against[active] for part in products])
    return ManyRows(weights, gram.reshape(len(products), -1), against, np.array([part.square for part in products]))


def factorize(matrix: Array) -> Array:
    """Return the lower factor of a symmetric matrix that rounding may have made slightly indefinite. Shape (p, p)."""
    tried, jitter = matrix, float(np.finfo(float).eps)
    while jitter < 1.0:
        lower, failed = dpotrf(tried.T, lower=1, clean=1)
        if not failed:
            return np.asarray(lower)
        # jitter: rounding of all entries first, then a hundred times as much each time
        jitter *= 100.0
        tried = matrix + jitter * float(np.trace(matrix)) * np.eye(len(matrix))
    raise ConvergenceError("the evidence of a model cannot be computed, its columns are degenerate", residual=jitter)


def solve_factor(lower: Array, right: Array) -> Array:
    """Return (L L^T)^-1 b. Shape of b: (p,) or (p, k)."""
    return np.asarray(dpotrs(lower, right, lower=1)[0]) if len(lower) else right


def invert_triangle(lower: Array) -> Array:
    """Return L^-1, zeros above its diagonal included, by halves: LAPACK's own is half as fast. Shape (p, p)."""
    if len(lower) <= BLOCK:
        return np.asarray(dtrtri(lower, lower=1)[0]) if len(lower) else lower
    half = len(lower) // 2
    inverse = np.zeros(lower.shape, order="F")
    inverse[:half, :half], inverse[half:, half:] = (
        invert_triangle(lower[s, s]) for s in (slice(half), slice(half, None))
    )
    below = dtrmm(1.0, inverse[:half, :half], lower[half:, :half], side=1, lower=1)
    inverse[half:, :half] = dtrmm(-1.0, inverse[half:, half:], below, lower=1)
    return inverse


def invert_factor(lower: Array) -> Array:
    """Return the lower triangle of (L L^T)^-1, zeros above. Shape (p, p)."""
    return np.asarray(dlauum(invert_triangle(lower), lower=1, overwrite_c=1)[0]) if len(lower) else lower


def mirror_lower(triangle: Array) -> Array:
    """Return the symmetric matrix of a lower triangle with zeros above. Shape (p, p)."""
    full = triangle + triangle.T
    full[np.diag_indices_from(full)] *= 0.5
    return np.asarray(full)
