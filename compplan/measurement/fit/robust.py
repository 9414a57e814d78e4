"""Losses that gross outliers cannot pull far: Huber and Tukey, for rows of several components at once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gammaincinv, gammaln, xlogy

from compplan.errors import UnknownNameError
from compplan.robot import Array

LOSSES = ("least_squares", "huber", "tukey")
EFFICIENCY = 0.95


def check_loss(loss: str) -> str:
    """Return a loss that exists.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if loss not in LOSSES:
        raise UnknownNameError("loss", loss, list(LOSSES))
    return loss


def loss_weights(loss: str, distance: Array, count: Array) -> tuple[Array, Array]:
    """Weigh rows by how far they lie from the model.

    Args:
        loss: "least_squares", "huber" or "tukey".
        distance: Norm of a row's residuals over their standard deviations. Shape (n,).
        count: Components of the row that were measured. Shape (n,).

    Returns:
        Weights w in [0, 1], and their slopes dw/d(distance). Shape (n,) each.
    """
    if check_loss(loss) == "least_squares":
        return np.ones_like(distance), np.zeros_like(distance)
    counts, place = np.unique(count, return_inverse=True)
    c = np.array([tuning_constant(loss, int(m)) if m else 1.0 for m in counts])[place.ravel()]
    if loss == "huber":
        far = distance > c
        safe = np.where(far, distance, 1.0)
        return np.where(far, c / safe, 1.0), np.where(far, -c / safe**2, 0.0)
    u = distance / c
    inside = u < 1
    return np.where(inside, (1 - u**2) ** 2, 0.0), np.where(inside, -4 * u * (1 - u**2) / c, 0.0)


@lru_cache(maxsize=64)
def tuning_constant(loss: str, components: int) -> float:
    """Find the constant at which a loss keeps 95 % efficiency under normal noise in `components` dimensions."""
    scale = np.log(2.0) * (1.0 - 0.5 * components) - gammaln(0.5 * components)

    def density(d: float) -> float:
        return float(np.exp(scale + xlogy(components - 1.0, d) - 0.5 * d**2))

    def efficiency(c: float) -> float:
        def expect(g: object) -> float:
            return float(quad(lambda d: g(d) * density(d), 0, 12 + components, limit=200, points=[c])[0])  # type: ignore[operator]

        def weight(d: float) -> float:
            return (1.0 if d <= c else c / d) if loss == "huber" else max(0.0, 1 - (d / c) ** 2) ** 2

        def slope(d: float) -> float:
            if loss == "huber":
                return 0.0 if d <= c else -c / d**2
            return -4 * d / c**2 * max(0.0, 1 - (d / c) ** 2)

        spread = expect(lambda d: (weight(d) * d) ** 2) / components
        return expect(lambda d: weight(d) + slope(d) * d / components) ** 2 / spread - EFFICIENCY

    return float(brentq(efficiency, 0.3 * np.sqrt(components), 8 + components, xtol=1e-4))


def robust_scale(residual: Array, components: int = 1) -> float:
    """Estimate the standard deviation of residuals about zero from their median size."""
    size = np.abs(residual[np.isfinite(residual)])
    return float(np.median(size) / np.sqrt(2.0 * gammaincinv(0.5 * components, 0.5))) if len(size) else 1.0
