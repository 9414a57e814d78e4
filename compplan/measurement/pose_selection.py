"""Optimal selection of measurements: greedy, then exchange of single candidates [Fedorov1972].

The criterion is a function that returns the gain of each candidate in addition to those selected: the variance of the
tip along a path for a model update, the odds of two explanations for a diagnosis. Measurements with derivatives H and
noise R reduce a covariance S by S H^T (H S H^T + R)^-1 H S.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

#: Gain of every candidate in addition to the selected ones. Shape (m,).
Gains = Callable[[list[int]], Array]
#: Least relative improvement of an exchange, against cycles by rounding.
BETTER = 1e-9
#: Greatest number of exchange rounds (assumed: most selections converge in two).
ROUNDS = 3


def grow_choice(worth: Gains, count: int) -> Iterator[tuple[int, float]]:
    """Select `count` candidates greedily; yield each candidate and its gain."""
    taken: list[int] = []
    for _ in range(count):
        gain = worth(taken)
        gain[taken] = -np.inf
        taken.append(int(gain.argmax()))
        yield taken[-1], float(gain[taken[-1]])


def take_greedily(worth: Gains, count: int) -> list[int]:
    """Select `count` candidates greedily."""
    return [number for number, _ in grow_choice(worth, count)]


def offer_once(worth: Gains, group: NDArray[np.int_]) -> Gains:
    """Return gains that offer one candidate of each group only; group: that of each candidate. Shape (m,)."""
    return lambda taken: np.where(np.isin(group, group[taken]), -np.inf, worth(taken))


def exchange_choice(worth: Gains, taken: Sequence[int]) -> list[tuple[int, float]]:
    """Improve a selection by exchanges, and order it greedily; return each candidate and its gain."""
    chosen = exchange_taken(worth, taken)
    grown = grow_choice(lambda order: worth([chosen[k] for k in order])[chosen], len(chosen))
    return [(chosen[k], gain) for k, gain in grown]


def exchange_taken(worth: Gains, taken: Sequence[int]) -> list[int]:
    """Replace selected candidates by better ones, one by one, until none is better or the rounds are over."""
    taken = list(taken)
    for _ in range(ROUNDS):
        changed = False
        for place, leaving in enumerate(taken):
            others = taken[:place] + taken[place + 1 :]
            gain = worth(others)
            gain[others] = -np.inf
            best = int(gain.argmax())
            if best != leaving and gain[best] > gain[leaving] + BETTER * abs(gain[leaving]):
                taken[place], changed = best, True
        if not changed:
            break
    return taken


def narrow_target(target: Array, covariance: Array, rows: Array, noise: float) -> Gains:
    """Return the reduction of the variance of a target by every measurement, as a function of those selected.

    target: derivatives by the state, (t, P); covariance: prior, (P, P); rows: derivatives of each measurement,
    (m, c, P); noise: variance of each component.
    """
    weight = target.T @ target
    return lambda taken: measure_gains(learn_rows(covariance, rows[taken], noise), rows, weight, noise)


def learn_rows(covariance: Array, rows: Array, noise: float) -> Array:
    """Return the covariance, (P, P), after measurements with derivatives (m, c, P) and a variance of each component."""
    return explain_rows(np.zeros(len(covariance)), covariance, rows, noise)[1]


def explain_rows(mean: Array, covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Update mean m and covariance of a difference by measurements of zero: the part H m that they observe is removed.

    mean: (P,); covariance: (P, P); rows: derivatives of each measurement, (m, c, P); noise: variance of a component.
    """
    for H in rows:
        along = covariance @ H.T
        gain = np.linalg.solve(H @ along + noise * np.eye(len(H)), along.T)
        mean, covariance = mean - gain.T @ (H @ mean), covariance - along @ gain
        covariance = 0.5 * (covariance + covariance.T)
    return mean, covariance


def _innovate(covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return H S and the innovation covariance H S H^T + R of each measurement. Shapes (m, c, P), (m, c, c)."""
    m, c, p = rows.shape
    along = (rows.reshape(m * c, p) @ covariance).reshape(m, c, p)
    return along, np.einsum("mip,mjp->mij", along, rows) + noise * np.eye(c)


def measure_gains(covariance: Array, rows: Array, weight: Array, noise: float) -> Array:
    """Return the reduction of the trace of S W, both (P, P), by each measurement, rows (m, c, P). Shape (m,)."""
    along, inner = _innovate(covariance, rows, noise)
    outer = np.einsum("mip,mjp->mij", (along.reshape(-1, len(weight)) @ weight).reshape(along.shape), along)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=1, axis2=2))


def odds_gains(mean: Array, covariance: Array, rows: Array, noise: float = 1.0) -> Array:
    """Return d^T (H S H^T + R)^-1 d / 2, d = H m: the expected log likelihood ratio of each measurement. Shape (m,).

    mean m: difference of two explanations, (P,); covariance S: mean of theirs, (P, P); rows H: (m, c, P).
    """
    d, inner = rows @ mean, _innovate(covariance, rows, noise)[1]
    return np.asarray(0.5 * np.einsum("mc,mc->m", d, np.linalg.solve(inner, d[..., None])[..., 0]))


def take_clear(batches: Iterable[Array], clear: Callable[[Array], NDArray[np.bool_]], count: int) -> Array:
    """Collect the clear postures of batches, (k, nq) each, up to `count`. Shape (<= count, nq). [rad or m]"""
    found: list[Array] = []
    for batch in batches:
        found.append(batch[clear(batch)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
