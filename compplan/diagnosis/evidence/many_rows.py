"""Many rows: the evidence where a campaign has more values than a model has columns, solved among the columns.

With the products G = Phi^T N^-1 Phi and a = Phi^T N^-1 y, and D the prior variance of the columns,

    S = (1/D + G)^-1,    m = S a,    log p(y) = -1/2 (log det N + log det(1 + D G) + y^T N^-1 y - a^T m)

The noise N of a channel is v within a stay and v (1 + n lambda^2) for the mean of n rows, so that G is a sum of
products that do not depend on it (compplan.diagnosis.evidence.normal_equations), each with a weight that does:

    1/v of all rows,    -1/v n lambda^2 / (1 + n lambda^2) of the means of n rows

Where every stay has one row, the means are the rows: one product with the sum of both weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.evidence.cholesky import factorize, invert_factor, mirror_lower, solve_factor
from compplan.diagnosis.evidence.normal_equations import ChannelProducts, Products
from compplan.robot import Array


@dataclass(frozen=True, eq=False)
class ProductWeights:
    """How products K enter the evidence.

    Attributes:
        channel: Channel of each. Shape (K,).
        size: Rows of the stays whose means they are of; 0 for all rows of a channel with longer stays. Shape (K,).
        whole: 1 for products of all rows of a channel, 0 for means beside them. Shape (K,).
        count: Number of values. Shape (K,).
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
    """Products of the active columns.

    Attributes:
        weights: How they enter.
        gram: Columns with columns. Shape (K, a a).
        against: Columns with observations. Shape (K, a).
        square: Observations with themselves. Shape (K,).
    """

    weights: ProductWeights
    gram: Array
    against: Array
    square: Array


@dataclass(frozen=True, eq=False)
class SolvedColumns:
    """The solution at one noise and background.

    Attributes:
        value: Log likelihood, without constant.
        weight: Weights of the products. Shape (K,).
        lower: Lower factor of 1 + R G R, R the columns' standard deviations. Shape (a, a).
        deviation: Those standard deviations. Shape (a,).
        mean: Values of the columns. Shape (a,).
        pull: a - G m. Shape (a,).
    """

    value: float
    weight: Array
    lower: Array
    deviation: Array
    mean: Array
    pull: Array

    @cached_property
    def triangle(self) -> Array:
        """Lower triangle of the covariance of the columns, zeros above. Shape (a, a)."""
        inverse = invert_factor(self.lower)
        inverse *= self.deviation[:, None]
        inverse *= self.deviation
        return inverse

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the columns. Shape (a, a)."""
        return mirror_lower(self.triangle)


def list_products(channels: Sequence[ChannelProducts]) -> tuple[ProductWeights, list[Products]]:
    """List the products of all channels, each once, and how they enter."""
    found: list[tuple[int, int, float, Products]] = []
    for number, channel in enumerate(channels):
        beside = {size: means for size, means in channel.means.items() if means is not channel.total}
        own = [size for size in channel.means if size not in beside]
        found.append((number, own[0] if own else 0, 1.0, channel.total))
        found += [(number, size, 0.0, means) for size, means in beside.items()]
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


def solve_columns(rows: ManyRows, variance: Array, log_noise: Array, log_shared: Array) -> SolvedColumns:
    """Solve at one noise and background.

    Args:
        rows: The products.
        variance: Prior variance of the columns. Shape (a,).
        log_noise: Logarithm of each channel's noise variance over its estimate. Shape (channels,).
        log_shared: Logarithm of the shared error over the noise, standard deviations. Shape (channels,).
    """
    weight = rows.weights.weigh(log_noise, log_shared)
    deviation = np.sqrt(variance)
    p = len(deviation)
    gram = (weight @ rows.gram).reshape(p, p)
    against = weight @ rows.against
    inner = gram * deviation
    inner *= deviation[:, None]
    inner.reshape(-1)[:: p + 1] += 1.0
    lower = factorize(inner)
    mean = deviation * solve_factor(lower, deviation * against)
    log_det = rows.weights.log_det(log_noise, log_shared) + 2.0 * float(np.sum(np.log(np.diag(lower))))
    value = -0.5 * (log_det + float(weight @ rows.square) - float(against @ mean))
    return SolvedColumns(value, weight, lower, deviation, mean, against - gram @ mean)


def column_slopes(
    rows: ManyRows, done: SolvedColumns, log_noise: Array, log_shared: Array
) -> tuple[Array, Array, Array]:
    """Return the derivatives of the log likelihood by log noise, log shared error, and the variance of each column.

    Shapes (channels,), (channels,), (a,).

    Args:
        rows: The products.
        done: The solution.
        log_noise: Logarithm of each channel's noise variance over its estimate. Shape (channels,).
        log_shared: Logarithm of the shared error over the noise, standard deviations. Shape (channels,).
    """
    weights, channels = rows.weights, len(log_noise)
    # second moment of the columns, a triangle twice standing for both
    own = np.diag(done.triangle)
    moment = np.outer(done.mean, done.mean)
    moment += 2.0 * done.triangle.T
    moment.reshape(-1)[:: len(own) + 1] -= own
    expected = rows.square - 2.0 * rows.against @ done.mean + rows.gram @ moment.reshape(-1)
    share = weights.share(log_shared)
    by_shared = np.exp(-log_noise)[weights.channel] * expected / (1.0 + share) - weights.count
    of_noise = np.bincount(weights.channel, 0.5 * (done.weight * expected - weights.whole * weights.count), channels)
    of_shared = np.bincount(weights.channel, share / (1.0 + share) * by_shared, channels)
    # G - G S G = 1/D - S/D^2 on the diagonal
    variance = np.maximum(done.deviation**2, 1e-300)
    return np.asarray(of_noise), np.asarray(of_shared), 0.5 * (done.pull**2 - (1.0 - own / variance) / variance)
