"""Quantiles of the length of normal error vectors, and conformal calibration of error bands."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from scipy.special import gammaincinv

from compplan.robot import Array

LEVEL = 0.95
#: Greatest calibration factor: a larger one would indicate an invalid error model.
MOST_FACTOR = 20.0


def band_radius(covariance: Array, level: float = LEVEL, mean: Array | None = None) -> Array:
    """Return the quantile of the length of a normal error of three components. Shape (n, 3, 3) -> (n,). [m]

    The quantile of |m + x|^2, x of covariance V, from its first three cumulants [Buckley1988]: tr V + m.m,
    2 tr V^2 + 4 m.V m, 8 tr V^3 + 24 m.V^2 m. Exact for m = 0 if all nonzero eigenvalues of V are equal.

    Args:
        covariance: Covariance of the error. Shape (n, 3, 3). [m^2]
        level: The probability.
        mean: Mean of the error, zero if left out. Shape (n, 3). [m]
    """
    bias = np.zeros((len(covariance), 3)) if mean is None else mean
    first = np.trace(covariance, axis1=1, axis2=2) + np.einsum("ni,ni->n", bias, bias)
    some = np.trace(covariance, axis1=1, axis2=2) > 1e-12 * first
    scale = np.where(some, first, 3.0)
    unit = np.where(some[:, None, None], covariance, np.eye(3)) / scale[:, None, None]
    shift = np.where(some[:, None], bias, 0.0) / np.sqrt(scale)[:, None]
    square, along = unit @ unit, np.einsum("nij,nj->ni", unit, shift)
    second = 2.0 * np.trace(square, axis1=1, axis2=2) + 4.0 * np.einsum("ni,ni->n", shift, along)
    third = 8.0 * np.einsum("nij,nji->n", square, unit) + 24.0 * np.einsum("ni,ni->n", along, along)
    quantile = 1.0 + np.sqrt(second) * _fit_quantile(level)(0.5 * third / second**1.5)
    return np.asarray(np.sqrt(first * np.where(some, np.maximum(quantile, 0.0), 1.0)))


@cache
def _fit_quantile(level: float) -> Chebyshev:
    """Fit the standardised quantile of chi-square by half its skewness, at most sqrt(2), to 1e-10."""
    return Chebyshev.interpolate(lambda t: t * (gammaincinv(t**-2, level) - t**-2), 16, [0.0, np.sqrt(2.0)])


def calibrate_band(error: Array, model: Array, noise: Array, group: NDArray[np.int_]) -> tuple[float, int]:
    """Find the least factor k >= 1 on the model's deviations whose band covers the errors of poses left out of the fit.

    Split conformal over groups [Vovk2005]: the score of a group is the mean square of its errors over their radii, and
    the ceil((m + 1) LEVEL)-th of m scores may not exceed one. With fewer groups than the level needs (19 for 95 %) the
    largest score counts. Returns the factor, at most `MOST_FACTOR`, and the number of groups.

    Args:
        error: Measured minus predicted, of rows left out of the fit. Shape (n, 3). [m]
        model: Covariance of the prediction. Shape (n, 3, 3). [m^2]
        noise: Covariance of the measurement. Shape (n, 3, 3). [m^2]
        group: Group of each row, such as its pose. Shape (n,).
    """
    if not len(error):
        return 1.0, 0
    _, index, count = np.unique(group, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    square = np.sum(error**2, axis=1)
    rank = min(int(np.ceil((len(count) + 1) * LEVEL)), len(count))

    def score(factor: float) -> float:
        radius = band_radius(factor**2 * model + noise)
        scores = np.bincount(index, square / np.maximum(radius, 1e-12) ** 2) / count
        return float(np.sort(scores)[rank - 1])

    low, high = 1.0, MOST_FACTOR
    if score(low) <= 1.0:
        return 1.0, len(count)
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if score(middle) > 1.0 else (low, middle)
    return float(high), len(count)
