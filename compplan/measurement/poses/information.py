"""What measurements tell: rows of derivatives and their noise, on a normal state of parameters and frames.

An aim is what each further measurement gains beside that state: of a variance, of the odds of two explanations.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from compplan.measurement.poses.exchange import Worth
from compplan.robot import Array

#: What each measurement gains beside a state: its mean (P,) and covariance (P, P), rows (m, c, P) -> (m,).
Gain = Callable[[Array, Array, Array], Array]


def weight_rows(gain: Gain, covariance: Array, rows: Array, noise: float, mean: Array | None = None) -> Worth:
    """Tell what every measurement is worth beside some that are taken, for an exchange.

    Args:
        gain: The aim.
        covariance: Before any of them. Shape (P, P).
        rows: Derivatives of each measurement. Shape (m, c, P).
        noise: Variance of each component.
        mean: Before any of them; zero if left out. Shape (P,).
    """
    before = np.zeros(len(covariance)) if mean is None else mean
    return lambda taken: gain(*explain_rows(before, covariance, rows[taken], noise), rows)


def learn_rows(covariance: Array, rows: Array, noise: float) -> Array:
    """Return the covariance after measurements, one after the other.

    Args:
        covariance: Shape (P, P).
        rows: Derivatives of each measurement. Shape (m, c, P).
        noise: Variance of each of its components.
    """
    return explain_rows(np.zeros(len(covariance)), covariance, rows, noise)[1]


def explain_rows(mean: Array, covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return what is left of a difference m, H m being what measurements show of it, and its covariance after them.

    Args:
        mean: The difference, such as of two explanations. Shape (P,).
        covariance: Shape (P, P).
        rows: Derivatives of each measurement. Shape (m, c, P).
        noise: Variance of each of its components.
    """
    for H in rows:
        along = covariance @ H.T
        gain = np.linalg.solve(H @ along + noise * np.eye(len(H)), along.T)
        mean, covariance = mean - gain.T @ (H @ mean), covariance - along @ gain
        covariance = 0.5 * (covariance + covariance.T)
    return mean, covariance


def _innovate(covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return H S and the covariance H S H^T + R of what each measurement shows. Shapes (m, c, P), (m, c, c)."""
    m, c, p = rows.shape
    along = (rows.reshape(m * c, p) @ covariance).reshape(m, c, p)
    return along, np.einsum("mip,mjp->mij", along, rows) + noise * np.eye(c)


def measure_gains(covariance: Array, rows: Array, weight: Array, noise: float) -> Array:
    """Return what each measurement would take off the trace of S W. Shape (m,).

    Args:
        covariance: Shape (P, P).
        rows: Derivatives of each measurement. Shape (m, c, P).
        weight: What the covariance is weighed with, W. Shape (P, P).
        noise: Variance of each component.
    """
    along, inner = _innovate(covariance, rows, noise)
    outer = np.einsum("mip,mjp->mij", (along.reshape(-1, len(weight)) @ weight).reshape(along.shape), along)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=1, axis2=2))


def odds_gains(mean: Array, covariance: Array, rows: Array, noise: float = 1.0) -> Array:
    """Return d^T (H S H^T + R)^-1 d / 2, d = H m: the expected log likelihood ratio of each measurement. Shape (m,).

    Args:
        mean: Difference of two explanations, m. Shape (P,).
        covariance: Mean of their covariances, S. Shape (P, P).
        rows: Derivatives of each measurement, H. Shape (m, c, P).
        noise: Variance of each component.
    """
    d, inner = rows @ mean, _innovate(covariance, rows, noise)[1]
    return np.asarray(0.5 * np.einsum("mc,mc->m", d, np.linalg.solve(inner, d[..., None])[..., 0]))
